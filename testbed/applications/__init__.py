"""Identification of payloads, tools and drives; calibration of the force plate.

In: recordings and a `Tree`.
Out: estimates of a payload, of the drives, of the plate's errors.
"""
