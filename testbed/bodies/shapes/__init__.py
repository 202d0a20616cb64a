"""Shapes of links, for pictures, bounds and collisions.

In: URDF or MJCF with its meshes.
Out: `Shape`s: vertices and faces in the frame of a link.
"""
