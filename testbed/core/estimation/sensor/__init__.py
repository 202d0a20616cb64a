"""Coefficients of sensor errors, by Gauss-Newton.

In: predicted and measured wrench.
Out: zero, sensitivities, delay and pose with covariance.
"""
