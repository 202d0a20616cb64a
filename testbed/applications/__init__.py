"""Identification of payloads, tools and drives; calibration of the plate.

In: recordings and a `Tree`.
Out: estimates of the payload, of the drives, of the plate.
"""
