"""Model errors: what robots have and rigid bodies with the stated joint terms have not.

In: a problem, an estimate of its parameters.
Out: families of model errors that the residuals show, and what they do to the estimate.
"""
