"""What the model leaves out is seen, named, counted in sigma; clean recordings stay as they are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import testbed as tb
from testbed.applications.validate import validate
from testbed.core.base.arrays import Array
from testbed.core.estimation.estimate import Estimate
from testbed.core.parameters.rules import Signal
from testbed.core.recordings.joined import joined
from testbed.core.robot.drive_torque import drive_torque
from testbed.core.robot.rotations import rotvec_to_matrix
from tests.helpers.measured import random_fourier
from tests.helpers.runs import robot

Model = Callable[[tb.Tree, tb.Motion], tuple[tb.Motion, Array, Array]]
"""Motion that the encoders show, torques and wrench of a robot with an error."""


def rigid(tree: tb.Tree, motion: tb.Motion) -> tuple[tb.Motion, Array, Array]:
    """The model itself."""
    torque = tb.joint_forces(tree, motion) + drive_torque(tree, motion.qd, motion.qdd)
    return motion, torque, tb.base_wrench(tree, motion)


def tilted(tree: tb.Tree, motion: tb.Motion) -> tuple[tb.Motion, Array, Array]:
    """On a base that leans by a degree."""
    return rigid(tree.with_gravity(rotvec_to_matrix([0.014, 0.01, 0.0]) @ tree.gravity), motion)


def off_zero(tree: tb.Tree, motion: tb.Motion) -> tuple[tb.Motion, Array, Array]:
    """By encoders whose zeros are 0.01 off."""
    signs = np.where(np.arange(tree.n) % 2, 1.0, -1.0)
    return replace(motion, q=motion.q + 0.01 * signs), *rigid(tree, motion)[1:]


def rubbing(tree: tb.Tree, motion: tb.Motion) -> tuple[tb.Motion, Array, Array]:
    """By gears whose friction is a tenth of the load."""
    _, torque, wrench = rigid(tree, motion)
    load = np.abs(tb.joint_forces(tree, motion)) * np.sign(motion.qd)
    return motion, torque + 0.1 * load, wrench


def elsewhere(tree: tb.Tree, motion: tb.Motion) -> tuple[tb.Motion, Array, Array]:
    """With joint frames that are some millimetres and a degree off."""
    rng = np.random.default_rng(3)
    joints = [
        replace(
            joint,
            offset=joint.offset + 2e-3 * rng.normal(size=3),
            rotation=joint.rotation @ rotvec_to_matrix(np.deg2rad(1.0) * rng.normal(size=3)),
        )
        for joint in tree.joints
    ]
    return rigid(replace(tree, joints=tuple(joints)), motion)


def recorded(
    tree: tb.Tree, model: Model, seed: int, duration: float = 20.0, begin: float = 0.0
) -> tb.Recording:
    """Recording at 200 Hz with little noise."""
    rng = np.random.default_rng(seed)
    motion = random_fourier(tree, rng, 1.0).at(begin + np.arange(0, duration, 0.005))
    rng = np.random.default_rng([seed, round(1e3 * begin)])
    shown, torque, wrench = model(tree, motion)
    tare = tb.pedestal_wrench(tree)
    noise = np.repeat([0.2, 0.05], 3) * rng.normal(size=wrench.shape)
    return tb.Recording(
        tree.names,
        motion.t,
        shown.q + 2e-5 * rng.normal(size=shown.q.shape),
        torque=torque + 0.1 * rng.normal(size=torque.shape),
        wrench=wrench + tare + noise,
        tare=tare,
    )


def scores(estimate: Estimate, tree: tb.Tree) -> Array:
    """Errors of the parameters of bodies in sigmas."""
    base = estimate.base
    return np.asarray((base.values - estimate.minimal.values(tb.barycentric(tree))) / base.sigma)


CASES = [
    (tilted, "torque", "tilt"),
    (tilted, "wrench", "tilt"),
    (off_zero, "torque", "joint_zeros"),
    (off_zero, "wrench", "joint_zeros"),
    (rubbing, "torque", "load_friction"),
    (elsewhere, "torque", "frames"),
    (elsewhere, "wrench", "frames"),
]


@pytest.mark.parametrize("name", ["ur5", "puma"])
@pytest.mark.parametrize(("model", "signal", "family"), CASES)
def test_an_error_of_the_model_is_named_and_sigma_holds(
    model: Model, signal: Signal, family: str, name: str
) -> None:
    """Without the search, sigma is of a robot that there is not."""
    tree = robot(name)
    recording = recorded(tree, model, 3)
    found = tb.identify(tree, recording, signal)
    assert np.mean(np.abs(scores(found, tree)) < 3) > 0.85
    # parameters of three joints imitate most
    if name == "ur5":
        assert family in {each.family for each in found.model_errors if each.named}
        assert any(each.code.startswith("model-error.") for each in found.diagnostics)


@pytest.mark.parametrize("name", ["ur5", "puma", "gantry"])
@pytest.mark.parametrize("signal", ["torque", "wrench"])
def test_a_clean_recording_has_the_estimate_that_it_had(name: str, signal: Signal) -> None:
    tree = robot(name)
    recording = recorded(tree, rigid, 5)
    found = tb.identify(tree, recording, signal)
    plain = tb.identify(tree, recording, signal, settings=tb.Settings(model_errors=False))
    assert found.model_errors == ()
    np.testing.assert_array_equal(found.values, plain.values)
    np.testing.assert_array_equal(found.covariance, plain.covariance)


def test_a_direction_of_gravity_is_found_with_its_size() -> None:
    """In degrees about the bedplate's axes; what lies along gravity changes nothing.

    A first moment that moves no torque on a level base does on another one: a tenth is open.
    """
    tree = robot("ur5")
    (error,) = tb.identify(tree, recorded(tree, tilted, 3), "torque").model_errors
    turned = {each.name: each for each in error.coefficients}
    for axis, radians in (("x", -0.014), ("y", -0.01)):
        own = turned[f"tilt/{axis}"]
        assert own.value == pytest.approx(np.rad2deg(radians), rel=0.1)
    assert turned["tilt/z"].sigma > 0.5


def test_another_motion_is_predicted_with_the_error_that_was_named() -> None:
    """As well as sigma says; by parameters alone it is not."""
    tree = robot("ur5")
    seen, unseen = (recorded(tree, tilted, seed) for seed in (3, 4))
    found = tb.identify(tree, seen, "torque")
    assert found.correction is not None
    ratio = validate(tree, unseen, found).ratio
    assert ratio.max() < 1.3
    alone = validate(tree, unseen, replace(found, correction=None))
    assert alone.residual.max() > 3 * validate(tree, unseen, found).residual.max()


@pytest.mark.parametrize("model", [rigid, elsewhere, rubbing])
def test_a_band_of_95_percent_holds_on_another_motion(model: Model) -> None:
    """As `validate` counts it in rows, in all channels together."""
    tree = robot("ur5")
    estimate = tb.identify(tree, recorded(tree, model, 3), "torque")
    other = recorded(tree, model, 4)
    found = tb.predict(other, estimate).smoothed(5.0)
    torques = [each for each in found.channels if each.kind == "torque"]
    left = np.stack([each.residuals["torque"] for each in torques], axis=1)
    within = np.abs(left) <= found.band["torque"]
    assert within.mean() > 0.93
    rows = validate(tree, other, estimate).within
    np.testing.assert_allclose(within.mean(axis=0), rows, atol=0.05)


def odd(tree: tb.Tree, motion: tb.Motion) -> tuple[tb.Motion, Array, Array]:
    """With a torque of the pose that no law describes."""
    _, torque, wrench = rigid(tree, motion)
    more = np.tanh(3 * np.sin(2 * motion.q + np.roll(motion.q, 1, axis=1)))
    return motion, torque + 0.05 * np.abs(torque).max(axis=0) * more, wrench


def test_what_nobody_knows_is_said_and_only_widens() -> None:
    tree = robot("ur5")
    recording = recorded(tree, odd, 3)
    found = tb.identify(tree, recording, "torque")
    plain = tb.identify(tree, recording, "torque", settings=tb.Settings(model_errors=False))
    assert found.model_errors
    assert np.mean(np.abs(scores(found, tree)) < 3) > np.mean(np.abs(scores(plain, tree)) < 3)
    if not any(each.corrected for each in found.model_errors):
        np.testing.assert_array_equal(found.values, plain.values)
        assert (found.sigma >= plain.sigma * (1 - 1e-12)).all()


def test_what_repeats_with_the_motion_is_no_noise() -> None:
    """Nearly all of an unknown torque comes again after a period; noise does not."""
    tree = robot("ur5")
    for model, duration, repeats in ((odd, 25.0, True), (odd, 17.0, True), (rigid, 25.0, False)):
        found = tb.identify(tree, recorded(tree, model, 4, duration), "torque")
        assert found.repeatable is not None
        assert found.repeatable.period == pytest.approx(10.0, abs=0.1)
        assert (found.repeatable.chance < 1e-6) == repeats
        assert ("estimate.repetition" in {each.code for each in found.diagnostics}) == repeats
        assert (found.repeatable.share.max() > 0.9) == repeats
    assert tb.identify(tree, recorded(tree, rigid, 4, 12.0), "torque").repeatable is None


def test_what_another_recording_of_the_motion_repeats_is_no_noise() -> None:
    """Two recordings of nine seconds begin where they like; of another motion nothing is known."""
    tree = robot("puma")
    for model, repeats in ((odd, True), (rigid, False)):
        parts = [recorded(tree, model, 5, 9.0, begin) for begin in (0.0, 0.2137)]
        found = tb.identify(tree, joined(parts), "torque")
        assert found.repeatable is not None
        assert found.repeatable.recordings == 2
        assert (found.repeatable.chance < 1e-6) == repeats
        assert ("estimate.repetition" in {each.code for each in found.diagnostics}) == repeats
    others = [recorded(tree, rigid, seed, 9.0) for seed in (5, 6)]
    assert tb.identify(tree, joined(others), "torque").repeatable is None


def test_of_a_few_rows_nothing_is_sought(puma: tb.Tree) -> None:
    """A recording of a second has no more rows than an autoregression has coefficients."""
    log = recorded(puma, elsewhere, 1, 1.1)
    assert not tb.identify(puma, log, "wrench", zeros=True).model_errors
