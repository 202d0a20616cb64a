"""Barycentric parameters and minimal sets (base parameters) of robots, [FRS96].

In: a `Tree`.
Out: `MinimalSet`: names, formulas and matrix of the base parameters, from the model alone.
"""
