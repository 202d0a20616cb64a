"""Identify the inertial parameters of a robot from joint torques or a force plate under its base.

    robot = load_tree("puma562.xml")        read a URDF or MJCF file, or one that is shipped
    minimal_set(robot, "wrench")            parameters that can be identified, before any data
    rig = Rig(robot, plant, sensors)        robot, what acts in its plant, sensors with errors
    motion = random_motion(robot)           Fourier motion inside the limits
    motion = design(rig, motion)            the most informative one, proven safe
    data = simulate(rig, motion)            what the sensors record
    data = read("log.csv", robot)           the recording of any logger
    plate = identify(robot, data, "wrench") values, standard deviations, warnings; estimates add
    validate(plate, other)                  residuals of a recording that it has not seen
    view(data, plate)                       the robot, measured and predicted, in Rerun

All names are in `__all__`, and explained in docs/python.md; others may change. They are imported
when first used. SI units and radians at the joint side; arrays are (samples, joints) in the order
of `robot.names`, wrenches (samples, 6), force first.

Source    [FRS96], see REFERENCES.bib
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
