"""Compiled computation of regressor rows and of the products in normal equations.

In: a `Tree`, a minimal set and samples.
Out: normal equations, window by window, by Numba or NumPy.
"""
