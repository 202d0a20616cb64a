"""Identification of drives by comparing joint torques with the wrench of the force plate.

In: a recording with both signals.
Out: torque constants, rotor inertias, friction curves.
"""
