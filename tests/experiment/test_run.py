"""A run: what was measured, what it tells, how wrong that is, and what the instruments should read.

The judge is judged: scores anew from what a run's result keeps and from the robot's own truth.
"""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import testbed as tb
from testbed.dynamics.inverse_dynamics import base_wrench, joint_forces
from testbed.errors import RecordingError
from testbed.excitation.fourier import Fourier
from testbed.experiment import unseen as module
from testbed.experiment.accuracy import accuracies
from testbed.experiment.consistent_run import with_consistent, wrong_prior
from testbed.experiment.experiment_tables import ALWAYS_JUDGED, Bound, PriorTable
from testbed.experiment.growth import growing_errors, growth
from testbed.experiment.motions import another_motion, motion_of
from testbed.experiment.predictions import predict
from testbed.experiment.results import result as as_json
from testbed.experiment.run import Run, assemble_run
from testbed.experiment.run_warnings import close_pairs, systematic_errors
from testbed.experiment.score import relative_errors
from testbed.experiment.summary import headline, percent, verdict
from testbed.experiment.unseen import on_unseen_motion, unseen, validated
from testbed.experiment.wrong_prior import wrong_bodies
from testbed.identification.estimate import METHODS, SIGNAL_OF, Estimate, Method
from testbed.identification.filters import row_weights
from testbed.identification.wishes import Wishes
from testbed.robot.inertia import NOTHING
from tests.helpers.ideal import EXACT, ideal, plus
from tests.helpers.runs import MODELS, ROBOTS, experiment, judged_run, noisy, robot, run_of, without
from tests.scenarios.scenarios import result

Row = tuple[str, str, float, float, float]  # name, unit, value, sigma, truth


def rms(errors: list[float]) -> float:
    return math.sqrt(math.fsum(error**2 for error in errors) / len(errors))


def relative(row: Row, table: list[Row], run: Run) -> float | None:
    """The error over the true value, 1 % of the largest of its unit, 10 % of the torque."""
    name, unit, value, _, truth = row
    kind, _, joint = name.partition("/")
    if kind in ("coulomb", "viscous"):
        j = run.tree.names.index(joint)
        torque, speed = (run.recording.measured(s)[:, j] for s in ("torque", "velocity"))
        column = np.sign(speed) if kind == "coulomb" else speed
        usual = rms(torque.tolist()) / rms(column.tolist())
        return (value - truth) / max(abs(truth), usual / 10)
    largest = max(abs(other[4]) for other in table if other[1] == unit and "/" not in other[0])
    return None if largest == 0 else (value - truth) / max(abs(truth), largest / 100)


@pytest.mark.parametrize("name", ROBOTS)
def test_every_stored_error_and_metric_again_from_the_stored_values(name: str) -> None:
    """And truths that are the robot's, by the sets' matrices alone."""
    run = judged_run(name)
    stored = json.loads(json.dumps(as_json(run)))
    columns, expected = ("names", "units", "values", "sigma", "truth"), {}
    tables: dict[Method, list[Row]] = {}
    for method in METHODS:
        of_method = stored[method]
        table = tables[method] = list(zip(*(of_method[c] for c in columns), strict=True))
        model = tb.minimal_set(run.tree, "reaction" if method == "external" else "dynamic")
        true = dict(zip(model.names, model.values(tb.barycentric(run.tree)), strict=True))
        for kind in ("coulomb", "viscous") if method == "internal" else ():
            true |= {f"{kind}/{joint.name}": getattr(joint, kind) for joint in run.tree.joints}
        assert {row[0]: row[4] for row in table} == pytest.approx(true, rel=1e-12)
        shares = [relative(row, table, run) for row in table]
        for row, own, share, z in zip(
            table, shares, of_method["relative_error"], of_method["z"], strict=True
        ):
            assert z == pytest.approx((row[2] - row[4]) / row[3], rel=1e-12)
            assert share == (None if own is None else pytest.approx(own, rel=1e-12))
        told = [share for share in shares[: model.count] if share is not None]
        expected[f"{method}_max_relative_error"] = max(map(abs, told))
        expected[f"{method}_max_z"] = max(abs(z) for z in of_method["z"][: model.count])
        if method == "internal":
            friction = [abs(share) for share in shares[model.count :] if share is not None]
            expected["internal_rms_relative_error"] = rms(told)
            expected["friction_max_relative_error"] = max(friction)
    dynamic, reaction = (tb.minimal_set(run.tree, m) for m in ("dynamic", "reaction"))
    s = np.linalg.lstsq(reaction.matrix.T, dynamic.matrix.T, rcond=None)[0].T
    by_plate = (s @ np.array(stored["external"]["values"])).tolist()
    shared = [
        (n, u, v, g, t) for (n, u, _, g, t), v in zip(tables["internal"], by_plate, strict=False)
    ]
    plate = [e for e in (relative(row, shared, run) for row in shared) if e is not None]
    expected["external_rms_relative_error"] = rms(plate)
    expected["internal_to_external"] = expected["internal_rms_relative_error"] / rms(plate)
    assert stored["metrics"] == pytest.approx(expected, rel=1e-6)
    assert set(stored["metrics"]) == set(ALWAYS_JUDGED)


