"""One value for a run: what was measured, what could be identified from it, and how well."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import testbed as tb
from testbed.errors import RecordingError
from testbed.experiment.experiment_tables import Bound
from testbed.experiment.run import assemble_run
from testbed.experiment.run_warnings import close_pairs, systematic_errors
from testbed.experiment.summary import headline, percent, summary, verdict
from testbed.identification.estimate import METHODS, SIGNAL_OF, Method
from tests.helpers.ideal import EXACT, ideal
from tests.helpers.runs import MODELS, ROBOTS, experiment, judged_run, noisy, robot, run_of, without


@pytest.mark.slow
@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("method", METHODS)
def test_one_signal_is_enough_for_one_method(name: str, method: Method) -> None:
    """The same to the bit as with both."""
    tree = robot(name)
    recording = noisy(ideal(tree))
    lacks = next(SIGNAL_OF[m] for m in METHODS if m != method)
    run = run_of(tree, without(recording, lacks), experiment())
    assert set(run.estimates) == {method}
    assert set(run.failures) == set(METHODS) - {method}
    assert lacks in next(iter(run.failures.values()))
    whole = run_of(tree, recording)
    np.testing.assert_array_equal(run.estimates[method].values, whole.estimates[method].values)
    assert set(run.truths) == set(run.estimates[method].names)


def test_one_method_that_fails_does_not_take_the_other_with_it() -> None:
    tree = robot("puma")
    deaf = replace(EXACT, deadband=1e3)  # no joint row is left
    run = assemble_run(tree, ideal(tree), name="made", settings=deaf)
    assert set(run.estimates) == {"external"}
    assert "0 samples determine only 0" in run.failures["internal"]
    assert f"no internal estimate: {run.failures['internal']}" in run.warnings


def test_a_recording_of_nothing_but_positions_is_a_run_without_estimates() -> None:
    tree = robot("puma")
    run = run_of(tree, replace(ideal(tree), wrench=None, torque=None), experiment())
    assert run.estimates == {}
    assert set(run.failures) == set(METHODS)
    assert run.metrics == {}
    assert "no estimate could be made" in summary(run)[0]


def test_gravity_is_the_recordings() -> None:
    moon = [0.3, 0.0, -1.6]
    tree = robot("puma")
    there = ideal(tree.with_gravity(moon))
    run = run_of(tree, replace(there, facts={"gravity": moon}), experiment())
    np.testing.assert_array_equal(run.tree.gravity, moon)
    assert run.metrics["external_max_relative_error"] < 1e-9
    assert run.metrics["internal_max_relative_error"] < 1e-9


def test_joints_are_in_the_order_of_the_tree() -> None:
    tree = robot("puma")
    recording = noisy(ideal(tree))
    back = [2, 0, 1]
    signals = ("position", "velocity", "acceleration", "torque")
    moved: dict[str, Any] = {s: recording.measured(s)[:, back] for s in signals}
    names = tuple(tree.names[k] for k in back)
    turned = replace(recording, names=names, truth=None, **moved)
    run, same = run_of(tree, turned), run_of(tree, recording)
    assert run.recording.names == tree.names
    for method in METHODS:
        np.testing.assert_array_equal(run.estimates[method].values, same.estimates[method].values)


def test_another_robots_recording_is_refused() -> None:
    with pytest.raises(RecordingError, match="of another robot"):
        run_of(robot("ur5"), ideal(robot("puma")))


def test_a_run_that_no_experiment_made_has_no_truth() -> None:
    run = run_of(robot("puma"))
    assert (run.score, run.truths, run.metrics, run.verdicts) == (None, {}, {}, {})
    assert run.as_expected
    assert verdict(run) == ""
    for method in METHODS:
        base = run.estimates[method].base
        half = 100 * np.median(base.sigma / np.abs(base.values))
        assert f"half of its {len(base.names)} parameters known to {half:.2g} %" in headline(run)


def test_warnings_are_said_once() -> None:
    tree = replace(robot("puma"), warnings=("the model is odd",))
    recording = replace(ideal(tree), facts={"warnings": ["the motor was hot"]})
    run = run_of(tree, recording)
    assert {"the model is odd", "the motor was hot"} <= set(run.warnings)
    assert len(set(run.warnings)) == len(run.warnings)


def correlated(pairs: dict[tuple[int, int], float]) -> tb.Estimate:
    """An estimate whose covariance has these correlations, and no others."""
    external = judged_run("puma").estimates["external"]
    correlation = np.eye(len(external.names))
    for (a, b), value in pairs.items():
        correlation[a, b] = correlation[b, a] = value
    return replace(external, covariance=correlation * np.outer(external.sigma, external.sigma))


def test_parameters_that_are_told_apart_poorly_are_named() -> None:
    assert list(close_pairs(correlated({(0, 1): 0.89}))) == []
    estimate = correlated({(0, 1): -0.97, (2, 3): 0.91, (4, 5): 0.5})
    a, b, c, d = estimate.names[:4]
    assert list(close_pairs(estimate)) == [
        f"the external estimate tells apart poorly: {a} and {b} (correlation -0.97), "
        f"{c} and {d} (correlation 0.91)"
    ]


def test_of_many_close_pairs_the_closest_are_named_and_all_are_counted() -> None:
    pairs = {(0, k): 0.9 + 0.01 * k for k in range(1, 8)}
    (line,) = close_pairs(correlated(pairs))
    assert line.count("correlation") == 5
    assert line.index("0.97") < line.index("0.96") < line.index("0.93")
    assert line.endswith("and 2 more pairs")


def test_errors_that_sigma_does_not_tell_are_named() -> None:
    run = judged_run("puma")
    assert run.score is not None
    estimate, errors = run.estimates["internal"], run.score.errors["internal"]
    assert list(systematic_errors(estimate, errors)) == []
    z = np.zeros(len(errors.z))
    z[[1, 3]] = 6.0, -40.0
    off = replace(estimate, values=errors.truth + z * estimate.sigma)
    relative = np.where(z == 0, 0.0, 0.1)
    (found,) = systematic_errors(off, replace(errors, z=z, relative=relative))
    assert found.subject == f"the internal estimate of {estimate.names[3]} and of 1 more parameter"
    assert found.number == pytest.approx(40)
    assert "torque constant" in found.causes[0]


def test_systematic_errors_of_the_plate_are_not_laid_on_drives() -> None:
    run = judged_run("puma")
    assert run.score is not None
    estimate, errors = run.estimates["external"], run.score.errors["external"]
    z = np.full(len(errors.z), 9.0)
    off = replace(estimate, values=errors.truth + z * estimate.sigma)
    (found,) = systematic_errors(off, replace(errors, z=z, relative=np.full(len(z), 0.1)))
    assert "torque" not in found.text
    assert "a plate that is turned" in found.causes[0]


def test_rounding_is_no_systematic_error() -> None:
    """Without noise sigmas are rounding, and errors may be many of them."""
    tree = robot("puma")
    run = assemble_run(tree, ideal(tree), name="made", settings=EXACT, experiment=experiment())
    assert not [line for line in run.warnings if "systematic" in line]


@pytest.mark.parametrize(
    ("share", "said"), [(3e-4, "0.03 %"), (0.114, "11 %"), (1.642, "160 %"), (1e-16, "1e-14 %")]
)
def test_shares_are_written_as_people_do(share: float, said: str) -> None:
    assert percent(share) == said


def test_the_summary_says_what_a_reader_asks_first() -> None:
    expect = {"external_max_z": Bound(at_most=1e-9), "internal_to_external": Bound(at_least=0.0)}
    tree = robot("puma")
    run = run_of(tree, asked=experiment(expect=expect))
    text = " ".join(summary(run))
    counts = [len(run.estimates[method].base.names) for method in METHODS]
    assert f"reaction tells {counts[0]} inertial parameters" in text
    assert f"torques tell {counts[1]} inertial parameters and 6 coefficients of the joints" in text
    assert run.score is not None
    plate, torques = (run.score.accuracy[method] for method in METHODS)
    assert headline(run) == summary(run)[0]
    for share in (plate.wrench, plate.torque, torques.torque):
        assert share is not None
        assert percent(share) in headline(run)
    assert torques.wrench is None
    assert "assumed" not in headline(run)
    errors = [f"measurement.torque_constant_error.{x}" for x in ("waist=0.05", "elbow=-0.08")]
    assumed = replace(run, experiment=tb.Experiment.of_model(MODELS["puma"], errors))
    assert "torque constants assumed 5 to 8 % off" in headline(assumed)
    said = verdict(run)
    assert said.startswith("The claim does not hold: external max z is ")
    assert "claimed at most 1e-09" in said
    assert "internal to external" not in said
    assert verdict(replace(run, experiment=experiment(expect={}))) == ""


@pytest.mark.parametrize(
    ("share", "said"),
    [(0.00031, "0.031 %"), (0.5, "50 %"), (0.996, "100 %"), (4.3, "430 %"), (-95.0, "-9500 %")],
)
def test_shares_have_two_digits_and_no_powers(share: float, said: str) -> None:
    assert percent(share) == said
