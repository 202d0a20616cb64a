"""A run: what was measured, what it tells, how wrong that is, and what the instruments should read.

The judge is judged: scores anew from what a run's result keeps and from the robot's own truth.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import testbed as tb
from testbed.bodies.consistency.options import ConsistencyOptions
from testbed.core.base.arrays import Array
from testbed.core.base.codec import json_text
from testbed.core.base.diagnostics import Diagnostic
from testbed.core.dynamics.newton_euler import base_wrench, joint_forces
from testbed.core.estimation.regression.windows import row_weights
from testbed.core.parameters.rules import SIGNALS
from testbed.core.recordings.metadata import Metadata
from testbed.core.robot.inertia import ZERO_INERTIA
from testbed.lab.experiment import carry_out as module
from testbed.lab.experiment.carry_out import simulate_validation_recording, with_validation
from testbed.lab.experiment.evaluate import evaluate, perturbed_prior
from testbed.lab.experiment.experiment_tables import BASIC_METRICS, Bound, PriorTable
from testbed.lab.experiment.motions import experiment_motion, validation_motion
from testbed.lab.experiment.predict import predict
from testbed.lab.experiment.results import run_result
from testbed.lab.experiment.run import Run, assemble_run, bias_diagnostics, correlation_diagnostics
from testbed.lab.experiment.score import prediction_accuracies, relative_errors, torque_set_errors
from testbed.lab.experiment.summary import headline
from tests.helpers.ideal import EXACT, ideal, plus
from tests.helpers.paths import ROOT
from tests.helpers.runs import MODELS, ROBOTS, experiment, judged_run, noisy, robot, run_of, without
from tests.scenarios.scenarios import result


def scales(truth: Sequence[float], units: Sequence[str]) -> list[float]:
    """The true value, or 1 % of the largest of its unit; not a number where all are zero."""
    sizes = list(zip(np.abs(truth), units, strict=True))
    most = {unit: max(size for size, u in sizes if u == unit) for unit in units}
    return [max(size, most[unit] / 100) or np.nan for size, unit in sizes]


def rms(values: Any) -> float:
    return float(np.sqrt(np.nanmean(np.square(values))))


@pytest.mark.parametrize("name", ROBOTS)
def test_every_stored_error_and_metric_again_from_the_stored_values(name: str) -> None:
    """And truths that are the robot's, by the sets' matrices alone."""
    run = judged_run(name)
    assert run.score is not None
    stored, metrics = json.loads(json_text(run_result(run).document())), {}
    dynamic, reaction = (tb.minimal_set(run.tree, m) for m in ("torque", "wrench"))
    for method, model in (("wrench", reaction), ("torque", dynamic)):
        truth = model.values(tb.barycentric(run.tree)).tolist()
        scale, count = scales(truth, model.units), model.count
        for kind in ("coulomb", "viscous") if method == "torque" else ():
            for j, joint in enumerate(run.tree.joints):
                torque, speed = (run.recording.measured(s)[:, j] for s in ("torque", "velocity"))
                usual = rms(torque) / rms(np.sign(speed) if kind == "coulomb" else speed)
                truth.append(getattr(joint, kind))
                scale.append(max(truth[-1], usual / 10))
        found, errors = stored["estimates"][method], stored["score"]["errors"][method]
        gap, sigma = np.array(found["values"]) - truth, np.array(found["sigma"])
        z, share = gap / sigma, gap / scale
        np.testing.assert_allclose(errors["truth"], truth, rtol=1e-12)
        np.testing.assert_allclose(errors["z"], z, rtol=1e-12)
        np.testing.assert_allclose(np.array(errors["relative"], dtype=float), share, rtol=1e-12)
        metrics[f"{method}_max_relative_error"] = np.nanmax(np.abs(share[:count]))
        metrics[f"{method}_max_z"] = np.abs(z[:count]).max()
    metrics["friction_max_relative_error"] = np.nanmax(np.abs(share[count:]))
    metrics["torque_rms_relative_error"] = rms(share[:count])
    s = np.linalg.lstsq(reaction.matrix.T, dynamic.matrix.T, rcond=None)[0].T
    error = s @ np.array(stored["estimates"]["wrench"]["values"]) - truth[:count]
    metrics["wrench_rms_relative_error"] = rms(error / scale[:count])
    metrics["torque_to_wrench"] = rms(share[:count]) / rms(error / scale[:count])
    assert stored["score"]["metrics"] == pytest.approx(metrics, rel=1e-6)
    assert set(stored["score"]["metrics"]) == set(BASIC_METRICS)
    told = [share for each in run.score.accuracy.values() for share in vars(each).values()]
    assert all(f"{100 * share:.2g} %" in headline(run) for share in told if share is not None)


@pytest.mark.slow
def test_rounding_is_no_scale_and_friction_that_was_not_simulated_is_no_truth() -> None:
    """Else a run is judged by nothing, or praised for friction that it made up."""
    truth = np.array([40.0, 1e-15])
    assert np.isnan(relative_errors(truth, truth, ("kg", "N m"))).tolist() == [False, True]
    asked = experiment()
    plant = asked.simulation.model_copy(update={"friction": False})
    run = run_of(robot("puma"), asked=asked.model_copy(update={"simulation": plant}))
    assert {v for k, v in run.truths.items() if "/" in k} == {0.0}
    assert run.metrics["friction_max_relative_error"] > 1.0


def test_friction_of_effects_is_true() -> None:
    """Else a right coefficient of a law that no model file states is called wrong."""
    tree, joint = robot("puma"), "elbow"
    j = tree.index(joint)
    recording = noisy(ideal(tree))
    speed, torque = recording.measured("velocity"), recording.measured("torque").copy()
    dip = np.sign(speed[:, 1]) * np.exp(-((speed[:, 1] / 0.3) ** 2))
    torque[:, j] += 4.0 * speed[:, j] * np.abs(speed[:, j]) + 2.0 * speed[:, j]
    torque[:, 1] += 3.0 * dip
    effects = (
        {"kind": "friction_term", "term": "quadratic", "coefficient": {joint: 4.0}},
        {"kind": "friction_term", "term": "viscous", "coefficient": {joint: 2.0}},
        {"kind": "stribeck_friction", "coefficient": {tree.names[1]: 3.0}, "speed": 0.3},
        {"kind": "warming_drives", "viscous": 0.1},
    )
    asked = experiment().with_(simulation={"effect": effects})
    terms = ("coulomb", "viscous", f"quadratic/{joint}", f"stribeck@0.3/{tree.names[1]}")
    settings = replace(EXACT, terms=terms)
    run = tb.assemble_run(
        tree, replace(recording, torque=torque), name="made", settings=settings, experiment=asked
    )
    assert run.score is not None
    errors = run.score.errors["torque"]
    assert run.truths[f"quadratic/{joint}"] == 4.0
    assert run.truths[f"viscous/{joint}"] == tree.joints[j].viscous + 2.0
    assert run.truths[f"stribeck@0.3/{tree.names[1]}"] == 3.0
    assert np.abs(errors.z).max() < 5.0
    assert not list(bias_diagnostics(run.estimates["torque"], errors))


@pytest.mark.parametrize("name", ["puma", "gantry"])
def test_accuracy_is_what_another_robot_would_do(name: str) -> None:
    """Or the headline praises the wrong estimate; by inverse dynamics of slightly other bodies."""
    tree, recording = robot(name), ideal(robot(name))
    run, rng = run_of(tree, recording), np.random.default_rng(1)
    signals = (recording.measured(s) for s in ("position", "velocity", "acceleration"))
    motion = tb.Motion(recording.time, *signals)[::5]
    bodies = [
        tb.Inertia(f * body.mass, f * body.first_moment, f * body.tensor)
        for body, f in zip(tree.inertias, rng.uniform(0.8, 1.2, tree.n), strict=True)
    ]
    other = replace(tree, inertias=tuple(bodies))
    said = {}
    for method, estimate in run.estimates.items():
        values, own = np.array(estimate.values), estimate.minimal
        values[: own.count] = own.values(tb.barycentric(other))
        said[method] = replace(estimate, values=values)

    def share(signals: list[Array], first: NDArray[np.bool_]) -> float:
        """Of forces and moments, or joints of two kinds, the larger."""
        true, wrong = signals
        parts = [part for part in (first, ~first) if part.any()]
        gap, size = (
            [np.linalg.norm(each[:, part]) for part in parts] for each in (wrong - true, true)
        )
        return float(np.max(np.divide(gap, size)))

    wrenches = [base_wrench(each, motion) for each in (tree, other)]
    wrench = share([each - each.mean(axis=0) for each in wrenches], np.arange(6) < 3)
    torques = [joint_forces(each.without_friction(), motion) for each in (tree, other)]
    torque = share(torques, np.array([joint.revolute for joint in tree.joints]))
    found = prediction_accuracies(tree, said, False, motion)
    assert vars(found["wrench"]) == pytest.approx({"wrench": wrench, "torque": torque})
    assert vars(found["torque"]) == pytest.approx({"wrench": None, "torque": torque})


# one signal, another robot, another gravity


def test_one_signal_is_enough_for_one_method_and_its_metrics() -> None:
    """The same to the bit as with both; claims about what is not there fail."""
    tree, recording = robot("puma"), noisy(ideal(robot("puma")))
    bounds = {name: Bound(at_most=1e9) for name in ("wrench_max_z", "torque_max_z")}
    whole = run_of(tree, recording, experiment())
    for method, other in zip(SIGNALS, SIGNALS[::-1], strict=True):
        run = run_of(tree, without(recording, other), experiment(expect=bounds))
        assert (set(run.estimates), set(run.failures)) == ({method}, {other})
        assert other in run.failures[other]
        mine, same = run.estimates[method], whole.estimates[method]
        np.testing.assert_array_equal(mine.values, same.values)
        assert {k: whole.metrics[k] for k in run.metrics} == run.metrics
        assert {name.partition("_")[0] for name in run.metrics} <= {method, "friction"}
        assert run.verdicts == {f"{m}_max_z": m == method for m in SIGNALS}
        assert not run.as_expected
        assert {each.kind for each in predict(run).channels} == {method}
    run = run_of(tree, replace(recording, wrench=None, torque=None), experiment())
    assert (run.estimates, run.metrics, set(run.failures)) == ({}, {}, set(SIGNALS))


def test_a_run_is_judged_under_the_gravity_of_its_recording_with_the_warnings_of_both() -> None:
    """Else a robot on a slope, or on the moon, is called wrong by its own truth."""
    moon, tree = (0.3, 0.0, -1.6), robot("puma")
    there = ideal(tree.with_gravity(moon))
    run = run_of(tree, replace(there, metadata=Metadata(gravity=moon)), experiment())
    assert run.metrics["wrench_max_relative_error"] < 1e-9
    assert run.metrics["torque_max_relative_error"] < 1e-9
    hot = Diagnostic("note", "hot motor")
    there = replace(noisy(ideal(tree)), metadata=Metadata(diagnostics=(hot,)))
    odd = Diagnostic("note", "odd model")
    said = run_of(replace(tree, diagnostics=(odd,)), there).diagnostics
    assert {odd, hot} <= set(said)


# warnings and words


def test_parameters_that_are_told_apart_poorly_are_named_the_closest_first() -> None:
    external = judged_run("puma").estimates["wrench"]

    def lines(*values: float) -> list[str]:
        correlation = np.eye(len(external.names))
        for k, value in enumerate(values, 1):
            correlation[0, k] = correlation[k, 0] = value
        spread = correlation * np.outer(external.sigma, external.sigma)
        return [*map(str, correlation_diagnostics(replace(external, covariance=spread)))]

    assert lines(0.89) == []
    (line,) = lines(0.91, -0.97, 0.5)
    assert external.names[3] not in line
    assert line.index(f"{external.names[2]} (correlation -0.97") < line.index("0.91")


def test_errors_that_sigma_does_not_tell_are_named() -> None:
    run = judged_run("puma")
    assert run.score is not None
    for method in SIGNALS:
        estimate, errors = run.estimates[method], run.score.errors[method]
        assert list(bias_diagnostics(estimate, errors)) == []
        z = np.zeros(len(errors.z))
        z[[1, 3]] = 6.0, -40.0
        off = replace(estimate, values=errors.truth + z * estimate.sigma)
        wrong = replace(errors, z=z, relative=np.where(z == 0, 0.0, 0.1))
        (found,) = bias_diagnostics(off, wrong)
        assert found.method == method
        assert found.value == pytest.approx(40)
        assert estimate.names[3] in found.subject
    tree = robot("puma")  # without noise sigmas are rounding, and errors may be many of them
    exact = assemble_run(tree, ideal(tree), name="made", settings=EXACT, experiment=experiment())
    assert not [d for d in exact.diagnostics if d.code == "estimate.bias"]


# what the estimates say that the instruments should read


def test_one_low_pass_for_everything_and_short_recordings_all_the_same() -> None:
    tree = robot("puma")
    run = run_of(tree)
    found = predict(run)
    smooth, weights = found.smoothed(10.0), row_weights(found.recording.rate, 10.0)
    reach = len(weights) // 2
    np.testing.assert_array_equal(smooth.motion.t, found.motion.t[reach:-reach])
    for before, after in zip(found.channels, smooth.channels, strict=True):
        for method in SIGNALS:
            wanted = np.convolve(before.residuals[method], weights, "valid")
            np.testing.assert_allclose(after.residuals[method], wanted, rtol=1e-9, atol=1e-9)
    states = ideal(tree)
    encoders = replace(states, velocity=None, acceleration=None).part(0, 5)
    seen = predict(assemble_run(tree, encoders, name="short")).motion
    np.testing.assert_array_equal(seen.q, encoders.position)
    speed = states.measured("velocity")[:5]
    assert np.abs(seen.qd - speed)[1:-1].max() < 2e-3 * np.abs(speed).max()


# another motion, consistent bodies


@pytest.mark.slow
def test_another_motion_is_about_as_fast_lasts_no_longer_and_shows_what_it_shows(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Or estimates would be held against gravity alone, and friction against a crawl."""
    run = run_of(robot("puma"))
    other = noisy(ideal(run.tree, seed=8), 4)
    done = with_validation(run, plus(other, wrench=[0, 0, 0, 0, 0, 50.0]))
    (new,) = {*done.diagnostics} - {*run.diagnostics}
    wanted = "estimate.prediction-offset", "wrench", "channel Mz"
    assert (new.code, new.method, new.subject) == wanted
    assert with_validation(run, ideal(robot("gantry"))).validation == {}
    asked = tb.Experiment.of_model(MODELS["gantry"], ["motion.candidates=5", "seed=3"])
    motions = [make(asked, robot("gantry")) for make in (experiment_motion, validation_motion)]
    times = np.linspace(0, motions[0].period, 500, endpoint=False)
    for order in (1, 2):
        fast = [np.sqrt(np.mean(m.derivative(times, order) ** 2, axis=0)) for m in motions]
        assert (0.49 * fast[0] < fast[1]).all()
        assert (fast[1] < 1.01 * fast[0]).all()
    first, second = (m.derivative(times, 0) for m in motions)
    assert (np.abs(second - first).max(axis=0) > 0.2 * np.ptp(first, axis=0)).all()
    seen: list[tb.Experiment] = []

    def kept(asked: tb.Experiment, *_: object, installed: int, motion: tb.Fourier) -> None:
        assert installed == asked.seed - 1  # what chance decides once stays
        assert motion.fundamental == asked.motion.fundamental
        seen.append(asked)

    monkeypatch.setattr(module, "record", kept)
    for fundamental, duration, taken in ((0.1, 60.0, 12.0), (0.05, 60.0, 20.0), (0.1, 5.0, 5.0)):
        words = [f"motion.duration={duration}", f"motion.fundamental={fundamental}", "seed=7"]
        changed = tb.Experiment.of_model(MODELS["puma"], words)
        simulate_validation_recording(replace(run, experiment=changed))
        assert (seen[-1].motion.duration, seen[-1].seed) == (taken, 8)


