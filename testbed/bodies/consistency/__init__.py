"""Physically consistent bodies by semidefinite programming.

In: an `Estimate`, bodies of the file, bounds.
Out: pseudo-inertias that are positive definite, and draws of them.
"""
