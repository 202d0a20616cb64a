"""The format of recordings: Parquet.

In: a file.
Out: named columns, read block by block.
"""
