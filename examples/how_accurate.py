"""How accurate will my set-up be? The same robot and motion on plates of different noise."""

import testbed as tb

robot = tb.load_tree("puma562.xml")
motion = tb.random_motion(robot, seed=1)

for force_noise in (0.1, 0.5, 2.0):
    plate = tb.ForcePlate(noise=(force_noise, force_noise / 5))
    drives = tb.JointTorques(noise=0.5, gains={"waist": 1.05})
    rig = tb.Rig(robot, sensors=[plate, drives, tb.Encoders(resolution=1e-4)])
    data = tb.simulate(rig, motion, seconds=10)
    for signal in ("wrench", "torque"):
        found = tb.identify(robot, data, signal)
        truth = found.minimal.values(tb.barycentric(robot))
        error = abs(found.values[: len(truth)] - truth).max()
        print(f"{force_noise:.1f} N: by the {found.instrument}, largest error {error:.3f}")
