"""Kinematic trees from URDF and MJCF.

In: a model file.
Out: `Tree`: joints, inertias, shafts, friction models.
"""