@pytest.mark.slow
def test_consistent_bodies_are_judged_by_the_truth_and_a_wrong_model_file_is_of_the_seed() -> None:
    run: Run = result("bodies")
    metrics = run.metrics
    ratio = metrics["consistent_rms_relative_error"] / metrics["wrench_rms_relative_error"]
    assert metrics["consistent_to_plain"] == pytest.approx(ratio)
    assert metrics["prior_rms_relative_error"] > metrics["consistent_rms_relative_error"]
    asked = experiment(expect={"consistent_to_plain": Bound(at_most=1.5)})
    right, failed = (
        run_of(robot("puma"), asked=asked.model_copy(update={
            "prior": PriorTable(error=0.0), "consistent": ConsistencyOptions(known=known)}))
        for known in ({}, {"mass/nobody": 1.0})
    )  # fmt: skip
    assert right.metrics["prior_rms_relative_error"] < 1e-9
    assert (failed.consistent, failed.as_expected) == (None, False)
    tree = robot("ur5")
    one, same, other = (
        perturbed_prior(tree, asked.model_copy(update={"seed": k})).inertias for k in (3, 3, 4)
    )
    for a, b, c in zip(one, same, other, strict=True):
        np.testing.assert_array_equal(a.tensor, b.tensor)
        assert a.mass != c.mass
        assert np.linalg.eigvalsh(a.pseudo)[0] > 0
    bare = replace(tree, inertias=(ZERO_INERTIA,) * tree.n)  # links that only carry frames
    assert perturbed_prior(bare, asked).inertias == bare.inertias


@pytest.mark.slow
def test_the_floor_of_a_coarse_step_is_the_error_of_perfect_instruments() -> None:
    """By an experiment of such instruments, which shares only the motion and the plant."""
    words = ["motion.duration=6.0", "motion.candidates=1", "excitation.clearance=off"]

    def load(name: str, *more: str) -> tb.Experiment:
        return tb.Experiment.from_toml(ROOT / f"experiments/{name}.toml", [*words, *more])

    coarse = "simulation.step=1e-3"
    fine, noisy = load("table6"), load("table6", coarse)
    perfect = load("encoder_floor", coarse)
    assert "wrench_floor" not in evaluate(fine, tb.record(fine), methods=["wrench"]).metrics
    tree = tb.load_tree(MODELS["puma"])
    estimate = tb.identify(tree, tb.record(perfect), settings=perfect.identification)
    wanted = np.sqrt(np.mean(torque_set_errors(tree, estimate.base.values, zeros=True) ** 2))
    found = evaluate(noisy, tb.record(noisy), methods=["wrench"]).metrics
    assert found["wrench_floor"] == pytest.approx(wanted, rel=1e-6)
    assert found["wrench_floor"] < found["wrench_rms_relative_error"]
