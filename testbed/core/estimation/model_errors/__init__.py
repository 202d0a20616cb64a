"""Model errors: effects of real robots beyond rigid bodies and the chosen joint terms.

In: a problem, an estimate of its parameters.
Out: families (types) of model errors found in the residuals, and their effect on the estimate.
"""
