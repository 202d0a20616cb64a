"""Physically consistent bodies from nonlinear programming with a log-determinant divergence.

In: an `Estimate`, bodies of the file, bounds.
Out: pseudo-inertias that are positive definite, and samples of them.
"""
