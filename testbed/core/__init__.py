"""Robot dynamics and the estimation of its parameters; needs no other room.

In: a model file and a recording.
Out: `Tree`, `MinimalSet`, regressors, `Estimate` with covariance and diagnostics.
"""
