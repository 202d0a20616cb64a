"""Literal equations of motion and of the reaction.

In: a `Tree`.
Out: text, LaTeX, Python and C.
"""
