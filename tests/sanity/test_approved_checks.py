"""What is said of recordings with mistakes, and of right ones, as approved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.sanity.clock_offset import clock_offsets
from testbed.sanity.sanity import check_sanity
from tests.helpers.approved import hold
from tests.helpers.measured import measured
from tests.helpers.runs import robot
from tests.sanity.test_sanity import PLATES, WRONG

pytestmark = pytest.mark.slow

QUICK = [name for name in WRONG if name not in ("two zeros", "order", "motor side", "currents")]


def late(recording: tb.Recording, signal: str, seconds: float | Array) -> tb.Recording:
    """One device behind the others."""
    shown = recording.time - seconds
    values = recording.measured(signal)
    moved = np.column_stack([np.interp(shown, recording.time, each) for each in values.T])
    return (
        replace(recording, torque=moved) if signal == "torque" else replace(recording, wrench=moved)
    )


MISTAKES = {name: WRONG[name][0] for name in QUICK} | {n: PLATES[n][0] for n in PLATES}
MISTAKES |= {
    "nothing": lambda r: r,
    "late torques": lambda r: late(r, "torque", 0.02),
    "a late plate": lambda r: late(r, "wrench", 0.013),
    "a slow clock": lambda r: late(r, "wrench", 1e-3 * r.time),
}
LONG = ("degrees", "radians as degrees", "a zero")
"""Searches of a gantry's zeros take long."""

CASES = [("puma", each) for each in MISTAKES]
CASES += [("gantry", each) for each in MISTAKES if each not in LONG]
CASES += [("ur5", each) for each in ("nothing", "degrees", "a late plate", "a position's sign")]
CASES += [("random", each) for each in ("nothing", "a torque's sign")]


@pytest.mark.parametrize(("name", "mistake"), CASES)
def test_a_check_says_what_was_approved(name: str, mistake: str) -> None:
    tree = robot(name)
    recording = MISTAKES[mistake](measured(tree, 2, duration=8.0))
    found = check_sanity(tree, recording)
    lines = [f"{name}, {mistake}", f"sizes {' '.join(f'{each:.4g}' for each in found.sizes)}"]
    for kind, findings in (("certain", found.certain), ("likely", found.likely)):
        lines += [f"{kind}: {each.number:.4g} {each.text}" for each in findings]
    for clock in clock_offsets(tree, recording):
        delay = f" {clock.delay:.1g} s" if clock.late else ""  # it is uncertain by some percent
        lines.append(f"{clock.signal}: late {clock.late}{delay}, drifts {clock.drifts}")
    place = f"check_{name}_{mistake}".replace(" ", "_").replace("'", "")
    hold(f"{place}.txt", "\n".join(lines) + "\n")
