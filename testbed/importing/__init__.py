"""Import of recordings from files of other programs, by a mapping file.

In: CSV, MATLAB, HDF5, ROS, MCAP, LeRobot, Rerun, C3D, and a mapping.
Out: `Recording` in SI units, with a report of what was converted.
"""
