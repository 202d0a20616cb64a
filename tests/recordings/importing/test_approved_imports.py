"""What every foreign format becomes: its guessed mapping, its recording, what is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

import numpy as np
import pytest

import testbed as tb
from tests.helpers.approved import hold
from tests.helpers.command import command_line
from tests.helpers.foreign_files import FORMATS, some_log


@pytest.fixture(autouse=True)
def width(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lines are broken alike wherever it runs."""
    monkeypatch.setenv("COLUMNS", "100")


@pytest.mark.parametrize("name", FORMATS)
def test_a_guess_is_as_approved(name: str, tmp_path: Path) -> None:
    FORMATS[name](tmp_path, some_log())
    file = min(path.name for path in tmp_path.iterdir())
    done = command_line("import", file, "--guess", "--out", "map.toml", cwd=tmp_path)
    text = f"{done.stdout}{done.stderr}{done.returncode}\n"
    if (tmp_path / "map.toml").exists():
        text += (tmp_path / "map.toml").read_text()
    hold(f"guess_{name}.txt", text.replace(str(tmp_path), ""))


ANGLES = 'unit = "rad"\n'
TORQUES = 'unit = "N m"\n'
SOURCE = 'time_unit = "s"'
SENSE = 'sense = "on_robot"\n'
RATE = "rate = 100\n"
MAPPINGS: dict[str, tuple[tuple[str, str], ...]] = {
    "plain": (),
    "degrees": ((ANGLES, 'unit = "deg"\nsign = [1, -1]\noffset = [0.1, 0.2]\n'),),
    "mixed": ((ANGLES, 'unit = ["deg", "turn"]\nmatrix = [[1, 0], [0.5, 1]]\n'),),
    "late": ((TORQUES, 'unit = "A"\ngain = [2, 3]\ndelay = 0.02\n'),),
    "motors": (
        (ANGLES, 'unit = "rad"\nside = "motor"\n'),
        (TORQUES, 'unit = "N mm"\nside = "motor"\n'),
        ("[position]", "[gear]\nmatrix = [[50, 10], [0, -40]]\n[position]"),
    ),
    "geared": (
        (ANGLES, 'unit = "rad"\nside = "motor"\n'),
        (TORQUES, 'unit = "N m"\nside = "joint"\n'),
        ("[position]", "[gear]\nratio = [50, -40]\n[position]"),
    ),
    "pounds": (('["N", "N m"]', '["lbf", "lbf in"]'), (SENSE, 'sense = "on_plate"\n')),
    "placed": (
        (SENSE, SENSE + "place = { xyz = [0.1, 0.2, -0.3], rpy = [0.1, -0.2, 1.5] }\n"),
        (RATE, "rate = 100\ngravity = [0, 0, -9.8]\n"),
    ),
    "tared": ((SENSE, SENSE + "tare = [1, 2, 3, 4, 5, 6]\ndelay = -0.01\n"),),
    "slow": ((RATE, "rate = 50\n"),),
    "fast": ((RATE, "rate = 250\n"),),
    "cut": ((RATE, "rate = 100\nstart = 0.2\nstop = 0.9\n"),),
    "clock": ((SOURCE, SOURCE + "\nsteady = true\nskew = 1e-3\noffset = 0.5\nmax_gap = 0.05"),),
    "milliseconds": ((SOURCE, 'time_unit = "ms"'),),
    "no clock": (('time = "t"\n' + SOURCE, "rate = 200"),),
    "held": ((SOURCE, SOURCE + "\ndrop_held = true"),),
}
"""By name: what of the mapping is replaced, and by what."""


