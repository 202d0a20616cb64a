"""Long recordings, several as one: the same to the bit however samples come, in little memory."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import testbed as tb
from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic
from testbed.core.base.errors import RecordingError, SettingsError
from testbed.core.estimation.problem import selected_samples
from testbed.core.estimation.regression.windows import make_plan
from testbed.core.kernel import numba_engine
from testbed.core.kernel.layout import make_layout
from testbed.core.parameters.rules import SIGNALS, Signal
from testbed.core.recordings.metadata import Metadata
from testbed.core.recordings.source import SourceRange
from tests.helpers.ideal import EXACT, ideal, plus, true_values
from tests.helpers.measured import measured
from tests.helpers.parts import write_parts
from tests.helpers.paths import ROOT
from tests.helpers.refusals import refuses
from tests.helpers.robots import random_robot
from tests.helpers.runs import noisy, robot

FILTERED = tb.Settings(position_cutoff=20.0, cutoff=5.0)
WAIT = 60.0  # seconds after which a thread that should have company has none


def pieces(recording: tb.Recording, size: int) -> Iterator[tb.Recording]:
    ends = range(0, recording.samples, size)
    return (recording.part(k, min(k + size, recording.samples)) for k in ends)


def encoders(recording: tb.Recording) -> tb.Recording:
    return replace(recording, velocity=None, acceleration=None).blind()


def same(a: tb.Estimate, b: tb.Estimate) -> None:
    for name in ("values", "covariance", "residual"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    assert a.diagnostics == b.diagnostics


def by_columns(values: Array) -> Array:
    """A copy that cannot be written and keeps each column together."""
    found = np.asfortranarray(values)
    found.flags.writeable = False
    return found


@pytest.fixture(scope="module")
def tree() -> tb.Tree:
    found = random_robot(np.random.default_rng(4), 3).tree()
    return replace(found, joints=tuple(replace(j, coulomb=2.0, viscous=1.0) for j in found.joints))


@pytest.fixture(scope="module")
def recording(tree: tb.Tree) -> tb.Recording:
    return ideal(tree, duration=400.0, rate=200.0, seed=3)


@pytest.fixture
def compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    """The compiled kernel for every job."""
    monkeypatch.setattr("testbed.core.estimation.regression.passes.MIN_COMPILED_SECONDS", 0.0)


@pytest.mark.slow
@pytest.mark.usefixtures("compiled")
@pytest.mark.parametrize("method", SIGNALS)
def test_threads_files_maps_and_streams_give_the_same_bits(
    method: Signal, tree: tb.Tree, recording: tb.Recording, tmp_path: Path
) -> None:
    """Files with odd row groups, parts of odd sizes, columns in another order or apart."""
    for treated, given_now in ((EXACT, recording), (FILTERED, encoders(recording))):
        wanted = tb.identify(tree, given_now, method, settings=treated, threads=1)
        path = tmp_path / f"{treated.cutoff}.parquet"
        write_parts(pieces(given_now, 777), path)
        np.save(tmp_path / "position.npy", given_now.position)
        on_disk = np.load(tmp_path / "position.npy", mmap_mode="r")
        backwards: dict[str, Any] = {
            name: given_now.measured(name)[:, ::-1]
            for name in ("position", "velocity", "acceleration", "torque")
            if name in given_now.signals
        }
        apart: dict[str, Any] = {
            name: by_columns(given_now.measured(name)) for name in ("position", "torque", "wrench")
        }
        for source in (
            given_now,
            path,
            pieces(given_now, 1234),
            replace(given_now, position=on_disk),
            replace(given_now, names=tree.names[::-1], **backwards),
            replace(given_now, **apart),
        ):
            same(tb.identify(tree, source, method, settings=treated, threads=3), wanted)


@pytest.mark.usefixtures("compiled")
def test_as_many_threads_work_as_asked_and_no_more_is_read_than_they_need(
    tree: tb.Tree, recording: tb.Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first windows wait for each other; what waits for an answer is at most two more."""
    together, asked, answered = threading.Barrier(2), list[int](), list[int]()
    waiting, seen, real = set[int](), set[int](), tb.Recording.part

    def part(self: tb.Recording, begin: int, end: int) -> tb.Recording:
        asked.append(begin)
        waiting.add(len(asked) - len(answered))
        return real(self, begin, end)

    def answer(engine: Callable[..., Any], *arguments: Any) -> Any:
        seen.add(threading.get_ident())
        answered.append(1)
        if len(answered) <= 2:
            together.wait(WAIT)
        return engine(*arguments)

    long = ideal(tree, duration=1000.0, rate=200.0, seed=3)
    monkeypatch.setattr(tb.Recording, "part", part)
    for name in ("row_products", "rows"):
        monkeypatch.setattr(numba_engine, name, partial(answer, getattr(numba_engine, name)))
    steps: list[tuple[int, int]] = []
    tb.identify(tree, long, settings=EXACT, threads=2, progress=lambda *done: steps.append(done))
    assert len(asked) > 8
    assert max(waiting) <= 4
    assert steps == sorted(steps)
    assert {total for _, total in steps} == {3 * long.samples} == {steps[-1][0]}
    seen.clear()
    tb.identify(tree, recording, settings=EXACT, threads=1)
    assert seen == {threading.get_ident()}


