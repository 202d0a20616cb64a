"""Regressor rows and their products, compiled.

In: a `Tree`, a minimal set and samples.
Out: normal equations, window by window, by Numba or NumPy.
"""
