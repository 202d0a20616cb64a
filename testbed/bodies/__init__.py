"""Inertial parameters of whole bodies: priors, physical consistency, samples, model files.

In: an `Estimate` and the bodies of a model file.
Out: `Posterior`, consistent bodies, sampled robots, model files with new parameters.
"""