@pytest.mark.slow
def test_scales_of_errors_never_are_rounding_nor_the_friction_itself() -> None:
    units = ("kg", "kg", "kg m", "kg m", "N m")
    truth = np.array([40.0, 0.0, -2.0, 0.001, 1e-15])
    found = relative_errors(truth + 0.1, truth, units)
    np.testing.assert_allclose(found[:4], [0.1 / 40, 0.1 / 0.4, 0.05, 0.1 / 0.02], rtol=1e-12)
    assert np.isnan(found[4])
    tree, name = robot("ur5"), "friction_max_relative_error"
    none = judged_run("ur5").metrics[name]
    damped = tree.with_joints({joint: {"viscous": 1e-4} for joint in tree.names})
    asked = experiment()  # a small coefficient is judged as none is
    assert run_of(damped, asked=asked).metrics[name] == pytest.approx(none, rel=0.02)
    plant = asked.simulation.model_copy(update={"friction": False})
    run = run_of(robot("puma"), asked=asked.model_copy(update={"simulation": plant}))
    assert {v for k, v in run.truths.items() if "/" in k} == {0.0}
    assert run.metrics[name] > 1.0  # what was found is not there


@pytest.mark.parametrize("name", ["puma", "gantry"])
def test_the_headline_is_what_another_robot_would_do_and_a_parameter_near_zero_rules_nothing(
    name: str,
) -> None:
    """Every body heavier or lighter by up to a fifth, by inverse dynamics."""
    tree, recording = robot(name), ideal(robot(name))
    run, rng = run_of(tree, recording), np.random.default_rng(1)
    signals = (recording.measured(s) for s in ("position", "velocity", "acceleration"))
    motion = tb.Motion(recording.time, *signals)[::5]
    bodies = [
        tb.Inertia(f * body.mass, f * body.first_moment, f * body.tensor)
        for body, f in zip(tree.inertias, rng.uniform(0.8, 1.2, tree.n), strict=True)
    ]
    other = replace(tree, inertias=tuple(bodies))

    def said(of: tb.Tree, method: Method, more: float = 0.0) -> Estimate:
        """An estimate that says what a robot is, but for its least parameter."""
        found = run.estimates[method]
        values, count = np.array(found.values), found.minimal.count
        values[:count] = found.minimal.values(tb.barycentric(of))
        least = int(np.argmin(np.abs(values[:count])))
        values[least] += more * np.abs(values[:count]).max()
        return replace(found, values=values)

    found = accuracies(tree, {m: said(other, m) for m in METHODS}, False, motion)
    turns = np.array([joint.revolute for joint in tree.joints])
    wrenches = [base_wrench(each, motion) for each in (tree, other)]
    wrenches = [each - each.mean(axis=0) for each in wrenches]
    torques = [joint_forces(each.without_friction(), motion) for each in (tree, other)]
    wanted = []
    for (true, wrong), parts in (
        (wrenches, [np.arange(6) < 3, np.arange(6) >= 3]),
        (torques, [part for part in (turns, ~turns) if part.any()]),
    ):
        gaps = [np.linalg.norm((wrong - true)[:, p]) / np.linalg.norm(true[:, p]) for p in parts]
        wanted.append(max(gaps))
    assert found["external"].wrench == pytest.approx(wanted[0], rel=1e-6)
    assert found["internal"].wrench is None
    for method in METHODS:
        assert found[method].torque == pytest.approx(wanted[1], rel=1e-6)
        near = accuracies(tree, {method: said(tree, method, 1e-4)}, False, motion)[method].torque
        assert near is not None
        assert near < 0.05


