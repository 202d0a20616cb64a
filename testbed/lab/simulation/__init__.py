"""The plant, by MuJoCo.

In: a model file, a motion, what else is in the plant.
Out: true signals.
"""
