"""From other people's logs to a recording: mappings, guesses, and mistakes that are refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.helpers.command import command_line
from tests.helpers.paths import ROOT

pytestmark = pytest.mark.slow

TX40 = ROOT / "examples/tx40"
MODEL = ("--model", str(TX40 / "tx40.urdf"))
TERMS = 'identification.terms=["coulomb","viscous","offset"]'


def altered(folder: Path, old: str, new: str, name: str = "map.toml") -> None:
    """The TX40's mapping with other words."""
    text = (TX40 / "tx40.toml").read_text()
    assert old in text
    for data in ("pos_read_data.csv.gz", "curr_data.csv.gz"):
        text = text.replace(f'"{data}"', json.dumps(str(TX40 / data)))
    (folder / name).write_text(text.replace(old, new))


def test_a_real_recording_is_imported_identified_and_looked_at(tmp_path: Path) -> None:
    """Two halves of it: one gives the estimate, the other judges it; no truth anywhere."""
    for name, cut in (("first", "stop = 4.6"), ("second", "start = 4.6")):
        altered(tmp_path, "rate = 500\n", f"rate = 500\n{cut}\n", f"{name}.toml")
    done = command_line("import", "first.toml", "--out", "r.parquet", *MODEL, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    said = command_line("identify", "r.parquet", *MODEL, "--set", TERMS, "--json", cwd=tmp_path)
    (tmp_path / "result.json").write_text(said.stdout)
    found = json.loads(said.stdout)
    left = np.array(found["estimates"]["internal"]["residual"])
    assert np.sqrt(np.mean(left[:4] ** 2)) < 0.75  # N m, of literature's fits of these data
    added = found["posterior"]["internal"]
    assert added["used"]
    assert len(added["determined"]) < added["count"]
    judging = ("validate", "second.toml", "result.json", *MODEL, "--json")
    judged = json.loads(command_line(*judging, cwd=tmp_path).stdout)["internal"]["errors"][
        "residual"
    ]
    total = {name: np.linalg.norm(each) for name, each in judged.items()}
    assert total["posterior"] < total["refitted"] < total["file"]
    words = ("report", "first.toml", *MODEL, "--validate", "second.toml", "--out", "page.html")
    more = ("--terms", "auto", "--consistent", "--set", "identification.cutoff=10")
    done = command_line(*words, *more, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    page = json.loads((tmp_path / "page.json").read_text())
    assert "truth" not in page["parameters"][0]["heads"]
    assert len(page["posterior"]) >= 3  # errors by halves and on the other one, and shares
    assert [section["id"] for section in page["figures"]] == ["prediction", "spectra", "bodies"]
    shown = command_line("view", "first.toml", *MODEL, "--save", "r.rrd", cwd=tmp_path)
    assert shown.returncode == 0, shown.stderr


def test_a_mistake_in_a_mapping_is_refused_with_its_cure(tmp_path: Path) -> None:
    """By every command that takes it; imported unchecked, by the next."""
    altered(tmp_path, "[0, -1.5707963267948966", "[0, 0")
    unchecked = ("import", "map.toml", "--out", "x.parquet", "--unchecked")
    for words, code, files in (
        (("import", "map.toml", "--out", "x.parquet"), 2, {"map.toml"}),
        (("report", "map.toml"), 2, {"map.toml"}),
        (unchecked, 0, {"map.toml", "x.parquet"}),
        (("identify", "x.parquet"), 2, {"map.toml", "x.parquet"}),
    ):
        done = command_line(*words, *MODEL, cwd=tmp_path)
        assert done.returncode == code, words
        assert ("offset = [0, -1.5708, 1.57079" in done.stderr) == (code == 2)
        assert {path.name for path in tmp_path.iterdir()} == files
