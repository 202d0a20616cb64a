"""Import of recordings from files of other programs, described by a mapping file.

Input: CSV, MATLAB, HDF5, ROS, MCAP, LeRobot, Rerun or C3D files, and a mapping.
Output: `Recording` in SI units, with a report of what was converted.
"""
