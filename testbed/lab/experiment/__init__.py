"""Simulated experiments: TOML files, recordings, estimates and their errors against the truth.

In: one TOML file.
Out: `Run`: recording, estimates, errors against the truth, JSON.
"""
