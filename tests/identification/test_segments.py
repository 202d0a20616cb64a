"""Several recordings of one robot as one estimate; slow ones; plates whose zero nobody knows."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.errors import RecordingError
from testbed.identification.estimate import METHODS, Method
from testbed.recordings.joined import Joined
from testbed.recordings.recording import Recording
from testbed.recordings.source import Stretch, segments_of
from tests.helpers.command import command_line
from tests.helpers.ideal import EXACT, ideal, plus, true_values
from tests.helpers.measured import measured
from tests.helpers.runs import MODELS, robot


def runs_of(tree: tb.Tree, *seeds: int, duration: float = 12.0, memory: float = 0.0) -> Joined:
    return Joined([measured(tree, s, duration=duration, memory=memory) for s in seeds])


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", ["puma", "gantry", "random"])
def test_what_recordings_say_together_is_the_sum_of_what_each_says(
    name: str, method: Method
) -> None:
    tree = robot(name)
    parts = [measured(tree, seed, duration=12.0) for seed in (1, 2, 3)]
    whole = tb.identify(tree, Joined(parts), method).normal_equations
    each = [tb.identify(tree, part, method).normal_equations for part in parts]
    for what in ("used", "normal", "right", "square"):
        total = sum(getattr(one, what) for one in each)
        np.testing.assert_allclose(getattr(whole, what), total, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("method", METHODS)
def test_exact_recordings_give_the_truth(method: Method) -> None:
    for name in ("puma", "ur5", "gantry", "random"):
        tree = robot(name)
        both = Joined([ideal(tree, 3.0, seed=seed) for seed in (1, 2)])
        found = tb.identify(tree, both, method, settings=EXACT)
        truth = true_values(tree, method)
        assert np.abs(found.values - truth).max() < 1e-7 * max(1.0, np.abs(truth).max())


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_sigma_is_honest_across_gaps(method: Method) -> None:
    """With noise that remembers: errors over sigma of twenty pairs have the size of one."""
    tree, z = robot("puma"), []
    for seed in range(20):
        both = runs_of(tree, 2 * seed + 100, 2 * seed + 101, memory=0.9)
        found = tb.identify(tree, both, method)
        z.append((found.values - true_values(tree, method)) / found.sigma)
    size = float(np.sqrt(np.mean(np.square(z))))
    assert 0.8 < size < 1.25, size


@pytest.mark.slow
def test_a_second_recording_makes_sigma_smaller() -> None:
    tree = robot("puma")
    one = tb.identify(tree, measured(tree, 1, duration=12.0))
    both = tb.identify(tree, runs_of(tree, 1, 2))
    assert np.median(both.sigma / one.sigma) < 0.85


@pytest.mark.slow
def test_no_row_reaches_across_a_gap() -> None:
    """Whatever lies between: another order gives other gaps and the same rows."""
    tree = robot("puma")
    parts = [measured(tree, seed, duration=8.0 + seed) for seed in (1, 2)]
    one, other = (tb.identify(tree, Joined(order)) for order in (parts, parts[::-1]))
    np.testing.assert_allclose(
        one.normal_equations.normal, other.normal_equations.normal, rtol=1e-9
    )


def test_a_stretch_of_joined_recordings_has_their_gaps() -> None:
    tree = robot("puma")
    both = runs_of(tree, 1, 2, duration=2.0)
    (_, end), (begin, last) = both.segments
    assert segments_of(Stretch(both, 100, last - 50)) == ((0, end - 100), (begin - 100, last - 150))
    assert segments_of(Stretch(both, end, last)) == ((begin - end, last - end),)
    with pytest.raises(ValueError, match="not of one recording"):
        both.part(end - 1, begin + 1)


@pytest.mark.slow
def test_tares_may_differ() -> None:
    tree = robot("puma")
    one, two = (measured(tree, seed, duration=12.0) for seed in (1, 2))
    more = np.array([1.0, 2.0, 30.0, 0.1, 0.2, 0.3])
    assert two.tare is not None
    moved = replace(plus(two, wrench=more), tare=two.tare + more)
    same, found = (tb.identify(tree, Joined([one, other])) for other in (two, moved))
    np.testing.assert_allclose(found.values, same.values, atol=1e-9)


def test_recordings_that_do_not_belong_together_are_refused() -> None:
    tree = robot("puma")
    one = measured(tree, 1, duration=3.0)
    cases: list[tuple[Recording, str]] = [
        (measured(robot("ur5"), 1, duration=3.0), "another robot"),
        (measured(tree, 1, duration=3.0, rate=100.0), "import them at one rate"),
        (replace(one, facts={"gravity": [0.0, 0.0, -1.6]}), "another gravity"),
        (replace(one, tare=None), "pedestal"),
    ]
    for other, said in cases:
        with pytest.raises(RecordingError, match=said):
            Joined([one, other])
    with pytest.raises(RecordingError, match="recording 2 lasts"):
        tb.identify(tree, Joined([one, measured(tree, 2, duration=0.2)]))


@pytest.mark.slow
def test_one_command_takes_several_recordings(tmp_path: Path) -> None:
    tree = robot("puma")
    for name, seed in (("a", 1), ("b", 2)):
        measured(tree, seed, duration=8.0).save(tmp_path / f"{name}.parquet")
    words = ("identify", "a.parquet", "b.parquet", "--model", str(MODELS["puma"]), "--json")
    done = command_line(*words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)["external"]
    direct = tb.identify(tree, runs_of(tree, 1, 2, duration=8.0))
    np.testing.assert_allclose(found["values"], direct.values, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", ["puma", "ur5", "gantry"])
def test_thirty_samples_a_second_are_enough(name: str, method: Method) -> None:
    """By default: no setting is needed, and sigma is honest."""
    tree = robot(name)
    slow = measured(tree, 4, duration=60.0, rate=30.0)
    found = tb.identify(tree, slow, method)
    z = (found.values - true_values(tree, method)) / found.sigma
    assert np.sqrt(np.mean(z**2)) < 1.6
    fast = tb.identify(tree, measured(tree, 4, duration=60.0, rate=200.0), method)
    assert np.median(found.sigma / fast.sigma) < 8


@pytest.mark.slow
@pytest.mark.parametrize("name", ["puma", "ur5", "gantry", "random"])
def test_a_plate_whose_zero_nobody_knows_tells_the_tared_set(name: str) -> None:
    tree = robot(name)
    offset = np.array([5.0, -3.0, 80.0, 2.0, 1.0, -4.0])
    recording = plus(measured(tree, 3, duration=30.0), wrench=offset)
    found = tb.identify(tree, recording, settings=tb.Settings(tare="unknown"))
    tared = tb.minimal_set(tree, "reaction", tared=True)
    assert found.names == tared.names
    z = (found.values - tared.values(tb.barycentric(tree))) / found.sigma
    assert np.sqrt(np.mean(z**2)) < 1.6
    assert np.abs(z).max() < 4.5


@pytest.mark.slow
def test_a_drift_beside_an_unknown_zero() -> None:
    tree = robot("puma")
    plain = measured(tree, 3, duration=30.0)
    drift = plain.time[:, None] * np.array([0.1, -0.2, 0.5, 0.02, 0.01, -0.03])
    settings = tb.Settings(tare="unknown", nuisances=("slope",))
    found = tb.identify(tree, plus(plain, wrench=drift + 10.0), settings=settings)
    z = (found.values - found.minimal.values(tb.barycentric(tree))) / found.sigma
    assert np.abs(z).max() < 4.5
    slopes = {n.name: n for n in found.nuisances}
    for name, true in zip(("Fx", "Fy", "Fz"), (0.1, -0.2, 0.5), strict=True):
        each = slopes[f"slope/{name}"]
        assert abs(each.value - true) < 4.5 * each.sigma


def test_what_is_said_of_any_recording_is_said_of_all_together_once() -> None:
    tree = robot("puma")
    parts = [
        replace(measured(tree, seed, duration=3.0), facts={"warnings": lines})
        for seed, lines in enumerate((["a gap", "both"], [], ["both", "late"]))
    ]
    assert Joined(parts).facts["warnings"] == ["a gap", "both", "late"]


def test_one_recording_that_is_too_short_has_no_number(puma: tb.Tree) -> None:
    short = ideal(puma).part(0, 30)
    with pytest.raises(RecordingError, match=r"^the recording lasts 0\.\d+ s, too short"):
        tb.identify(puma, short)
