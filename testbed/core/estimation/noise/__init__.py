"""Coloured noise, errors in variables, standard deviations.

In: rows and residuals.
Out: noise models, covariance, score tests.
"""
