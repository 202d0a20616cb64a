"""Results on a terminal, on a page and in pictures.

In: any result.
Out: `Section`s: tables and panels; HTML; plots.
"""
