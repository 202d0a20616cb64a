"""Noise models of residuals: coloured noise, errors in variables, standard deviations.

In: regression rows and residuals.
Out: noise models, and the unknowns with calibrated covariance.
"""
