"""One virtual experiment, from its file to a page: python examples/one_experiment.py [FOLDER]."""

import sys
from pathlib import Path

import testbed as tb

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
experiment = tb.Experiment.from_toml(
    tb.shipped("table6")  # or your own, as `testbed new your_robot.urdf` writes it
).with_(motion={"duration": 10, "candidates": 3})  # any key
run = tb.carry_out(experiment)  # simulates, identifies, compares with the truth

for method, estimate in run.estimates.items():
    print(f"{method}: rms error {run.metrics[f'{method}_rms_relative_error']:.2%}")
    print(estimate)
for line in tb.sentences(run.diagnostics):
    print(line)

found = tb.predict(run).smoothed(
    10.0
)  # below 10 Hz: what both estimates say that plate and drives should have read
for signal in found.signals:
    for method in signal.predicted:
        rms = (signal.residual(method) ** 2).mean(axis=0) ** 0.5
        print(f"{signal.kind}, {method}: residual rms {rms.round(3)}")

tb.plot(run).savefig(folder / "errors.png", dpi=150)
print("written:", tb.report(run, folder / "one_experiment.html"))
print("written:", tb.view(run, path=folder / "one_experiment.rrd"))  # without a path it opens
