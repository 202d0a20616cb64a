"""Whether a recording can be true of a robot; mappings solved from data.

In: a `Tree` and a `Source`.
Out: diagnostics with causes, and mappings that correct them.
"""
