"""What encoders, joint torques and the force plate read.

In: true signals.
Out: measured signals, with noise, faults and clocks.
"""
