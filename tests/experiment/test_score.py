"""The judge is judged: every metric anew from what a run folder's result keeps."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import testbed as tb
from testbed.experiment.experiment_tables import ALWAYS_JUDGED, Bound
from testbed.experiment.results import result
from testbed.experiment.run import Run, assemble_run
from testbed.experiment.score import relative_errors
from testbed.identification.estimate import METHODS, SIGNAL_OF, Method
from tests.helpers.ideal import EXACT, ideal
from tests.helpers.runs import ROBOTS, experiment, judged_run, noisy, robot, run_of, without

pytestmark = pytest.mark.slow

Row = tuple[str, str, float, float, float]  # name, unit, value, sigma, truth

judged = cache(judged_run)


def rows(stored: dict[str, Any], method: Method) -> list[Row]:
    table = stored[method]
    columns = ("names", "units", "values", "sigma", "truth")
    return list(zip(*(table[column] for column in columns), strict=True))


def relative(row: Row, table: list[Row], run: Run | None = None) -> float | None:
    """The error over the true value, 1 % of the largest of its unit, 10 % of the torque."""
    name, unit, value, _, truth = row
    kind, _, joint = name.partition("/")
    if kind in ("coulomb", "viscous") and run is not None:
        j, recording = run.tree.names.index(joint), run.recording
        torque, speed = (recording.measured(s)[:, j] for s in ("torque", "velocity"))
        column = np.sign(speed) if kind == "coulomb" else speed
        usual = rms(torque.tolist()) / rms(column.tolist())
        return (value - truth) / max(abs(truth), usual / 10)
    largest = max(abs(other[4]) for other in table if other[1] == unit and "/" not in other[0])
    return None if largest == 0 else (value - truth) / max(abs(truth), largest / 100)


def told(errors: list[float | None]) -> list[float]:
    return [error for error in errors if error is not None]


def rms(errors: list[float]) -> float:
    return math.sqrt(math.fsum(error**2 for error in errors) / len(errors))


@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("method", METHODS)
def test_stored_errors_are_those_of_the_stored_values(name: str, method: Method) -> None:
    stored = result(judged(name))
    table = rows(stored, method)
    for row, share, z in zip(
        table, stored[method]["relative_error"], stored[method]["z"], strict=True
    ):
        _, _, value, sigma, truth = row
        assert z == pytest.approx((value - truth) / sigma, rel=1e-12)
        expected = relative(row, table, judged(name))
        assert share == (None if expected is None else pytest.approx(expected, rel=1e-12))
        if share:
            assert (share > 0) == (value > truth)  # whatever the sign of the truth


@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("method", METHODS)
def test_stored_truths_are_the_robots(name: str, method: Method) -> None:
    tree, table = robot(name), rows(result(judged(name)), method)
    model = tb.minimal_set(tree, "reaction" if method == "external" else "dynamic")
    true = dict(zip(model.names, model.values(tb.barycentric(tree)), strict=True))
    if method == "internal":
        for joint in tree.joints:
            true |= {f"coulomb/{joint.name}": joint.coulomb, f"viscous/{joint.name}": joint.viscous}
    assert {row[0]: row[4] for row in table} == pytest.approx(true, rel=1e-12)


@pytest.mark.parametrize("name", ROBOTS)
def test_every_metric_again_from_the_stored_table(name: str) -> None:
    stored, run = result(judged(name)), judged(name)
    expected: dict[str, float] = {}
    for method in METHODS:
        table, count = rows(stored, method), stored[method]["count"]
        own = told([relative(row, table) for row in table[:count]])
        expected[f"{method}_max_relative_error"] = max(map(abs, own))
        expected[f"{method}_max_z"] = max(abs(v - t) / s for _, _, v, s, t in table[:count])
    torques = rows(stored, "internal")
    count = stored["internal"]["count"]
    expected["internal_rms_relative_error"] = rms(
        told([relative(row, torques) for row in torques[:count]])
    )
    friction = told([relative(row, torques, run) for row in torques[count:]])
    expected["friction_max_relative_error"] = max(map(abs, friction))
    # delta_d = S delta_r, S from the sets' matrices alone
    dynamic, reaction = (tb.minimal_set(run.tree, m) for m in ("dynamic", "reaction"))
    s = np.linalg.lstsq(reaction.matrix.T, dynamic.matrix.T, rcond=None)[0].T
    by_plate = s @ np.array(stored["external"]["values"])
    shared = [(n, u, v, s, t) for (n, u, _, s, t), v in zip(torques, by_plate, strict=False)]
    errors = told([relative(row, shared) for row in shared])
    expected["external_rms_relative_error"] = rms(errors)
    expected["internal_to_external"] = expected["internal_rms_relative_error"] / rms(errors)
    assert stored["metrics"] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("name", ROBOTS)
def test_robots_have_every_metric(name: str) -> None:
    assert set(judged(name).metrics) == set(ALWAYS_JUDGED)


@pytest.mark.parametrize("viscous", [0.0, 1e-9, 1e-4])
def test_next_to_no_friction_is_judged_by_the_torque_that_its_error_makes(viscous: float) -> None:
    """Not by itself: the metric hardly knows a small coefficient from none."""
    tree = robot("ur5")
    none = judged("ur5").metrics["friction_max_relative_error"]
    damped = tree.with_joints({name: {"viscous": viscous} for name in tree.names})
    found = run_of(damped, asked=experiment()).metrics["friction_max_relative_error"]
    assert found == pytest.approx(none, rel=0.02)
    assert found < 0.5


def test_terms_that_do_not_resist_are_no_friction() -> None:
    settings = replace(EXACT, terms=("coulomb", "viscous", "offset"))
    tree = robot("puma")
    recording = noisy(ideal(tree))
    run = assemble_run(tree, recording, name="made", settings=settings, experiment=experiment())
    estimate, errors = run.estimates["internal"], run.score.errors["internal"]  # type: ignore[union-attr]
    kinds = [term.kind for term in estimate.joint_terms]
    relative = np.abs(errors.relative[estimate.minimal.count :])
    rubs = [k for k, kind in enumerate(kinds) if kind != "offset"]
    assert run.metrics["friction_max_relative_error"] == relative[rubs].max()
    assert np.isfinite(relative).all()


def test_scales_are_of_one_unit_and_never_of_rounding() -> None:
    units = ("kg", "kg", "kg m", "kg m", "N m")
    truth = np.array([40.0, 0.0, -2.0, 0.001, 1e-15])
    values = truth + 0.1
    found = relative_errors(values, truth, units)
    np.testing.assert_allclose(found[:4], [0.1 / 40, 0.1 / 0.4, 0.05, 0.1 / 0.02], rtol=1e-12)
    assert np.isnan(found[4])


@pytest.mark.parametrize("method", METHODS)
def test_a_method_without_estimate_has_no_metrics(method: Method) -> None:
    run = judged("puma")
    other = next(m for m in METHODS if m != method)
    recording = without(run.recording, SIGNAL_OF[other])
    alone = run_of(run.tree, recording, experiment())
    lost = {name for name in ALWAYS_JUDGED if name.startswith(f"{other}_")} | {
        "internal_to_external"
    }
    if method == "external":
        lost |= {"friction_max_relative_error"}
    assert alone.metrics == {k: v for k, v in run.metrics.items() if k not in lost}
    assert alone.score is not None
    assert set(alone.score.errors) == {method}
    assert set(alone.truths) == set(run.estimates[method].names)


def test_without_friction_in_the_plant_the_truth_is_none() -> None:
    asked = experiment()
    smooth = asked.model_copy(
        update={"simulation": asked.simulation.model_copy(update={"friction": False})}
    )
    run = run_of(robot("puma"), asked=smooth)
    assert {v for k, v in run.truths.items() if "/" in k} == {0.0}
    assert run.metrics["friction_max_relative_error"] > 1.0  # what was found is not there


@pytest.mark.parametrize("name", ROBOTS)
def test_better_data_have_better_scores(name: str) -> None:
    """A tenth of the noise is a tenth of every error; sigmas go with them."""
    tree = robot(name)
    perfect = ideal(tree)
    coarse, fine = (
        run_of(tree, noisy(perfect, size=size), experiment()).metrics for size in (0.01, 0.001)
    )
    for metric, value in coarse.items():
        same = metric.endswith(("_z", "to_external"))
        assert fine[metric] == pytest.approx(value if same else value / 10, rel=0.01), metric


def test_claims_about_what_is_not_there_fail() -> None:
    expect = {
        "friction_max_relative_error": Bound(at_most=1e9),
        "external_max_z": Bound(at_most=1e9),
    }
    plate = without(noisy(ideal(robot("ur5"))), "torque")
    run: Run = run_of(robot("ur5"), plate, experiment(expect=expect))
    assert run.verdicts == {"friction_max_relative_error": False, "external_max_z": True}
    assert not run.as_expected
