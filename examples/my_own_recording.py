"""From arrays of one's own logger to an estimate; here the arrays come from a simulation."""

import testbed as tb

tree = tb.load_tree("models/puma562.xml")
measured = tb.simulate(tb.Experiment.load("experiments/table6.toml", ["motion.duration=10"]))

recording = tb.Recording(
    names=("waist", "shoulder", "elbow"),  # the order of the columns below
    time=measured.time,  # (M,) [s], at a constant rate
    position=measured.position,  # (M, 3) [rad], encoders
    wrench=measured.wrench,  # (M, 6) [N, N m], of the plate on the robot, force first
    tare=measured.tare,  # (6,) what the plate reads of the pedestal alone; None: the model's
)
estimate = tb.identify(tree, recording, "external", zeros=True)
for name, unit, value, sigma in zip(
    estimate.names, estimate.units, estimate.values, estimate.sigma, strict=True
):
    print(f"{name:8s} {value:9.4f} +- {sigma:.4f} {unit}")
for warning in estimate.warnings:
    print("warning:", warning)
