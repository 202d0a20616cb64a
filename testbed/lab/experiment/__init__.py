"""Experiments as files, their runs and scores.

In: one TOML file.
Out: `Run`: recording, estimates, errors against the truth, JSON.
"""
