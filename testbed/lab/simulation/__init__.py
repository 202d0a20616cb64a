"""Simulation of the plant, the robot on its bedplate, in MuJoCo.

In: a model file, a motion, effects such as gear friction or a payload.
Out: true signals: positions, torques, wrench.
"""
