"""Regression: filters, regressor rows, normal equations and their solution.

In: a `Problem`.
Out: sums of products, and fits.
"""
