"""Several recordings as one estimate; slow ones; plates whose zero nobody knows."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.errors import RecordingError, SettingsError
from testbed.identification.estimate import METHODS, Method
from testbed.recordings.joined import Joined
from testbed.recordings.recording import Recording
from testbed.recordings.source import Stretch, segments_of
from tests.helpers.command import command_line
from tests.helpers.ideal import plus, true_values
from tests.helpers.measured import measured
from tests.helpers.refusals import refuses
from tests.helpers.runs import MODELS, robot


def runs_of(tree: tb.Tree, *seeds: int, duration: float = 12.0) -> list[Recording]:
    return [measured(tree, seed, duration=duration) for seed in seeds]


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_what_recordings_say_together_is_the_sum_of_what_each_says(method: Method) -> None:
    """No row reaches across a gap: in any order; sigma is smaller, and honest."""
    tree = robot("gantry")
    parts = runs_of(tree, 1, 2, 3)
    each = [tb.identify(tree, part, method) for part in parts]
    for order in (1, -1):
        whole = tb.identify(tree, Joined(parts[::order]), method)
        for what in ("used", "normal", "right", "square"):
            total = sum(getattr(one.normal_equations, what) for one in each)
            mine = getattr(whole.normal_equations, what)
            np.testing.assert_allclose(mine, total, rtol=1e-9, atol=1e-9)
    assert np.median(whole.sigma / each[0].sigma) < 0.75
    z = (whole.values - true_values(tree, method)) / whole.sigma
    assert np.sqrt(np.mean(z**2)) < 1.6


@pytest.mark.nightly
@pytest.mark.parametrize("method", METHODS)
def test_sigma_is_honest_across_gaps(method: Method) -> None:
    """With noise that remembers: errors over sigma of thirty pairs have the size of one."""
    tree, z = robot("puma"), []
    for seed in range(100, 160, 2):
        both = Joined([measured(tree, seed + k, duration=12.0, memory=0.9) for k in (0, 1)])
        found = tb.identify(tree, both, method)
        z.append((found.values - true_values(tree, method)) / found.sigma)
    assert 0.8 < np.sqrt(np.mean(np.square(z))) < 1.25


def test_a_stretch_of_joined_recordings_has_their_gaps(puma: tb.Tree) -> None:
    one, two = runs_of(puma, 1, 2, duration=2.0)
    lines = ["a gap", "both"], ["both", "late"]
    both = Joined(
        [replace(part, facts={"warnings": w}) for part, w in zip((one, two), lines, strict=True)]
    )
    assert both.facts["warnings"] == ["a gap", "both", "late"]
    (_, end), (begin, last) = both.segments
    assert segments_of(Stretch(both, 100, last - 50)) == ((0, end - 100), (begin - 100, last - 150))
    assert segments_of(Stretch(both, end, last)) == ((begin - end, last - end),)
    with pytest.raises(ValueError, match=str(end - 1)):
        both.part(end - 1, begin + 1)


def test_recordings_that_do_not_belong_together_are_refused(puma: tb.Tree) -> None:
    one = measured(puma, 1, duration=3.0)
    for other, culprit in (
        (measured(robot("ur5"), 1, duration=3.0), "robot"),
        (measured(puma, 1, duration=3.0, rate=100.0), "rate"),
        (replace(one, facts={"gravity": [0.0, 0.0, -1.6]}), "gravity"),
        (replace(one, tare=None), "pedestal"),
    ):
        with refuses(RecordingError, culprit):
            Joined([one, other])
    with refuses(RecordingError, "recording 2", "0.2 s"):
        tb.identify(puma, Joined([one, measured(puma, 2, duration=0.2)]))
    with refuses(SettingsError, "span"):
        tb.identify(puma, Joined([one, one]), settings=tb.Settings(span=(0.0, 1.0)))


@pytest.mark.slow
def test_one_command_takes_several_recordings_tared_each_in_its_way(tmp_path: Path) -> None:
    tree = robot("puma")
    one, two = runs_of(tree, 1, 2, duration=8.0)
    direct = tb.identify(tree, Joined([one, two]))
    more = np.array([1.0, 2.0, 30.0, 0.1, 0.2, 0.3])
    one.save(tmp_path / "a.parquet")
    replace(plus(two, wrench=more), tare=tb.pedestal_wrench(tree) + more).save(
        tmp_path / "b.parquet"
    )
    words = ("identify", "a.parquet", "b.parquet", "--model", str(MODELS["puma"]), "--json")
    done = command_line(*words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)["external"]
    np.testing.assert_allclose(found["values"], direct.values, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["puma", "gantry"])
def test_a_plate_whose_zero_nobody_knows_tells_the_tared_set(name: str) -> None:
    """Beside a drift, too."""
    tree = robot(name)
    plain = measured(tree, 3, duration=30.0)
    tared = tb.minimal_set(tree, "reaction", tared=True)
    drift = np.array([0.1, -0.2, 0.5, 0, 0, 0])
    for slope, asked in ((0 * drift, ()), (drift, ("slope",))):
        wrench = np.array([5.0, -3.0, 80.0, 2.0, 1.0, -4.0]) + plain.time[:, None] * slope
        settings = tb.Settings(tare="unknown", nuisances=asked)
        found = tb.identify(tree, plus(plain, wrench=wrench), settings=settings)
        assert found.names == tared.names
        z = (found.values - tared.values(tb.barycentric(tree))) / found.sigma
        assert np.sqrt(np.mean(z**2)) < 1.6
        assert np.abs(z).max() < 4.5
        told = {each.name: each for each in found.nuisances}
        for axis, true in zip(("Fx", "Fy", "Fz") if asked else (), slope, strict=False):
            each = told[f"slope/{axis}"]
            assert abs(each.value - true) < 4.5 * each.sigma
