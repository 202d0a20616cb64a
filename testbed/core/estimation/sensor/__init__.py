"""Coefficients of sensor errors: identifiable subset, columns, estimates.

In: predicted and measured wrench.
Out: bias, sensitivities, delay and pose with covariance.
"""
