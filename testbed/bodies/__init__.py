"""Inertial parameters of whole bodies: priors, physical consistency, draws, files.

In: an `Estimate` and the bodies of a model file.
Out: `Posterior`, consistent bodies, sampled robots, model files with new parameters.
"""
