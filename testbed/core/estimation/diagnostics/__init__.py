"""Diagnostics: tests of recording, residuals and estimate for faults in the data.

In: residuals of a fit.
Out: `Diagnostic` values.
"""
