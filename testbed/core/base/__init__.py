"""Foundations of all packages: arrays, errors, files, diagnostics, JSON.

In: no other module of the package.
Out: small functions and types that do not refer to robots.
"""
