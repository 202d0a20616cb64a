"""Simulated measurements of encoders, joint torques and the force plate.

In: true signals.
Out: measured signals, with noise, systematic errors and clock errors.
"""
