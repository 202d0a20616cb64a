"""Plate and joint torques together: better than the plate alone, and where the two differ."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import testbed as tb
from testbed.identification.combined import Combined, _disagreement
from testbed.identification.drive_findings import identify_drives
from testbed.identification.estimate import Estimate
from testbed.recordings.recording import Recording
from tests.helpers.measured import measured
from tests.helpers.runs import robot


def both(tree: tb.Tree, recording: Recording) -> tuple[Estimate, Combined]:
    bodies = tb.identify(tree, recording)
    return bodies, identify_drives(tree, recording, bodies).combined


@pytest.mark.slow
@pytest.mark.parametrize("name", ["puma", "ur5", "gantry"])
def test_both_together_are_no_worse_and_agree(name: str) -> None:
    """On clean data, drives that report too much: sigma is less, and holds; no alarm."""
    tree, scores, chances = robot(name), [], []
    for seed in range(3):
        recording = measured(tree, 60 + seed)
        wrong = replace(recording, torque=1.07 * recording.measured("torque"))
        bodies, found = both(tree, wrong)
        assert (found.sigma <= bodies.sigma * (1 + 1e-9)).all()
        truth = bodies.minimal.values(tb.barycentric(tree))
        scores.append((found.values - truth) / found.sigma)
        off = (found.constants - 1.07) / found.constant_sigma
        assert np.abs(off).max() < 4.5
        chances.append(found.disagreement.chance)
        assert found.disagreement.warnings == ()
    assert np.abs(scores).max() < 5
    assert max(chances) > 0.01


@pytest.mark.slow
def test_precise_torques_tell_more_than_a_noisy_plate() -> None:
    tree = robot("puma")
    recording = measured(tree)
    rng = np.random.default_rng(2)
    wrench = recording.measured("wrench")
    worse = replace(recording, wrench=wrench + 20 * rng.normal(size=wrench.shape))
    bodies, found = both(tree, worse)
    shared = [k for k, name in enumerate(bodies.names) if name in found.disagreement.names]
    assert np.median(found.sigma[shared] / bodies.sigma[shared]) < 0.8


@pytest.mark.slow
def test_a_rotor_that_is_not_among_the_terms_is_caught() -> None:
    """The plate does not feel it, the torques do: the two then differ in the bodies."""
    tree = robot("puma")
    geared = tree.with_joints({name: {"rotor_inertia": 0.5} for name in tree.names})
    recording = measured(geared)
    _, found = both(tree, recording)
    assert found.disagreement.chance < 1e-6
    assert "do not agree" in found.disagreement.warnings[0]
    terms = tb.Settings(terms=("coulomb", "viscous", "rotor"))
    bodies = tb.identify(tree, recording)
    cured = identify_drives(tree, recording, bodies, settings=terms).combined
    assert cured.disagreement.chance > 1e-3


def test_where_torques_tell_nothing_new_nothing_disagrees() -> None:
    bodies = tb.identify(robot("gantry"), measured(robot("gantry"), duration=4.0))
    found = _disagreement(bodies, bodies.values, bodies.covariance)
    assert found.names == ()
    assert found.chance == 1.0
    assert found.warnings == ()
