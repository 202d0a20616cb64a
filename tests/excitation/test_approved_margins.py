"""What fixed motions use of their limits, and what they promise, as approved: no search in them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.errors import InfeasibleMotion
from testbed.excitation.fourier import Fourier
from testbed.excitation.limits import usage
from testbed.excitation.prediction import predict
from testbed.excitation.proof import Proof, Rules, prove, seems_to_hold
from testbed.excitation.rest_to_rest import start_of
from testbed.excitation.slack import slack
from testbed.experiment.excite import pipeline_of, wish_of
from tests.helpers.approved import hold, numbers
from tests.helpers.measured import random_fourier
from tests.helpers.runs import MODELS, robot

pytestmark = pytest.mark.slow

ASKED: dict[str, tuple[str, tuple[str, ...]]] = {
    "puma": ("puma", ()),
    "puma_plate": (
        "puma",
        ("excitation.instrument=both", "excitation.plate_range=[80,80,600,90,90,50]"),
    ),
    "puma_joints": (
        "puma",
        ("excitation.instrument=joints", "excitation.criterion=d", "excitation.clearance=0.03"),
    ),
    "puma_area": ("puma", ("excitation.pressure_area=[0.6,0.5]", "excitation.criterion=e")),
    "gantry": ("gantry", ("excitation.instrument=both",)),
    "ur5": ("ur5", ("motion.max_acceleration={j1=2}",)),
}


def of_proof(proof: Proof) -> list[str]:
    lines = []
    for each in proof.margins:
        when = "" if each.unit else f" at {each.instant:.4g} s"  # a body that turns is as near
        lines.append(f"{each.label}: {each.left:.5g} {each.unit}{when} {each.holds}")
    return [*lines, f"{proof.instants} instants, {proof.worst.label}, holds {proof.holds}"]


def of_limits(motion: Fourier, rules: Rules) -> list[str]:
    """Proof, a glance, and what is left as time goes on."""
    times = np.linspace(0.0, motion.period, 7)
    lines = [f"{s.label} [{s.unit}]: {numbers(s.left, 5)}" for s in slack(motion, rules, times)]
    used = usage(rules.tree, motion.at(times), rules.limits)
    lines += [f"{kind} used: {numbers(share, 5)}" for kind, share in used.items()]
    lines.append(f"seems to hold: {seems_to_hold(motion, rules)}")
    try:
        start, margins = start_of(motion, rules)
    except InfeasibleMotion as error:
        return [*lines, f"no start: {error}"]
    lines += [f"start of {start.duration:g} s: {each.label} {each.left:.5g}" for each in margins]
    return lines


@pytest.mark.parametrize("name", ASKED)
def test_what_a_motion_uses_and_promises_is_as_approved(name: str, tmp_path: Path) -> None:
    which, settings = ASKED[name]
    tree = robot(which)
    (tmp_path / "made.toml").write_text(f'name = "made"\nmodel = "{MODELS[which]}"\n')
    plain = ("motion.duration=8", "excitation.harmonics=3")
    experiment = tb.Experiment.load(tmp_path / "made.toml", [*plain, *settings])
    wish = wish_of(experiment, tree)
    lines = [name, *wish.rules.notes]
    for seed, speed in ((1, 0.5), (2, 1.6)):
        motion = random_fourier(tree, np.random.default_rng(seed), speed)
        motion = replace(motion, offset=0.5 * motion.offset)
        lines += ["", f"motion {seed}", *of_proof(prove(motion, wish.rules))]
        lines += of_limits(motion, wish.rules)
        names = wish.rows["dynamic" if "joints" in name else "reaction"].minimal.names
        found = predict(wish.information, wish.rows, motion, pipeline_of(experiment), names)
        lines.append(f"condition {found.condition:.4g}, rms {found.rms:.4g}")
        each = zip(found.names, found.sigma, found.relative, strict=True)
        lines += [f"{n}: {sigma:.4g}, {share:.4g}" for n, sigma, share in each]
    hold(f"margins_{name}.txt", "\n".join(lines) + "\n")