def test_what_is_no_number_gaps_in_time_and_nothing_are_named(
    tree: tb.Tree, recording: tb.Recording, tmp_path: Path
) -> None:
    """In a file or in memory; in the midst of a window and between two."""
    path = tmp_path / "recording.parquet"
    for channel in ("position", "wrench"):
        values = np.array(getattr(recording, channel))
        values[60_123, 1] = np.nan
        bad: tb.Recording = replace(recording.blind(), **{channel: values})  # type: ignore[arg-type]
        write_parts([bad], path)
        for source in (bad, path):
            with refuses(RecordingError, channel, "60123", "300.615"):
                tb.identify(tree, source, threads=2)
    plan = make_plan(
        recording, make_layout(tree, tb.minimal_set(tree, "wrench")), np.zeros(6), EXACT
    )
    border = [window.first for window in plan.windows()][1]
    for sample in (70_000, border - 1, border):
        time = np.array(recording.time)
        time[sample + 1 :] += 0.5
        with refuses(RecordingError, "0.505 s", str(sample)):
            tb.identify(tree, replace(recording, time=time), settings=EXACT)
    write_parts([recording.part(0, 0)], path)
    for nothing in (path, [recording.part(0, 0)]):
        with refuses(RecordingError, "0 samples"):
            tb.identify(tree, nothing)


@pytest.mark.slow
def test_short_jobs_do_not_wait_for_the_compiler_and_long_ones_use_it() -> None:
    """Five seconds of three joints at 1 kHz are short; ten times more are not."""
    code = (
        "import sys, testbed as tb\n"
        "from tests.helpers.ideal import ideal\n"
        f"tree = tb.load_tree(r'{ROOT / 'models/puma562.urdf'}')\n"
        "for seconds, compiled in ((5.0, False), (50.0, True)):\n"
        "    tb.identify(tree, ideal(tree, seconds, 1000.0), 'wrench')\n"
        "    assert ('numba' in sys.modules) == compiled\n"
    )
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)


def test_what_does_not_count_changes_nothing(tmp_path: Path) -> None:
    """A span in the settings, in the recording, or a recording that is that span: the same bits."""
    tree = robot("gantry")
    whole = noisy(ideal(tree, duration=8.0))
    span, inner = [1.5, 6.5], slice(round(1.5 * whole.rate), round(6.5 * whole.rate))
    wanted = tb.identify(tree, whole.part(inner.start, inner.stop))
    wild = np.full((whole.samples, 6), 100.0)
    wild[inner] = 0.0
    upset = plus(whole, wrench=wild)
    said = replace(upset, metadata=replace(upset.metadata, counted=(1.5, 6.5)))
    said.save(tmp_path / "said.parquet")
    same(tb.identify(tree, upset, settings=tb.Settings(span=span)), wanted)
    for source in (said, tmp_path / "said.parquet"):
        same(tb.identify(tree, source), wanted)
    both = selected_samples(said, tb.Settings(span=[1.0, 5.0]))  # settings go before
    assert (both.samples, both.part(0, 1).time[0]) == (round(4 * said.rate), pytest.approx(1.0))
    with refuses(RecordingError, "50", "60", "span"):
        selected_samples(whole, tb.Settings(span=[50.0, 60.0]))
    with refuses(ValueError, "counted"):
        Metadata.parse({"counted": ["a", 2]})


