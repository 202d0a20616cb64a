"""Output of results: terminal tables, HTML pages, plots.

In: any result.
Out: `Section`s: tables and panels; HTML; plots.
"""
