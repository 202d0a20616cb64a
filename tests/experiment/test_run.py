"""A run: what was measured, what it tells, how wrong that is, and what the instruments should read.

Its numbers are the scenarios'; here is what they mean.
"""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import testbed as tb
from testbed.errors import RecordingError
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
from testbed.experiment.unseen import on_unseen_motion, unseen, validated
from testbed.experiment.wrong_prior import wrong_bodies
from testbed.identification.estimate import METHODS, SIGNAL_OF, Estimate, Method
from testbed.identification.filters import row_weights
from testbed.identification.wishes import Wishes
from testbed.parameters.barycentric import with_standard
from testbed.robot.inertia import NOTHING
from tests.helpers.ideal import EXACT, ideal, plus, true_values
from tests.helpers.runs import MODELS, ROBOTS, experiment, judged_run, noisy, robot, run_of, without
from tests.scenarios.scenarios import result


@pytest.mark.parametrize("name", ROBOTS)
def test_what_is_stored_is_judged_by_the_robots_own_truth(name: str) -> None:
    run = judged_run(name)
    stored = json.loads(json.dumps(as_json(run)))
    assert set(stored["metrics"]) == set(ALWAYS_JUDGED)
    for method in METHODS:
        said, count = stored[method], run.estimates[method].minimal.count
        value, sigma, truth, z = (np.array(said[k]) for k in ("values", "sigma", "truth", "z"))
        np.testing.assert_allclose(truth, true_values(run.tree, method), rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(z, (value - truth) / sigma, rtol=1e-12)
        told = np.array(said["relative_error"], dtype=float)[:count]
        most = stored["metrics"][f"{method}_max_relative_error"]
        assert most == pytest.approx(np.nanmax(np.abs(told)), rel=1e-12)


@pytest.mark.slow
def test_scales_of_errors_never_are_rounding_nor_the_friction_itself() -> None:
    """A parameter counts for at least 1 % of the largest of its unit, friction for what shows."""
    units = ("kg", "kg", "kg m", "kg m", "N m")
    truth = np.array([40.0, 0.0, -2.0, 0.001, 1e-15])
    found = relative_errors(truth + 0.1, truth, units)
    np.testing.assert_allclose(found[:4], [0.1 / 40, 0.1 / 0.4, 0.05, 0.1 / 0.02], rtol=1e-12)
    assert np.isnan(found[4])
    name, asked = "friction_max_relative_error", experiment()
    plant = asked.simulation.model_copy(update={"friction": False})
    run = run_of(robot("puma"), asked=asked.model_copy(update={"simulation": plant}))
    assert {v for k, v in run.truths.items() if "/" in k} == {0.0}
    assert run.metrics[name] > 1.0  # what was found is not there


@pytest.mark.parametrize("name", ["puma", "gantry"])
def test_the_headline_is_what_another_robot_would_do(name: str) -> None:
    """By inverse dynamics; a parameter near zero rules nothing."""
    tree, recording = robot(name), ideal(robot(name))
    run, rng = run_of(tree, recording), np.random.default_rng(1)
    signals = (recording.measured(s) for s in ("position", "velocity", "acceleration"))
    motion = tb.Motion(recording.time, *signals)[::5]
    bodies = np.array([[f] * 10 for f in rng.uniform(0.8, 1.2, tree.n)]) * tb.standard(tree)
    other = with_standard(tree, bodies)  # every one heavier or lighter

    def said(of: tb.Tree, method: Method, more: float = 0.0) -> Estimate:
        """An estimate that says what a robot is, but for its least parameter."""
        found = run.estimates[method]
        values, count = np.array(found.values), found.minimal.count
        values[:count] = found.minimal.values(tb.barycentric(of))
        values[int(np.argmin(np.abs(values[:count])))] += more * np.abs(values[:count]).max()
        return replace(found, values=values)

    def gap(true: Any, wrong: Any, parts: list[Any]) -> float:
        each = [np.linalg.norm((wrong - true)[:, p]) / np.linalg.norm(true[:, p]) for p in parts]
        return float(max(each))

    turns = np.array([joint.revolute for joint in tree.joints])
    wrenches = (tb.base_wrench(each, motion) for each in (tree, other))
    wrench = gap(*(each - each.mean(axis=0) for each in wrenches), [slice(3), slice(3, 6)])
    torques = (tb.joint_forces(each, motion) for each in (tree, other))
    torque = gap(*torques, [part for part in (turns, ~turns) if part.any()])
    found = accuracies(tree, {m: said(other, m) for m in METHODS}, False, motion)
    near = accuracies(tree, {m: said(tree, m, 1e-4) for m in METHODS}, False, motion)
    assert found["external"].wrench == pytest.approx(wrench, rel=1e-6)
    for method in METHODS:
        assert found[method].torque == pytest.approx(torque, rel=1e-6)
        assert (near[method].torque or 1.0) < 0.05


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
        assert run.verdicts == {f"{m}_max_z": m == method for m in METHODS}
        assert not run.as_expected
        assert [signal.kind for signal in predict(run).signals] == [SIGNAL_OF[method]]
    deaf = replace(EXACT, deadband=1e3)  # no joint row is left
    run = assemble_run(tree, recording, name="made", settings=deaf)
    assert (set(run.estimates), set(run.failures)) == ({"external"}, {"internal"})
    alone = run_of(tree, recording)
    assert (alone.score, alone.truths, alone.metrics, alone.as_expected) == (None, {}, {}, True)


def test_gravity_and_the_order_of_joints_are_the_recordings() -> None:
    moon, tree = [0.3, 0.0, -1.6], robot("puma")
    there = ideal(tree.with_gravity(moon))
    run = run_of(tree, replace(there, facts={"gravity": moon}), experiment())
    assert max(run.metrics[f"{method}_max_relative_error"] for method in METHODS) < 1e-9
    recording, back = noisy(ideal(tree)), [2, 0, 1]
    signals = ("position", "velocity", "acceleration", "torque")
    moved: dict[str, Any] = {s: recording.measured(s)[:, back] for s in signals}
    names = tuple(tree.names[k] for k in back)
    turned, same = run_of(tree, replace(recording, names=names, truth=None, **moved)), run_of(tree)
    for method in METHODS:
        one, other = (each.estimates[method].values for each in (turned, same))
        np.testing.assert_array_equal(one, other)
    with pytest.raises(RecordingError):
        predict(run, ideal(robot("ur5")))
    odd = replace(tree, warnings=("odd model",))
    said = run_of(odd, replace(recording, facts={"warnings": ["hot motor", "odd model"]})).warnings
    assert (said.count("odd model"), said.count("hot motor")) == (1, 1)


# warnings and words


def test_parameters_that_are_told_apart_poorly_are_named_the_closest_first() -> None:
    external = judged_run("puma").estimates["external"]
    correlation = np.eye(len(external.names))
    correlation[0, 1:9] = correlation[1:9, 0] = [0.89, *np.arange(0.91, 0.96, 0.01), -0.97, 0.96]
    spread = correlation * np.outer(external.sigma, external.sigma)
    (line,) = close_pairs(replace(external, covariance=spread))
    assert line.index("-0.97") < line.index("0.96") < line.index("0.95")
    assert all(external.names[k] in line for k in (0, 6, 7, 8))
    assert not any(number in line for number in ("0.89", "0.92"))
    assert not list(close_pairs(replace(external, covariance=np.diag(external.sigma**2))))


def test_errors_that_sigma_does_not_tell_are_named_and_laid_on_their_method() -> None:
    run = judged_run("puma")
    assert run.score is not None
    for method, cause in zip(METHODS, ("plate", "torque constant"), strict=True):
        estimate, errors = run.estimates[method], run.score.errors[method]
        assert list(systematic_errors(estimate, errors)) == []
        z = np.zeros(len(errors.z))
        z[[1, 3]] = 6.0, -40.0
        off = replace(estimate, values=errors.truth + z * estimate.sigma)
        (found,) = systematic_errors(off, replace(errors, z=z, relative=0.1 * np.sign(z)))
        assert estimate.names[3] in found.subject
        assert found.number == pytest.approx(40)
        assert cause in found.causes[0]


# what the estimates say that the instruments should read


def test_one_low_pass_for_everything_and_short_recordings_all_the_same() -> None:
    run, states = run_of(robot("puma")), ideal(robot("puma"))
    found = predict(run)
    smooth, weights = found.smoothed(10.0), row_weights(found.recording.rate, 10.0)
    reach = len(weights) // 2
    np.testing.assert_array_equal(smooth.motion.t, found.motion.t[reach:-reach])
    for before, after in zip(found.signals, smooth.signals, strict=True):
        for method in METHODS:
            wanted = np.apply_along_axis(np.convolve, 0, before.residual(method), weights, "valid")
            np.testing.assert_allclose(after.residual(method), wanted, rtol=1e-9, atol=1e-9)
    encoders = replace(states, velocity=None, acceleration=None)
    short = assemble_run(run.tree, encoders.part(0, 5), name="short", settings=tb.Settings())
    assert short.estimates == {}
    np.testing.assert_array_equal(predict(short).motion.q, encoders.position[:5])
    brief = predict(run, states.part(0, 30))
    assert brief.smoothed(1.0) is brief


# growth, another motion, consistent bodies


def test_growth_passes_through_the_estimates_of_parts_and_ends_at_the_whole() -> None:
    """With the run's own settings; its errors end at the scores, or at zero without truth."""
    tree, settings_ = robot("puma"), replace(EXACT, deadband=0.1)
    recording = noisy(ideal(tree))
    late = replace(recording, time=recording.time + 100.0)
    run = assemble_run(tree, late, name="made", settings=settings_, experiment=experiment())
    assert run.score is not None
    for method, grown in growth(run, [5.0, 99.0]).items():
        assert grown.time.tolist() == [105.0, late.time[-1]]
        np.testing.assert_array_equal(grown.values[-1], run.estimates[method].values)
        part = tb.identify(tree, late.part(0, 1001), method, settings=settings_)
        np.testing.assert_array_equal(grown.values[0], part.values)
        np.testing.assert_array_equal(grown.sigma[0], part.sigma)
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
        assert ((0.49 * fast[0] < fast[1]) & (fast[1] < 1.01 * fast[0])).all()
    first, second = (m.derivative(times, 0) for m in motions)
    assert (np.abs(second - first).max(axis=0) > 0.2 * np.ptp(first, axis=0)).all()
    seen: list[tuple[float, int, int]] = []

    def kept(asked: tb.Experiment, progress: object, installed: int, motion: object) -> None:
        seen.append((asked.motion.duration, asked.seed, installed))

    monkeypatch.setattr(module, "simulate", kept)
    for fundamental, duration, taken in ((0.1, 60.0, 12.0), (0.05, 60.0, 20.0), (0.1, 5.0, 5.0)):
        words = [f"motion.duration={duration}", f"motion.fundamental={fundamental}", "seed=7"]
        unseen(replace(run, experiment=tb.Experiment.of_model(MODELS["puma"], words)))
        assert seen[-1] == (taken, 8, 7)  # other noise; what chance decides once stays


@pytest.mark.slow
def test_consistent_bodies_are_judged_by_the_truth_and_a_wrong_model_file_is_of_the_seed() -> None:
    run: Run = result("bodies")
    assert run.metrics["prior_rms_relative_error"] > run.metrics["consistent_rms_relative_error"]
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
    tree = robot("ur5")
    seeds = (experiment().model_copy(update={"seed": k}) for k in (3, 3, 4))
    one, same, other = (wrong_prior(tree, each).inertias for each in seeds)
    for a, b, c in zip(one, same, other, strict=True):
        np.testing.assert_array_equal(a.pseudo, b.pseudo)
        assert a.mass != c.mass
        assert np.linalg.eigvalsh(a.pseudo)[0] > 0
    bare = replace(tree, inertias=(NOTHING,) * tree.n)
    assert wrong_bodies(bare, 0.3, np.random.default_rng(0)).inertias == bare.inertias
