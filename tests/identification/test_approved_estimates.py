"""Estimates with every setting, of three kinds of robots, as approved: values, sigmas, words."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from testbed.experiment.run import assemble_run
from testbed.identification.settings import Settings
from testbed.recordings.recording import Recording
from tests.helpers.approved import hold
from tests.helpers.faulty import clean
from tests.helpers.measured import measured
from tests.helpers.runs import robot

pytestmark = pytest.mark.slow

SETTINGS: dict[str, dict[str, Any]] = {
    "default": {},
    "white": {"noise": "white", "zeros": True},
    "weights": {"weights": "full"},
    "cutoffs": {"cutoff": 8.0, "position_cutoff": 20.0, "deadband": 0.05, "reversal_reach": 0.1},
    "off": {"cutoff": "off", "position_cutoff": "off"},
    "bias": {"nuisances": ("bias", "slope")},
    "matrix": {"nuisances": ("matrix",), "known": {"mass": (20.0, 0.01)}},
    "pose": {"nuisances": ("pose", "height")},
    "late": {"nuisances": ("skew", "joint_zeros")},
    "tare": {"nuisances": ("tare",), "known": {"mass": 20.0}},
    "unknown_tare": {"tare": "unknown"},
    "span": {"span": (2.0, 9.0)},
    "ridge": {"ridge": True},
    "drives": {"drives": "given"},
    "chosen": {"drives": "chosen", "terms": ("coulomb", "viscous", "offset", "rotor")},
    "auto": {"terms": "auto"},
    "terms": {"terms": ("coulomb", "asymmetric", "quadratic", "square_root", "stribeck@0.1")},
    "numpy": {"engine": "numpy"},
    "compiled": {"engine": "compiled"},
}
LESS = ("default", "weights", "bias", "late", "auto", "compiled", "white")


@pytest.fixture(scope="module")
def recordings() -> dict[str, Recording]:
    return {
        "puma": clean(robot("puma"), 3, duration=12.0),
        "gantry": measured(robot("gantry"), 4, duration=12.0),
        "random": measured(robot("random"), 5, duration=12.0, memory=0.9),
    }


CASES = [("puma", name) for name in SETTINGS]
CASES += [(each, name) for each in ("gantry", "random") for name in LESS]


@pytest.mark.parametrize(("name", "how"), CASES)
def test_estimates_are_as_approved(name: str, how: str, recordings: dict[str, Recording]) -> None:
    settings = Settings(**{"engine": "compiled", **SETTINGS[how]})
    run = assemble_run(robot(name), recordings[name], name=how, settings=settings)
    lines = [f"{name}, {SETTINGS[how]}"]
    for method, estimate in run.estimates.items():
        lines.append(f"{method}: doubtful {estimate.doubtful}, condition {estimate.condition:.4g}")
        told = zip(estimate.names, estimate.units, estimate.values, estimate.sigma, strict=True)
        lines += [f"  {each} [{unit}] {value:.5g} {sigma:.3g}" for each, unit, value, sigma in told]
        lines += [f"  residual {each:.4g}" for each in estimate.residual]
        lines += [f"  {each.name} {each.value:.4g} {each.sigma:.3g}" for each in estimate.nuisances]
        if estimate.noise is not None:
            memory = " ".join(f"{each:.3g}" for each in np.atleast_1d(estimate.noise.memory))
            lines.append(f"  noise of {memory} s, sigma x {estimate.noise.factor:.3f}")
    lines += run.warnings
    hold(f"estimate_{name}_{how}.txt", "\n".join(lines) + "\n")
