"""Joint torques against the wrench of the plate.

In: a recording with both.
Out: torque constants, rotors, friction curves.
"""
