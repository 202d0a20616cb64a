"""Many runs of one experiment: factors, replicates, one table."""
