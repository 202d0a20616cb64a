"""Other programs' files as recordings.

In: CSV, MATLAB, HDF5, ROS, MCAP, LeRobot, Rerun, C3D, and a mapping.
Out: `Recording` in SI units, with a report of what was converted.
"""
