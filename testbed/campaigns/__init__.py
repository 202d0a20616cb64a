"""Many runs of one experiment: crossed factors and replicates.

In: an experiment file with factors.
Out: one Parquet table, its summary and page.
"""
