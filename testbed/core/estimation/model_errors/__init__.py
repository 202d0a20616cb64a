"""Model errors: effects of real robots beyond rigid bodies and the chosen joint terms.

In: a problem, an estimate of its parameters.
Out: families of model errors that the residuals show, and their effect on the estimate.
"""