# one signal, another robot, another gravity


def test_one_signal_is_enough_for_one_method_and_its_metrics() -> None:
    """The same to the bit as with both; claims about what is not there fail."""
    tree, recording = robot("puma"), noisy(ideal(robot("puma")))
    bounds = {name: Bound(at_most=1e9) for name in ("external_max_z", "internal_max_z")}
    whole = run_of(tree, recording, experiment())
    for method, other in zip(METHODS, METHODS[::-1], strict=True):
        run = run_of(tree, without(recording, SIGNAL_OF[other]), experiment(expect=bounds))
        assert (set(run.estimates), set(run.failures)) == ({method}, {other})
        assert SIGNAL_OF[other] in run.failures[other]
        mine, same = run.estimates[method], whole.estimates[method]
        np.testing.assert_array_equal(mine.values, same.values)
        assert {k: whole.metrics[k] for k in run.metrics} == run.metrics
        assert {name.partition("_")[0] for name in run.metrics} <= {method, "friction"}
        assert run.verdicts == {f"{m}_max_z": m == method for m in METHODS}
        assert not run.as_expected
        assert [signal.kind for signal in predict(run).signals] == [SIGNAL_OF[method]]
    deaf = replace(EXACT, deadband=1e3)  # no joint row is left
    run = assemble_run(tree, recording, name="made", settings=deaf)
    assert (set(run.estimates), set(run.failures)) == ({"external"}, {"internal"})
    run = run_of(tree, replace(recording, wrench=None, torque=None), experiment())
    assert (run.estimates, run.metrics, set(run.failures)) == ({}, {}, set(METHODS))


def test_gravity_and_the_order_of_joints_are_the_recordings() -> None:
    moon, tree = [0.3, 0.0, -1.6], robot("puma")
    there = ideal(tree.with_gravity(moon))
    run = run_of(tree, replace(there, facts={"gravity": moon}), experiment())
    assert run.metrics["external_max_relative_error"] < 1e-9
    assert run.metrics["internal_max_relative_error"] < 1e-9
    recording, back = noisy(ideal(tree)), [2, 0, 1]
    signals = ("position", "velocity", "acceleration", "torque")
    moved: dict[str, Any] = {s: recording.measured(s)[:, back] for s in signals}
    names = tuple(tree.names[k] for k in back)
    turned, same = run_of(tree, replace(recording, names=names, truth=None, **moved)), run_of(tree)
    for method in METHODS:
        np.testing.assert_array_equal(
            turned.estimates[method].values, same.estimates[method].values
        )
    with pytest.raises(RecordingError):
        predict(run, ideal(robot("ur5")))
    odd = replace(tree, warnings=("odd model",))
    said = run_of(odd, replace(recording, facts={"warnings": ["hot motor", "odd model"]})).warnings
    assert (said.count("odd model"), said.count("hot motor")) == (1, 1)


# warnings and words


def test_parameters_that_are_told_apart_poorly_are_named_the_closest_first() -> None:
    external = judged_run("puma").estimates["external"]

    def lines(pairs: dict[tuple[int, int], float]) -> list[str]:
        correlation = np.eye(len(external.names))
        for (a, b), value in pairs.items():
            correlation[a, b] = correlation[b, a] = value
        spread = correlation * np.outer(external.sigma, external.sigma)
        return list(close_pairs(replace(external, covariance=spread)))

    assert lines({(0, 1): 0.89}) == []
    (line,) = lines({(0, 1): -0.97, (2, 3): 0.91, (4, 5): 0.5})
    assert all(name in line for name in (*external.names[:4], "-0.97", "0.91"))
    assert external.names[4] not in line
    (line,) = lines({(0, k): 0.9 + 0.01 * k for k in range(1, 8)})
    assert line.index("0.97") < line.index("0.96") < line.index("0.93")
    assert "0.92" not in line


