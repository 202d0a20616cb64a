"""Identification of a robot's inertial parameters from joint torques or a base force plate.

    robot = load_tree("puma562.xml")        read a URDF or MJCF file, or a shipped model
    minimal_set(robot, "wrench")            parameters that can be identified, before any data
    rig = Rig(robot, plant, sensors)        robot, effects in its plant, sensors with errors
    motion = random_motion(robot)           Fourier motion inside the limits
    motion = design(rig, motion)            most informative motion, proven within limits
    data = simulate(rig, motion)            recording of the simulated sensors
    data = read("log.csv", robot)           recording from a logger's file
    plate = identify(robot, data, "wrench") values, standard deviations, warnings; estimates add
    validate(plate, other)                  residuals of a recording not used for the fit
    view(data, plate)                       robot, measured and predicted signals, in Rerun

All names are in `__all__`, and explained in docs/python.md; others may change. They are imported
when first used. SI units and radians at the joint side; arrays are (samples, joints) in the order
of `robot.names`, wrenches (samples, 6), force first.

Source    [FRS96], see REFERENCES.bib
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
