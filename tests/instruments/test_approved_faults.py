"""Every fault at its default size: what is recorded, and what is then estimated and said."""

from __future__ import annotations

import numpy as np
import pytest

import testbed as tb
from testbed.experiment.run import assemble_run
from testbed.identification.settings import Settings
from testbed.instruments.fault import Fault
from testbed.instruments.faults import KINDS
from testbed.recordings.recording import Recording
from tests.helpers.approved import hold
from tests.helpers.faulty import clean, with_faults
from tests.helpers.paths import ROOT

pytestmark = pytest.mark.slow

PUMA = tb.load_tree(ROOT / "models/puma562.xml")


@pytest.fixture(scope="module")
def recording() -> Recording:
    return clean(PUMA, 7, duration=16.0)


def shown(recording: Recording) -> list[str]:
    """Of every channel its first values, its mean and its size."""
    lines = []
    for name in ("position", "torque", "wrench"):
        values = recording.measured(name)
        for k, channel in enumerate(values.T):
            first = " ".join(f"{x:.6g}" for x in channel[:4])
            size = np.sqrt(np.mean(channel**2))
            lines.append(f"{name} {k}: {first} mean {channel.mean():.6g} size {size:.6g}")
    return [*lines, f"ends at {recording.time[-1]:.6g} s, tare {recording.tare}"]


@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_is_recorded_and_said_as_approved(kind: str, recording: Recording) -> None:
    fault: Fault = KINDS[kind]()
    faulty = with_faults(recording, 7, fault)
    lines = [f"{fault}", *shown(faulty)]
    run = assemble_run(PUMA, faulty, name=kind, settings=Settings(zeros=True))
    for method, estimate in run.estimates.items():
        lines.append(f"{method}: doubtful {estimate.doubtful}")
        told = zip(estimate.names, estimate.values, estimate.sigma, strict=True)
        lines += [f"  {name} {value:.5g} {sigma:.3g}" for name, value, sigma in told]
        lines += [f"  residual {size:.4g}" for size in estimate.residual]
    lines += run.warnings
    hold(f"fault_{kind}.txt", "\n".join(lines) + "\n")
