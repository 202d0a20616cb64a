"""Campaigns: many runs of one experiment, with crossed factors and replicates.

In: an experiment file with factors.
Out: one Parquet table, its summary and page.
"""
