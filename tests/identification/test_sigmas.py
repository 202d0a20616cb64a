"""Errors are of the size of sigma: under any noise, settings, plate's zero, facts and weights."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import testbed as tb
from testbed.applications.validate import motion_in
from testbed.core.base.arrays import Array
from testbed.core.base.codec import encode, json_text
from testbed.core.base.errors import SettingsError, TestbedError
from testbed.core.estimation.estimate import METHODS, Estimate, Method, by_influence, influence
from testbed.core.estimation.regression.constraints import parse_known
from testbed.core.robot.inertia import about
from tests.helpers.ideal import ideal, plus
from tests.helpers.measured import measured
from tests.helpers.plates import mass_of
from tests.helpers.refusals import refuses
from tests.helpers.runs import noisy, robot, run_of
from tests.helpers.strategies import few, settings


def scores(tree: tb.Tree, estimate: Estimate) -> Array:
    """Errors of the minimal parameters in units of sigma."""
    base = estimate.base
    return np.asarray((base.values - estimate.minimal.values(tb.barycentric(tree))) / base.sigma)


@pytest.mark.slow
@few(8)
@given(
    st.sampled_from(["puma", "gantry"]), settings, st.sampled_from(METHODS),
    st.sampled_from([0.0, 0.98]),
)  # fmt: skip
def test_sigma_is_the_size_of_the_error(
    name: str, how: tb.Settings, method: Method, memory: float
) -> None:
    """Under white and slow noise, however signals are treated."""
    tree = robot(name)
    if name != "puma":
        how = replace(how, zeros=False)
    if memory or "off" in (how.cutoff, how.position_cutoff):
        how = replace(how, cutoff=5.0, position_cutoff=20.0)
    found = tb.identify(tree, measured(tree, 1, memory=memory), method, settings=how)
    assert 0.3 < float(np.sqrt(np.mean(scores(tree, found) ** 2))) < 2.0
    assert found.noise is not None
    assert found.noise.factor >= 1.0


@pytest.mark.slow
def test_sigma_holds_where_noise_of_accelerations_passes_the_filter() -> None:
    """It draws plain least squares to zero, by up to 20 sigma here; drowned ones are named."""
    tree = robot("puma")
    how = tb.Settings(cutoff=20.0)
    found = tb.identify(tree, measured(tree, 1, duration=60.0), "internal", settings=how)
    assert 0.4 < float(np.sqrt(np.mean(scores(tree, found) ** 2))) < 1.7
    tree, rng = robot("gantry"), np.random.default_rng(0)
    fine = measured(tree, 0, duration=40.0, speed=0.25, memory=0.98, noise=0.1)
    coarse = replace(fine, position=fine.position + 5e-4 * rng.normal(size=fine.position.shape))
    noise_limited = [tb.identify(tree, each).noise for each in (fine, coarse)]
    assert [bool(each and each.noise_limited) for each in noise_limited] == [False, True]


@pytest.mark.slow
def test_what_a_plates_zero_hides_has_no_sigma() -> None:
    """It is found and told; all others hold; a known mass makes it known."""
    tree, rng = robot("puma"), np.random.default_rng(0)
    clean, zero = measured(tree), 3 * np.repeat([1.0, 0.2], 3) * rng.normal(size=6)
    off = plus(clean, wrench=zero)
    found = tb.identify(tree, off)
    assert found.unidentifiable == ("mbar1",)
    assert np.abs(scores(tree, found)).max() < 5
    noise = found.noise
    assert noise is not None
    assert noise.hidden == ("mbar1",)
    told = noise.bias_sigma > 0
    assert told.sum() >= 5
    np.testing.assert_array_less(np.abs(noise.bias - zero)[told], 5 * noise.bias_sigma[told])
    content = json.loads(json_text(encode(found)))
    assert content["unidentifiable"] == ["mbar1"]
    assert [k for k, s in enumerate(content["sigma"]) if s is None] == [found.names.index("mbar1")]
    known = tb.Settings(known={"mass": (mass_of(tree), 0.01)})
    sure = tb.identify(tree, off, settings=known)
    assert sure.unidentifiable == () == tb.identify(tree, clean).unidentifiable
    assert np.abs(scores(tree, sure)).max() < 5
    other = plus(measured(tree, 1), wrench=20 + zero)
    held, false = (tb.validate(each, other) for each in (found, tb.identify(tree, clean)))
    assert [each.code for each in held.diagnostics] == []
    assert {each.code for each in false.diagnostics} == {"estimate.prediction-offset"}


@pytest.mark.slow
def test_dry_friction_that_jumps_at_reversals_does_not_enter() -> None:
    """The further the reach the fewer the rows; whitened, more rows count than without any near."""
    tree = robot("puma")
    clean = measured(tree, noise=1e-3)
    speed = np.gradient(clean.position, clean.time, axis=0)
    stuck = np.where(np.abs(speed) < tb.Settings().deadband, 20.0, 0.0)  # a force that no law has
    errors, counts = [], []
    for reach in (None, 0.02, 0.05, 0.15, 10.0):
        how = tb.Settings(reversal_reach=reach, zeros=True)
        found = tb.identify(tree, plus(clean, torque=stuck), "internal", settings=how)
        truth = found.minimal.values(tb.barycentric(tree))
        errors.append(float(np.abs(found.base.values / truth - 1).max()))
        counts.append(sum(found.samples))
    assert counts[1:] == sorted(counts[1:], reverse=True)
    assert counts[1] > counts[0] > counts[3] > counts[4]
    assert max(errors[0], errors[3]) < 0.1 * errors[1]


@pytest.mark.slow
def test_facts_count_as_far_as_they_are_sure() -> None:
    """Held, a mass is had; its doubt comes back as far as the estimate moves; seen by moving it."""
    tree, recording = robot("puma"), measured(robot("puma"))

    def knowing(method: Method = "external", **known: float | tuple[float, float]) -> Estimate:
        return tb.identify(tree, recording, method, settings=tb.Settings(known=known))

    mass = mass_of(tree) + 1.0
    exact, moved, doubted = (knowing(mass=m) for m in (mass, mass + 1e-3, (mass, 0.05)))
    theta = (exact.minimal.lift @ exact.values).reshape(-1, 10)
    roots = [k for k, joint in enumerate(tree.joints) if joint.parent < 0]
    assert theta[roots, 0].sum() == pytest.approx(mass, abs=1e-9)
    slope = (moved.values - exact.values) / 1e-3
    wanted = np.sqrt(np.diagonal(exact.covariance) + (0.05 * slope) ** 2)
    np.testing.assert_allclose(doubted.values, exact.values)
    np.testing.assert_allclose(np.sqrt(np.diagonal(doubted.covariance)), wanted, rtol=0.02)
    plain, k = knowing("internal"), 3
    np.testing.assert_array_equal(plain.values, knowing("internal", mass=3.0).values)  # not told
    found = knowing("internal", **{plain.names[k]: float(plain.values[k])})
    assert np.abs((found.values - plain.values) / plain.sigma).max() < 0.01
    assert found.noise is not None
    assert plain.noise is not None
    column = plain.covariance[:, k]
    left = plain.covariance - np.outer(column, column) / plain.covariance[k, k]
    spread = np.sqrt(np.maximum(np.diagonal(left), 0)) * found.noise.factor / plain.noise.factor
    spread[k] = 0.0
    np.testing.assert_allclose(found.sigma, spread, rtol=0.02)


def test_facts_that_mean_nothing_are_refused() -> None:
    words = ["mass=20", "gain/Fz=1.01+-2e-3"]
    assert parse_known(words) == {"mass": (20.0, 0.0), "gain/Fz": (1.01, 2e-3)}
    for word in ("mass=", "=20", "mass=20+-much"):
        with refuses(SettingsError, word):
            parse_known([word])
    tree, recording = robot("puma"), measured(robot("puma"), duration=4.0)
    for names, culprit in (
        (["weight"], "weight"),
        (["centre/w"], "centre/w"),
        (["centre/z"], "centre/z"),
        (["centre/x@hip=1"], "hip"),
        (["mass", "mbar1"], "mbar1"),  # known twice
    ):
        with pytest.raises(TestbedError, match=culprit):
            tb.identify(tree, recording, settings=tb.Settings(known=dict.fromkeys(names, 0.1)))


@pytest.mark.slow
def test_a_plate_that_is_not_level_is_named() -> None:
    """By 1 degree; a level one is not."""
    tree = robot("ur5")
    leaning = tree.with_gravity(about(np.array([1.0, 0, 0]), 0.02) @ tree.gravity)
    for actual, said in ((leaning, True), (tree, False)):
        made = noisy(ideal(actual, duration=20.0), size=0.02)
        facts = {**made.facts, "gravity": tree.gravity.tolist()}
        found = tb.identify(tree, replace(made, facts=facts))
        assert any("level" in each.causes for each in found.diagnostics) == said


def test_a_parameter_counts_for_the_signal_that_it_makes_alone() -> None:
    """Witness: the regressor of the motion, unfiltered; the largest is told first."""
    tree = robot("gantry")
    recording = ideal(tree)
    found = run_of(tree, recording).estimates["external"]
    truth = found.minimal.values(tb.barycentric(tree))
    columns = tb.regressor(tree, motion_in(recording)[0], found.minimal) * truth
    parts = (columns[:, :3], columns[:, 3:])
    wanted = np.max(
        [np.linalg.norm(p, axis=(0, 1)) / np.linalg.norm(p.sum(axis=2)) for p in parts], axis=0
    )
    values = dict(zip(found.names, truth.tolist(), strict=True))
    large = wanted > 0.02 * wanted.max()
    np.testing.assert_allclose(influence(found, values)[large], wanted[large], rtol=0.2)
    assert by_influence([found], values)[0] == found.names[int(wanted.argmax())]
