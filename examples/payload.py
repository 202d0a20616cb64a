"""Weigh what a robot carries: two recordings on one plate, without the load and with it."""

import testbed as tb

tree = tb.load_tree("puma562.xml")
motion = tb.random_motion(tree, seed=1)
sensors = [tb.ForcePlate(noise=(0.5, 0.1)), tb.Encoders(resolution=1e-4)]
load = tb.Payload("elbow", mass=1.0, centre=(0.0, 0.0, 0.43))
rigs = (tb.Rig(tree, sensors=sensors), tb.Rig(tree, plant=[load], sensors=sensors))

data = [tb.simulate(rig, motion, seconds=10, seed=seed) for seed, rig in enumerate(rigs)]
before, after = (tb.identify(tree, each, "wrench") for each in data)
found = tb.payload(tree, before, after)

print(f"on the link that {found.joint} moves; in truth 1 kg, 0.43 m along z")
for name, value, sigma, alone in zip(
    found.names, found.values, found.sigma, found.identifiable, strict=True
):
    print(f"{name:6s} {value:9.5f} +- {sigma:.5f}" if alone else f"{name:6s} in combination only")
print("centre [m]:", (found.values[1:4] / found.values[0]).round(4))
for line in tb.sentences(found.diagnostics):
    print(line)
