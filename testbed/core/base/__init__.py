"""What every room uses: arrays, errors, files, diagnostics as values, JSON.

In: nothing of the package.
Out: small functions and types without robots in them.
"""
