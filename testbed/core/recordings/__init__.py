"""Recordings of measured signals, in memory or in Parquet files.

In: testbed's own Parquet files, or arrays.
Out: `Recording`, and `Source`: what recordings of every origin have in common.
"""
