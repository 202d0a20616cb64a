"""Generalised least squares of the base parameters.

In: a `Tree` without inertias, a `Source`, `Settings`.
Out: `Estimate`, `Validation`, verdict.
"""
