"""Readers of model files, one module per format.

In: URDF or MJCF.
Out: links, joints and inertias for `Tree`.
"""
