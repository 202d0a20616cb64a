"""Barycentric parameters and minimal sets, [FRS96].

In: a `Tree`.
Out: `MinimalSet`: names, formulas and the matrix of regrouping, before any data.
"""
