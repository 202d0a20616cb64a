"""Excitation trajectories, random or optimised, with a proof that limits are respected.

In: a `Tree`, limits, standard deviations of the sensors.
Out: Fourier series, samples, predicted covariance of the parameters.
"""
