"""What is known beforehand: exact algebra, and estimates under facts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import testbed as tb
from testbed.errors import SettingsError, TestbedError, UnknownName
from testbed.identification.known import Facts, free, parse_known
from testbed.identification.settings import Settings
from tests.helpers.measured import measured
from tests.helpers.runs import ROBOTS, robot


def some_facts(rng: np.random.Generator, count: int, size: int) -> Facts:
    rows = rng.normal(size=(count, size)) * (rng.uniform(size=(count, size)) < 0.5)
    rows[:, 0] += 1.0
    names = tuple(f"fact {k}" for k in range(count))
    none = np.zeros((count, size))
    values = rng.normal(size=count)
    return Facts(names, rows, values, np.zeros((count, count)), none, np.zeros(count))


@pytest.mark.parametrize("seed", range(5))
def test_what_facts_leave_free_satisfies_them(seed: int) -> None:
    rng = np.random.default_rng(seed)
    given = some_facts(rng, 1 + seed % 3, 6)
    left = free(given)
    unknowns = left.fixed @ given.values + left.lead @ rng.normal(size=left.lead.shape[1])
    np.testing.assert_allclose(given.rows @ unknowns, given.values, atol=1e-12)
    assert np.linalg.matrix_rank(left.lead) == 6 - len(given)


def test_a_fact_that_follows_from_others_is_refused() -> None:
    given = some_facts(np.random.default_rng(0), 3, 5)
    rows = given.rows.copy()
    rows[2] = rows[0] - 2 * rows[1]
    with pytest.raises(SettingsError, match="'fact 2' is known twice"):
        free(replace(given, rows=rows))


@pytest.mark.slow
@pytest.mark.parametrize("name", ROBOTS)
def test_the_mass_of_all_moving_bodies(name: str) -> None:
    """Held at a wrong value, the estimate has it, and the bedplate's force at rest shows it."""
    tree = robot(name)
    known = Settings(known={"mass": 12.5})
    found = tb.identify(tree, measured(tree, noise=0.1), settings=known)
    theta = (found.minimal.lift @ found.values).reshape(-1, 10)
    roots = [k for k, joint in enumerate(tree.joints) if joint.parent < 0]
    assert theta[roots, 0].sum() == pytest.approx(12.5, abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["external", "internal"])
@pytest.mark.parametrize("name", ["puma", "random"])
def test_knowing_what_was_found_changes_nothing_else(name: str, method: str) -> None:
    """And the covariance becomes that of the others, given it: by the rule for Gaussians.

    But for the noise, of which there is then one degree of freedom more. The plate has zeros that
    nobody doubts: where it is open whether there are constants, a fact speaks of that, too.
    """
    tree = robot(name)
    recording = measured(tree)
    recording = replace(recording, wrench=recording.measured("wrench") + 20.0)
    plain = tb.identify(tree, recording, method)  # type: ignore[arg-type]
    k = 3
    known = Settings(known={plain.names[k]: float(plain.values[k])})
    found = tb.identify(tree, recording, method, settings=known)  # type: ignore[arg-type]
    assert np.abs((found.values - plain.values) / plain.sigma).max() < 0.01
    assert found.sigma[k] == 0
    assert found.noise is not None
    assert plain.noise is not None
    column = plain.covariance[:, k]
    wanted = plain.covariance - np.outer(column, column) / plain.covariance[k, k]
    ratio = (found.noise.factor / plain.noise.factor) ** 2
    others = [j for j in range(len(column)) if j != k]
    spread = np.sqrt(np.diagonal(wanted)[others] * ratio)
    told = np.isfinite(found.sigma[others])  # of the plate's zero nothing is said
    np.testing.assert_allclose(found.sigma[others][told], spread[told], rtol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["puma", "gantry"])
def test_doubt_about_a_fact_comes_back_into_sigma(name: str) -> None:
    """As far as the estimate moves with the fact: seen by moving it."""
    tree = robot(name)
    recording = measured(tree)
    mass = float(tb.identify(tree, recording).values[-1]) + 1.0
    exact, moved, doubted = (
        tb.identify(tree, recording, settings=Settings(known={"mass": given}))
        for given in (mass, mass + 1e-3, (mass, 0.05))
    )
    slope = (moved.values - exact.values) / 1e-3
    wanted = exact.covariance + 0.05**2 * np.outer(slope, slope)
    np.testing.assert_allclose(doubted.values, exact.values)
    spread = np.sqrt(np.diagonal(wanted))
    np.testing.assert_allclose(np.sqrt(np.diagonal(doubted.covariance)), spread, rtol=0.02)


def test_words() -> None:
    words = ["mass=20", "gain/Fz=1.01+-2e-3", "K*1zz=1e-3"]
    wanted = {"mass": (20.0, 0.0), "gain/Fz": (1.01, 2e-3), "K*1zz": (1e-3, 0.0)}
    assert parse_known(words) == wanted


@pytest.mark.parametrize("word", ["mass", "mass=", "=20", "mass=heavy", "mass=20+-much"])
def test_words_that_say_nothing_are_refused(word: str) -> None:
    with pytest.raises(SettingsError, match="write it as mass=20"):
        parse_known([word])


@pytest.mark.parametrize(
    ("given", "error"),
    [
        ({"weight": 20.0}, UnknownName),
        ({"mass": 20.0, "mbar1": 20.0}, SettingsError),
    ],
)
def test_facts_about_nothing_are_refused(given: dict[str, float], error: type) -> None:
    tree = robot("puma")
    with pytest.raises(error):
        tb.identify(tree, measured(tree), settings=Settings(known=given))


@pytest.mark.parametrize(
    "given", [3, {"mass": "20"}, {"mass": (1.0, -1.0)}, {"mass": (1.0, 2.0, 3.0)}, {"mass": ()}]
)
def test_what_is_no_fact_is_refused(given: object) -> None:
    with pytest.raises(TestbedError, match="known"):
        Settings(known=given)  # type: ignore[arg-type]


def test_torques_do_not_tell_the_mass_and_are_not_asked() -> None:
    tree = robot("puma")
    recording = measured(tree)
    plain = tb.identify(tree, recording, "internal")
    known = tb.identify(tree, recording, "internal", settings=Settings(known={"mass": 3.0}))
    np.testing.assert_array_equal(plain.values, known.values)
