"""Symbolic equations of motion of a robot, and of its base wrench.

In: a `Tree`.
Out: text, LaTeX, Python and C.
"""
