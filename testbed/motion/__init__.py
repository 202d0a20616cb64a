"""Excitation trajectories: random ones, designed ones, and the proof of limits.

In: a `Tree`, limits, standard deviations of the sensors.
Out: Fourier series, samples, predicted covariance.
"""
