"""A recording with interruptions: cut there, said, and one estimate of all pieces."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.errors import RecordingError
from testbed.recordings.importing.pieces import pieces
from testbed.recordings.joined import Joined
from tests.helpers.command import command_line
from tests.helpers.measured import measured
from tests.helpers.paths import ROOT
from tests.helpers.runs import robot

MAPPING = """
rate = 200
joints = JOINTS
[sources.robot]
file = "robot.npz"
time = "t"
time_unit = "s"
[sources.plate]
file = "plate.npz"
time = "t"
time_unit = "s"
[position]
source = "robot"
columns = COLUMNS
unit = "rad"
[wrench]
source = "plate"
columns = ["w[0]", "w[1]", "w[2]", "w[3]", "w[4]", "w[5]"]
units = ["N", "N m"]
sense = "on_robot"
"""


def interrupted(folder: Path) -> tuple[tb.Tree, tb.Recording]:
    """Encoders are silent from 8 s to 9.5 s and from 9.7 s to 11 s, the plate from 20 s to 21 s."""
    tree = robot("puma")
    recording = measured(tree, duration=30.0)
    t = recording.time
    robot_kept = ~((t > 8) & (t < 9.5) | (t > 9.7) & (t < 11))
    plate_kept = ~((t > 20) & (t < 21))
    np.savez(folder / "robot.npz", t=t[robot_kept], q=recording.position[robot_kept])
    np.savez(folder / "plate.npz", t=t[plate_kept], w=recording.measured("wrench")[plate_kept])
    columns = [f"q[{k}]" for k in range(tree.n)]
    text = MAPPING.replace("JOINTS", json.dumps(tree.names)).replace("COLUMNS", json.dumps(columns))
    (folder / "map.toml").write_text(text)
    return tree, recording


def test_it_is_cut_where_a_source_was_silent(tmp_path: Path) -> None:
    """Samples stay what they are; what is too short between two gaps is left out, and said."""
    _, recording = interrupted(tmp_path)
    found, lines = pieces(tmp_path / "map.toml")
    assert [len(part.time) for part in found] == [1601, 1801, 1800]
    for part, begin in zip(found, (0, 2200, 4200), strict=True):
        same = slice(begin, begin + len(part.time))
        np.testing.assert_array_equal(part.position, recording.position[same])
        np.testing.assert_array_equal(part.wrench, recording.measured("wrench")[same])
    assert len(lines) == 4
    assert "nothing of source 'robot' for 1.5 s after 8 s: cut there" in lines[0]
    assert "'plate'" in lines[2]
    assert lines[3] == "1 piece shorter than 1 s left out"
    with pytest.raises(RecordingError, match="testbed import"):
        tb.Recording.from_mapping(tmp_path / "map.toml")


def test_a_bridged_gap_is_none(tmp_path: Path) -> None:
    interrupted(tmp_path)
    text = (tmp_path / "map.toml").read_text()
    (tmp_path / "map.toml").write_text(text.replace('"s"\n', '"s"\nmax_gap = 2\n'))
    found, lines = pieces(tmp_path / "map.toml")
    assert len(found) == 1
    assert lines == []


@pytest.mark.slow
def test_the_pieces_make_one_estimate(tmp_path: Path) -> None:
    """By the mapping itself, and by the recordings that `import` writes: the same numbers."""
    tree, recording = interrupted(tmp_path)
    model = str(ROOT / "models/puma562.xml")
    done = command_line("import", "map.toml", "--out", "a.parquet", "--model", model, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    names = [f"a-{k}.parquet" for k in (1, 2, 3)]
    assert "cut there" in done.stdout
    assert "a-1.parquet, a-2.parquet, a-3.parquet; identify takes them together" in done.stdout
    assert sorted(path.name for path in tmp_path.glob("*.parquet")) == names
    whole = ("--model", model, "--json", "--method", "external")
    first = command_line("identify", *names, *whole, cwd=tmp_path)
    second = command_line("identify", "map.toml", *whole, cwd=tmp_path)
    assert second.returncode == 0, second.stderr
    values = [json.loads(done.stdout)["external"]["values"] for done in (first, second)]
    assert values[0] == values[1]
    estimate = tb.identify(tree, Joined(pieces(tmp_path / "map.toml")[0]))
    np.testing.assert_array_equal(estimate.values, values[0])
    z = (estimate.values - estimate.minimal.values(tb.barycentric(tree))) / estimate.sigma
    assert np.abs(z).max() < 4
    assert recording.tare is not None
