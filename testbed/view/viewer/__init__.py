"""Runs and motions in the Rerun viewer.

In: a `Run`.
Out: a Rerun recording, or a live window.
"""
