"""Every effect at its default size: what the plant does with it, as approved."""

from __future__ import annotations

import numpy as np
import pytest

import testbed as tb
from testbed.simulation.effects import KINDS
from tests.helpers.approved import hold
from tests.helpers.paths import ROOT

SHORT = [
    "motion.duration=1.5", "motion.candidates=2", "simulation.step=5e-4", "excitation.clearance=off"
]  # fmt: skip
OWN = ("versions", "model_sha256")
"""Facts that libraries and the file's comments change."""

MORE = {
    "at_rest": ["motion.at_rest=true"],
    "no_friction": ["simulation.friction=false"],
    "welded": ["gravity=[0,1,-9]"],
    "fundamental": ["motion.harmonics=3"],
}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["none", *KINDS, *MORE])
def test_a_plant_moves_as_approved(name: str) -> None:
    more = [f'simulation.effect=[{{kind="{name}"}}]'] if name in KINDS else MORE.get(name, [])
    experiment = tb.Experiment.load(ROOT / "experiments/table6.toml", [*SHORT, *more])
    found = tb.simulate(experiment)
    assert found.truth is not None
    lines = [f"{name}: {found.samples} samples at {found.rate:g} Hz, tare {found.tare}"]
    signals = {each: found.measured(each) for each in ("position", "torque", "wrench")}
    for each, values in (signals | vars(found.truth)).items():
        if isinstance(values, np.ndarray):
            for k, channel in enumerate(values.reshape(len(values), -1).T):
                first = " ".join(f"{x:.5g}" for x in channel[:3])
                size = np.sqrt(np.mean(channel**2))
                lines.append(f"{each} {k}: {first} to {channel[-1]:.5g}, size {size:.5g}")
    lines += [f"{key}: {value}" for key, value in sorted(found.facts.items()) if key not in OWN]
    hold(f"plant_{name}.txt", "\n".join(lines).replace(str(ROOT), "") + "\n")
