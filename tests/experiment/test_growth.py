"""Estimates from more and more of a recording."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import testbed as tb
from testbed.experiment.growth import growing_errors, growth
from testbed.experiment.run import assemble_run
from testbed.identification.estimate import METHODS
from testbed.identification.settings import Settings
from tests.helpers.ideal import EXACT, ideal
from tests.helpers.runs import experiment, noisy, robot, run_of


@pytest.mark.parametrize("name", ["puma", "gantry"])
def test_growth_ends_at_the_estimate_and_passes_through_those_of_the_parts(name: str) -> None:
    """With the run's own settings."""
    tree = robot(name)
    settings = replace(EXACT, deadband=0.1)
    recording = noisy(ideal(tree))
    run = assemble_run(tree, recording, name="made", settings=settings)
    grown = growth(run, [5.0, 99.0])
    for method in METHODS:
        assert grown[method].time.tolist() == [5.0, recording.time[-1]]
        np.testing.assert_array_equal(grown[method].values[-1], run.estimates[method].values)
        np.testing.assert_array_equal(grown[method].sigma[-1], run.estimates[method].sigma)
        part = tb.identify(tree, recording.part(0, 1001), method, settings=settings)
        np.testing.assert_array_equal(grown[method].values[0], part.values)
        np.testing.assert_array_equal(grown[method].sigma[0], part.sigma)


@pytest.mark.slow
def test_growth_covers_the_recording_whenever_it_began() -> None:
    tree = robot("puma")
    recording = noisy(ideal(tree))
    late = replace(recording, time=recording.time + 100.0)
    ours, theirs = (growth(run_of(tree, each)) for each in (recording, late))
    for method in METHODS:
        np.testing.assert_allclose(theirs[method].time - 100.0, ours[method].time)
        np.testing.assert_array_equal(theirs[method].values, ours[method].values)
        assert len(ours[method].time) == 12
        assert (np.diff(ours[method].time) > 0).all()


@pytest.mark.slow
def test_what_the_first_seconds_do_not_tell_is_no_number() -> None:
    tree = robot("ur5")
    recording = replace(noisy(ideal(tree)), velocity=None, acceleration=None)
    run = assemble_run(tree, recording, name="made", settings=Settings())
    grown = growth(run, [0.02, 9.0])
    for method in METHODS:
        assert np.isnan(grown[method].values[0]).all()
        assert np.isfinite(grown[method].values[1:]).all()


def test_growing_errors_end_at_the_scores() -> None:
    run = run_of(robot("puma"), asked=experiment())
    assert run.score is not None
    for method, grown in growth(run, [5.0]).items():
        errors = growing_errors(run, method, grown)
        count = len(run.estimates[method].base.names)
        assert errors.shape == (2, count)
        np.testing.assert_allclose(errors[-1], run.score.errors[method].relative[:count])


def test_without_truth_growing_errors_end_at_zero() -> None:
    run = run_of(robot("puma"))
    for method, grown in growth(run, [5.0]).items():
        errors = growing_errors(run, method, grown)
        assert np.abs(errors[0]).max() > 0
        assert not errors[-1].any()
