"""The virtual testbed: plant in MuJoCo, instruments, experiments.

In: an experiment, or a robot, a motion and sensors.
Out: recordings with their true signals; estimates compared with the true parameters.
"""