@pytest.mark.parametrize("name", MAPPINGS)
def test_a_mapping_does_what_was_approved(name: str, tmp_path: Path) -> None:
    text = FORMATS["csv"](tmp_path, some_log(120))
    for old, new in MAPPINGS[name]:
        assert text.count(old) == 1
        text = text.replace(old, new)
    (tmp_path / "map.toml").write_text(text)
    done = command_line("import", "map.toml", "--out", "made.parquet", cwd=tmp_path)
    lines = [f"{done.stdout}{done.stderr}{done.returncode}".replace(str(tmp_path), "")]
    if done.returncode == 0:
        found = tb.Recording.load(tmp_path / "made.parquet")
        lines.append(f"{found.samples} at {found.rate:g} Hz from {found.time[0]:g} s")
        lines.append(f"gravity {found.facts.get('gravity')}, tare {found.tare}")
        for signal in ("position", "torque", "wrench"):
            for channel in found.measured(signal).T:
                first = " ".join(f"{x:.5g}" for x in channel[:4])
                size = np.sqrt(np.mean(channel**2))
                lines.append(f"{signal} {first} to {channel[-1]:.5g}, size {size:.5g}")
    hold(f"mapping_{name.replace(' ', '_')}.txt", "\n".join(lines) + "\n")


ROWS = 60


Rows: TypeAlias = list[list[str]]


def written(rows: Rows, first: int, last: int, column: int, word: str) -> None:
    """A word in some cells."""
    for row in rows[first:last]:
        row[column] = word


def stuck(rows: Rows) -> None:
    """Half a second in which nothing changes."""
    for row in rows[10:40]:
        row[1:] = rows[9][1:]


def trembling(rows: Rows) -> None:
    """Stamps that jitter."""
    for k, row in enumerate(rows[1:]):
        row[0] = f"{k / 100 + 2e-3 * np.sin(7.0 * k):.8g}"


MISTAKES: dict[str, Callable[[Rows], object]] = {
    "a gap": lambda rows: rows.__delitem__(slice(20, 40)),
    "a hole": lambda rows: written(rows, 20, 23, 1, "nan"),
    "a long hole": lambda rows: written(rows, 20, 45, 6, ""),
    "a word": lambda rows: written(rows, 9, 10, 3, "on"),
    "back": lambda rows: written(rows, 30, 31, 0, "0.19"),
    "twice": lambda rows: rows.insert(30, rows[30]),
    "still": stuck,
    "jitter": trembling,
    "short": lambda rows: rows.__delitem__(slice(4, None)),
    "ragged": lambda rows: rows[30].append("7"),
}


def spoilt(name: str) -> str:
    """A logger's table with one mistake."""
    log = some_log(ROWS)
    rows = [["t", "q1", "q2", "t1", "t2", *"abcdef"]]
    table = np.column_stack([log.t, log.q, log.tau, log.w])
    rows += [[f"{x:.8g}" for x in row] for row in table]
    MISTAKES[name](rows)
    return "\n".join(",".join(row) for row in rows) + "\n"


@pytest.mark.parametrize("name", MISTAKES)
def test_a_spoilt_table_is_treated_as_approved(name: str, tmp_path: Path) -> None:
    (tmp_path / "map.toml").write_text(FORMATS["csv"](tmp_path, some_log(ROWS)))
    (tmp_path / "log.csv").write_text(spoilt(name))
    done = command_line("import", "map.toml", "--out", "made.parquet", cwd=tmp_path)
    guess = command_line("import", "log.csv", "--guess", "--out", "guess.toml", cwd=tmp_path)
    lines = [f"{each.stdout}{each.stderr}{each.returncode}" for each in (done, guess)]
    for made in sorted(tmp_path.glob("made*.parquet")):
        found = tb.Recording.load(made)
        sizes = " ".join(f"{np.sqrt(np.mean(x**2)):.5g}" for x in found.measured("torque").T)
        lines.append(f"{made.name}: {found.samples} at {found.rate:g} Hz, {sizes}")
        lines += found.facts.get("warnings") or []
    text = "\n".join(lines).replace(str(tmp_path), "") + "\n"
    hold(f"spoilt_{name.replace(' ', '_')}.txt", text)