def test_errors_that_sigma_does_not_tell_are_named_and_laid_on_their_method() -> None:
    run = judged_run("puma")
    assert run.score is not None
    for method, cause in zip(METHODS, ("plate", "torque constant"), strict=True):
        estimate, errors = run.estimates[method], run.score.errors[method]
        assert list(systematic_errors(estimate, errors)) == []
        z = np.zeros(len(errors.z))
        z[[1, 3]] = 6.0, -40.0
        off = replace(estimate, values=errors.truth + z * estimate.sigma)
        wrong = replace(errors, z=z, relative=np.where(z == 0, 0.0, 0.1))
        (found,) = systematic_errors(off, wrong)
        assert estimate.names[3] in found.subject
        assert found.number == pytest.approx(40)
        assert cause in found.causes[0]
    tree = robot("puma")  # without noise sigmas are rounding, and errors may be many of them
    exact = assemble_run(tree, ideal(tree), name="made", settings=EXACT, experiment=experiment())
    assert {f.code for f in exact.findings} <= {f.code for f in run.findings}


def test_headline_and_verdict_say_the_figures() -> None:
    run = judged_run("puma")
    assert run.score is not None
    plate, torques = (run.score.accuracy[method] for method in METHODS)
    for share in (plate.wrench, plate.torque, torques.torque):
        assert share is not None
        assert percent(share) in headline(run)
    tight = {"external_max_z": Bound(at_most=1e-9), "internal_to_external": Bound(at_least=0.0)}
    said = verdict(replace(run, experiment=experiment(expect=tight)))
    assert "external max z" in said
    assert "internal to external" not in said
    assert verdict(run) == ""
    alone = run_of(robot("puma"))
    assert (alone.score, alone.truths, alone.metrics, alone.as_expected) == (None, {}, {}, True)
    for share, text in ((3e-4, "0.03 %"), (0.114, "11 %"), (4.3, "430 %")):
        assert percent(share) == text


# what the estimates say that the instruments should read


def test_one_low_pass_for_everything_and_short_recordings_all_the_same() -> None:
    tree = robot("puma")
    run = run_of(tree)
    found = predict(run)
    smooth, weights = found.smoothed(10.0), row_weights(found.recording.rate, 10.0)
    reach = len(weights) // 2
    np.testing.assert_array_equal(smooth.motion.t, found.motion.t[reach:-reach])
    for before, after in zip(found.signals, smooth.signals, strict=True):
        for method in METHODS:
            columns = before.residual(method).T
            wanted = np.column_stack([np.convolve(v, weights, "valid") for v in columns])
            np.testing.assert_allclose(after.residual(method), wanted, rtol=1e-9, atol=1e-9)
    states = ideal(tree)
    encoders = replace(states, velocity=None, acceleration=None)
    short = assemble_run(tree, encoders.part(0, 5), name="short", settings=tb.Settings())
    seen = predict(short)
    assert short.estimates == {}
    np.testing.assert_array_equal(seen.motion.q, encoders.position[:5])
    speed = states.measured("velocity")[:5]
    assert np.abs(seen.motion.qd - speed)[1:-1].max() < 2e-3 * np.abs(speed).max()
    brief = predict(run, states.part(0, 30))
    assert brief.smoothed(1.0) is brief


# growth, another motion, consistent bodies


def test_growth_passes_through_the_estimates_of_parts_and_ends_at_the_whole() -> None:
    """With the run's own settings; its errors end at the scores, or at zero without truth."""
    tree, settings_ = robot("puma"), replace(EXACT, deadband=0.1)
    recording = noisy(ideal(tree))
    late = replace(recording, time=recording.time + 100.0)
    asked = experiment()
    run = assemble_run(tree, recording, name="made", settings=settings_, experiment=asked)
    after = growth(assemble_run(tree, late, name="made", settings=settings_), [5.0, 99.0])
    assert run.score is not None
    for method, grown in growth(run, [5.0, 99.0]).items():
        assert grown.time.tolist() == [5.0, recording.time[-1]]
        np.testing.assert_array_equal(grown.values[-1], run.estimates[method].values)
        part = tb.identify(tree, recording.part(0, 1001), method, settings=settings_)
        np.testing.assert_array_equal(grown.values[0], part.values)
        np.testing.assert_array_equal(grown.sigma[0], part.sigma)
        np.testing.assert_allclose(after[method].time - 100.0, grown.time)
        errors, count = growing_errors(run, method, grown), len(run.estimates[method].base.names)
        np.testing.assert_allclose(errors[-1], run.score.errors[method].relative[:count])
        untold = growing_errors(replace(run, score=None), method, grown)
        assert np.abs(untold[0]).max() > 0
        assert not untold[-1].any()


