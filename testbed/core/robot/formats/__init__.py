"""Readers of model files, one a format.

In: URDF or MJCF.
Out: links, joints and inertias for `Tree`.
"""
