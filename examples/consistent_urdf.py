"""A URDF with the result: physically consistent bodies, friction, all else byte for byte."""

import sys
from pathlib import Path

import testbed as tb

model = tb.ModelFile(tb.shipped("puma562.urdf"))
believed = model.tree()  # the file's values stay where the data do not determine them
measured = tb.record(tb.Experiment.load(tb.shipped("table6"), ["motion.duration=10"]))

estimates = [tb.identify(believed, measured, method) for method in ("external", "internal")]
found = tb.consistent(believed, estimates, tb.prior_of(believed))
print("least eigenvalues, all positive:", found.eigenvalues[:, 0].round(3))
for link, (mass, *_), (sigma, *_) in zip(found.links, found.standard, found.sigma, strict=True):
    print(f"{link}: {mass:.3f} +- {sigma:.3f} kg")

path = Path(sys.argv[1] if len(sys.argv) > 1 else "identified.urdf")
for each in tb.write_model(tb.robot_of(found, believed), path):
    print(each)
print("written:", path)
