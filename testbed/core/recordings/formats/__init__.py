"""File format of recordings: Parquet.

In: a file.
Out: named columns, read in blocks of rows.
"""