def runs_of(tree: tb.Tree, *seeds: int, duration: float = 12.0) -> list[tb.Recording]:
    return [measured(tree, seed, duration=duration) for seed in seeds]


@pytest.mark.slow
@pytest.mark.parametrize("method", SIGNALS)
def test_what_recordings_say_together_is_the_sum_of_what_each_says(method: Signal) -> None:
    """No row reaches across a gap: in any order, tared each in its way; sigma is honest."""
    tree, more = robot("gantry"), np.array([1.0, 2.0, 30.0, 0.1, 0.2, 0.3])
    parts = runs_of(tree, 1, 2, 3)
    parts[1] = replace(plus(parts[1], wrench=more), tare=tb.pedestal_wrench(tree) + more)
    each = [tb.identify(tree, part, method) for part in parts]
    for order in (1, -1):
        whole = tb.identify(tree, tb.Joined(parts[::order]), method)
        for what in ("used", "normal", "right", "squares"):
            total = sum(getattr(one.normal_equations, what) for one in each)
            mine = getattr(whole.normal_equations, what)
            np.testing.assert_allclose(mine, total, rtol=1e-9, atol=1e-9)
    assert np.median(whole.sigma / each[0].sigma) < 0.75
    z = (whole.values - true_values(tree, method)) / whole.sigma
    assert np.sqrt(np.mean(z**2)) < 1.6


def test_a_stretch_of_joined_recordings_has_their_gaps(puma: tb.Tree) -> None:
    words = ("a gap", "both"), ("both", "late")
    tables = [[Diagnostic("note", text).as_dict() for text in each] for each in words]
    parts = zip(runs_of(puma, 1, 2, duration=2.0), tables, strict=True)
    both = tb.Joined(
        [replace(part, metadata=Metadata.parse({"diagnostics": table})) for part, table in parts]
    )
    assert [each.text for each in both.metadata.diagnostics] == ["a gap", "both", "late"]
    (_, end), (begin, last) = both.segments
    assert SourceRange(both, 100, last - 50).segments == ((0, end - 100), (begin - 100, last - 150))
    assert SourceRange(both, end, last).segments == ((begin - end, last - end),)
    with pytest.raises(ValueError, match=str(end - 1)):
        both.part(end - 1, begin + 1)


def test_recordings_that_do_not_belong_together_are_refused(puma: tb.Tree) -> None:
    one = measured(puma, 1, duration=3.0)
    for other, culprit in (
        (measured(robot("ur5"), 1, duration=3.0), "robot"),
        (measured(puma, 1, duration=3.0, rate=100.0), "rate"),
        (replace(one, metadata=Metadata(gravity=(0.0, 0.0, -1.6))), "gravity"),
        (replace(one, tare=None), "pedestal"),
    ):
        with refuses(RecordingError, culprit):
            tb.Joined([one, other])
    with refuses(RecordingError, "recording 2", "0.2 s"):
        tb.identify(puma, tb.Joined([one, measured(puma, 2, duration=0.2)]))
    with refuses(SettingsError, "span"):
        tb.identify(puma, tb.Joined([one, one]), settings=tb.Settings(span=(0.0, 1.0)))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["puma", "gantry"])
def test_a_plate_whose_zero_nobody_knows_tells_the_tared_set(name: str) -> None:
    """Beside a drift, too."""
    tree = robot(name)
    plain = measured(tree, 3, duration=30.0)
    tared = tb.minimal_set(tree, "wrench", tared=True)
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
