"""From arrays of one's own logger to an estimate; here the arrays come from a simulation."""

import testbed as tb

tree = tb.load_tree("puma562.xml")


def recorded(seed: int) -> tb.Recording:
    """What a logger has written, another motion for each seed."""
    rig = tb.Rig(tree, sensors=[tb.ForcePlate(noise=(0.5, 0.1)), tb.Encoders(resolution=1e-4)])
    measured = tb.simulate(rig, tb.random_motion(tree, seed=seed), seconds=10, seed=seed)
    return tb.Recording(
        names=("waist", "shoulder", "elbow"),  # the order of the columns below
        time=measured.time,  # (M,) [s], at a constant rate
        position=measured.position,  # (M, 3) [rad], encoders
        wrench=measured.wrench,  # (M, 6) [N, N m], of the plate on the robot, force first
        tare=measured.tare,  # (6,) what the plate reads of the pedestal alone; None: the model's
    )


estimate = tb.identify(tree, recorded(1), "wrench", zeros=True)
print(estimate)  # values, sigmas, warnings

other = tb.validate(estimate, recorded(2))
for channel, unit, left, spread in zip(
    other.channels, other.units, other.residual, other.signal, strict=True
):
    print(f"another motion, {channel}: {left:.3f} of {spread:.3f} {unit} not explained")
