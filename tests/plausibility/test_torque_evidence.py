"""Logs of torques judged by evidence: what it is, what is found, and when there is no word.

Witnesses: a dense normal distribution, and Pinocchio's inverse dynamics of robots that are not as
their files say.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from scipy.stats import multivariate_normal

import testbed as tb
from benchmarks.planted_recordings import simulated
from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import sentences
from testbed.core.dynamics.newton_euler import Motion, joint_forces
from testbed.core.estimation.evidence import ChannelProducts, linear_evidence
from testbed.core.parameters.symbols import barycentric_from_standard, with_standard_parameters
from testbed.core.recordings.views import adapt_to_robot
from testbed.importing.check.assessment import Assessment, assess_recording
from testbed.importing.check.body_prior import body_prior
from testbed.importing.check.gravity_readings import GRAVITY_DIRECTIONS
from testbed.importing.check.torque_products import torque_products
from testbed.importing.check.torque_signals import TorqueSignals, torque_signals
from tests.helpers.measured import measured
from tests.helpers.robots import random_robot
from tests.helpers.runs import robot
from tests.helpers.strategies import few, rngs


@given(rng=rngs)
def test_evidence_is_that_of_the_dense_normal_distribution(rng: np.random.Generator) -> None:
    """Shared and local coefficients, channels of their own noise; of marginal ones the sums too."""
    channels, samples, shared, local = 3, 30, 4, 2
    columns = rng.normal(size=(channels, samples, shared + local))
    measured = rng.normal(size=(channels, samples))
    variance = rng.uniform(0.5, 2.0, channels)
    gram = columns.transpose(0, 2, 1) @ columns
    products = ChannelProducts(
        gram[:, :shared, :shared], gram[:, :shared, shared:], gram[:, shared:, shared:],
        (measured[:, None] @ columns)[:, 0], (measured**2).sum(axis=1),
        np.full(channels, float(samples)),
    )  # fmt: skip
    none = np.zeros(channels)
    found = linear_evidence(products, none, np.ones(channels), variance, iterations=1)
    dense = np.zeros((channels * samples, shared + channels * local))
    for k in range(channels):
        rows = slice(k * samples, (k + 1) * samples)
        dense[rows, :shared] = columns[k, :, :shared]
        dense[rows, shared + k * local : shared + (k + 1) * local] = columns[k, :, shared:]
    noise = np.repeat(variance, samples)
    covariance = dense @ dense.T + np.diag(noise)
    assert found.log_evidence == pytest.approx(
        multivariate_normal(cov=covariance).logpdf(measured.ravel())
    )
    posterior = np.linalg.inv(np.eye(dense.shape[1]) + dense.T / noise @ dense)
    mean = posterior @ (dense.T / noise @ measured.ravel())
    np.testing.assert_allclose(found.shared_mean, mean[:shared], atol=1e-9)
    np.testing.assert_allclose(found.local_mean.ravel(), mean[shared:], atol=1e-9)
    extra = rng.normal(size=(channels, samples, 2))
    residual = measured - np.einsum("ctp,cp->ct", columns, found.coefficients)
    cross = columns.transpose(0, 2, 1) @ extra
    gradient, information = found.additional_gradient(
        cross, extra.transpose(0, 2, 1) @ extra, (residual[:, None] @ extra)[:, 0]
    )
    flat = extra.reshape(-1, 2)
    inverse = np.linalg.inv(covariance)
    np.testing.assert_allclose(information, flat.T @ inverse @ flat, atol=1e-9)
    np.testing.assert_allclose(gradient, flat.T @ inverse @ measured.ravel(), atol=1e-9)


@few(5)
@given(rng=rngs)
def test_products_of_any_gravity_are_those_of_columns_made_under_it(
    rng: np.random.Generator,
) -> None:
    """Random trees; the file's bodies are the prior's mean."""
    tree = random_robot(rng, 4).tree()
    recording = measured(tree, int(rng.integers(1000)), duration=8.0)
    signals = torque_signals(recording)
    assert signals is not None
    prior, gravity = body_prior(tree), rng.normal(size=3) * 9.81
    size = np.ones(tree.n)
    free = torque_products(tree, signals, prior, size).products(gravity)
    fixed = torque_products(tree, signals, prior, size, gravity).products(gravity)
    noise = np.ones(tree.n), np.ones(tree.n)
    one, other = (linear_evidence(each, *noise, iterations=1) for each in (free, fixed))
    assert one.log_evidence == pytest.approx(other.log_evidence, rel=1e-6)
    np.testing.assert_allclose(one.residual_squares, other.residual_squares, rtol=1e-5, atol=1e-6)
    motion = Motion(np.arange(float(len(signals.q))), signals.q, signals.qd, signals.qdd)
    torque = joint_forces(tree, motion, gravity)
    bodies = barycentric_from_standard(tree, (prior.root @ prior.mean).reshape(tree.n, 10)).ravel()
    assert np.isfinite(bodies).all()
    square = linear_evidence(replace(fixed, moment=0 * fixed.moment), *noise, iterations=1)
    assert square.residual_squares.shape == (torque.shape[1],)


def judged(name: str, mount: str, fault: str, seed: int) -> tuple[Assessment, tb.Tree, Array]:
    """What is said of a planted log; its robot and gravity by direction."""
    case = simulated(name, "mount", mount, fault, seed)
    return assess_recording(case.tree, case.real), case.tree, np.array(case.right["gravity"]) / 9.81


@pytest.mark.slow
@pytest.mark.parametrize("mount", ["ceiling", "wall +x", "wall -y", "inclined 30", "inclined 3"])
@pytest.mark.parametrize("name", ["ur5", "xarm7"])
def test_where_gravity_points_is_found_without_a_word_of_it(name: str, mount: str) -> None:
    found, _, true = judged(name, mount, "", 31)
    (remedy,) = (each for each in found.remedies if each.kind == "gravity")
    direction = np.array(remedy.values) / np.linalg.norm(remedy.values)
    assert np.rad2deg(np.arccos(np.clip(direction @ true, -1, 1))) < 1.5
    assert found.errors
    assert "gravity" in sentences(found.diagnostics)[0]


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["", "load friction", "stribeck", "zero first"])
def test_of_a_level_robot_with_other_faults_nothing_is_said_of_gravity(fault: str) -> None:
    for name in ("ur5", "med7", "stanford"):
        found, *_ = judged(name, "level", fault, 32)
        assert not [each for each in found.remedies if each.kind != "torque_size"]
        assert "gravity" not in " ".join(sentences(found.diagnostics))


@pytest.mark.slow
def test_gravity_that_a_driver_subtracts_is_named_and_no_parameter_is_made_up() -> None:
    found, *_ = judged("ur5", "compensated", "", 33)
    assert [each.values for each in found.remedies if each.kind == "gravity"] == [(0.0, 0.0, 0.0)]
    found, *_ = judged("ur5", "compensated by file", "", 33)
    lines = [line for each in found.remedies for line in each.lines]
    assert lines == [("torque", "gravity", "removed")]


@pytest.mark.slow
def test_without_any_masses_gravity_and_senses_are_found_all_the_same() -> None:
    """A file of kinematics alone."""
    case = simulated("ur5", "mount", "wall +x", "", 34)
    bare = with_standard_parameters(case.tree, np.zeros((case.tree.n, 10)))
    found = assess_recording(bare, case.real)
    (remedy,) = (each for each in found.remedies if each.kind == "gravity")
    assert np.linalg.norm(np.array(remedy.values) / 9.81 - GRAVITY_DIRECTIONS["wall +x"]) < 0.1


@pytest.mark.slow
def test_torques_of_three_joints_that_a_driver_scales_twice_are_named() -> None:
    """Sizes beside each other, whichever bodies the robot has."""
    tree, recording = robot("ur5"), measured(robot("ur5"), 35, noise=0.2)
    factors = np.array([1.4, 1.4, 1.4, 1, 1, 1])
    scaled = replace(
        recording, wrench=None, tare=None, torque=recording.measured("torque") * factors
    )
    codes = {each.code for each in assess_recording(tree, scaled).diagnostics}
    assert codes & {"torque.factors", "torque.contradiction"}
    right = replace(recording, wrench=None, tare=None)
    codes = {each.code for each in assess_recording(tree, right).diagnostics}
    assert not codes & {"torque.factors", "torque.contradiction"}


def test_a_delay_is_taken_back_to_the_sample() -> None:
    """Torques read later are those of the motion."""
    tree = robot("puma")
    signals = torque_signals(measured(tree, 36, duration=10.0))
    assert isinstance(signals, TorqueSignals)
    np.testing.assert_allclose(signals.delayed(0.0), signals.torque)
    samples = 4
    later = signals.delayed(samples / signals.rate)
    np.testing.assert_allclose(
        later, signals.low_passed_torque[signals.sample_indices + samples], atol=1e-9
    )


def test_torques_without_the_files_gravity_are_the_drives_again() -> None:
    """Once, however often the recording is seen as the robot's."""
    tree, recording = robot("puma"), replace(measured(robot("puma"), 37, duration=6.0), truth=None)
    still = np.zeros_like(recording.position)
    weight = joint_forces(tree, Motion(recording.time, recording.position, still, still))
    mapping = {"torque": {"unit": "N m", "gravity": "removed"}}
    compensated = replace(
        recording,
        torque=recording.measured("torque") - weight,
        metadata=replace(recording.metadata, mapping=mapping),
    )
    again = adapt_to_robot(adapt_to_robot(compensated, tree), tree)
    np.testing.assert_allclose(again.measured("torque"), recording.measured("torque"))
    assert (again.metadata.mapping or {})["torque"] == {"unit": "N m"}
