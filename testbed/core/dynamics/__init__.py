"""Inverse dynamics, linear in the barycentric parameters.

In: a `Tree` and a `Motion`.
Out: joint forces, wrench at the base, regressors and their derivatives.
"""