@pytest.mark.slow
def test_another_motion_is_about_as_fast_lasts_no_longer_and_shows_what_it_shows(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Or estimates would be held against gravity alone, and friction against a crawl."""
    run = run_of(robot("puma"))
    other = noisy(ideal(run.tree, seed=8), 4)
    done = validated(run, plus(other, wrench=[0, 0, 0, 0, 0, 50.0]))
    (new,) = done.findings[len(run.findings) :]
    assert (new.code, new.method, new.subject) == ("prediction", "external", "channel Mz")
    assert validated(run, ideal(robot("gantry"))).validation == {}
    assert unseen(replace(run, experiment=None)) is None
    assert on_unseen_motion(replace(run, estimates={}))[1] is None
    asked = tb.Experiment.of_model(MODELS["gantry"], ["motion.candidates=5", "seed=3"])
    motions = [make(asked, robot("gantry")) for make in (motion_of, another_motion)]
    times = np.linspace(0, motions[0].period, 500, endpoint=False)
    for order in (1, 2):
        fast = [np.sqrt(np.mean(m.derivative(times, order) ** 2, axis=0)) for m in motions]
        assert (0.49 * fast[0] < fast[1]).all()
        assert (fast[1] < 1.01 * fast[0]).all()
    first, second = (m.derivative(times, 0) for m in motions)
    assert (np.abs(second - first).max(axis=0) > 0.2 * np.ptp(first, axis=0)).all()
    seen: list[tb.Experiment] = []

    def kept(asked: tb.Experiment, progress: object, installed: int, motion: object) -> None:
        assert isinstance(motion, Fourier)
        assert installed == asked.seed - 1  # what chance decides once stays
        seen.append(asked)

    monkeypatch.setattr(module, "simulate", kept)
    for fundamental, duration, taken in ((0.1, 60.0, 12.0), (0.05, 60.0, 20.0), (0.1, 5.0, 5.0)):
        words = [f"motion.duration={duration}", f"motion.fundamental={fundamental}", "seed=7"]
        unseen(replace(run, experiment=tb.Experiment.of_model(MODELS["puma"], words)))
        assert (seen[-1].motion.duration, seen[-1].seed) == (taken, 8)


@pytest.mark.slow
def test_consistent_bodies_are_judged_by_the_truth_and_a_wrong_model_file_is_of_the_seed() -> None:
    run: Run = result("bodies")
    metrics = run.metrics
    ratio = metrics["consistent_rms_relative_error"] / metrics["external_rms_relative_error"]
    assert metrics["consistent_to_plain"] == pytest.approx(ratio)
    assert metrics["prior_rms_relative_error"] > metrics["consistent_rms_relative_error"]
    said = json.loads(json.dumps(as_json(run)))["consistent"]["links"]
    assert set(said) == {joint.body for joint in run.tree.joints}
    asked = experiment(expect={"consistent_to_plain": Bound(at_most=1.5)})
    plain = run_of(robot("puma"), asked=asked)
    assert with_consistent(plain) is plain
    wishes = asked.model_copy(update={"consistent": Wishes(), "prior": PriorTable(error=0.0)})
    right = with_consistent(replace(plain, experiment=wishes))
    assert right.metrics["prior_rms_relative_error"] < 1e-9
    nobody = wishes.model_copy(update={"consistent": Wishes(known={"mass/nobody": 1.0})})
    failed = with_consistent(replace(plain, experiment=nobody))
    assert (failed.consistent, failed.as_expected) == (None, False)
    tree, rng = robot("ur5"), np.random.default_rng(0)
    one, same, other = (
        wrong_prior(tree, experiment().model_copy(update={"seed": k})) for k in (3, 3, 4)
    )
    for a, b, c in zip(one.inertias, same.inertias, other.inertias, strict=True):
        np.testing.assert_array_equal(a.tensor, b.tensor)
        assert a.mass != c.mass
        assert np.linalg.eigvalsh(a.pseudo)[0] > 0
    bare = replace(tree, inertias=(NOTHING,) * tree.n)
    assert wrong_bodies(bare, 0.3, rng).inertias == bare.inertias
