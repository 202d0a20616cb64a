"""Choice of terms and filters by cross-validation.

In: products of rows, block by block.
Out: chosen terms, errors on blocks that were left out.
"""
