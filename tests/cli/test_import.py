"""testbed import, from a person's words to a recording; identify looks at what was imported."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.cli.reading import opened
from tests.helpers.command import command_line
from tests.helpers.foreign_files import csv, some_log
from tests.helpers.paths import ROOT

TX40 = ROOT / "examples/tx40"
MODEL = ("--model", str(TX40 / "tx40.urdf"))


def altered(folder: Path, old: str, new: str) -> Path:
    """The TX40's mapping with a mistake."""
    text = (TX40 / "tx40.toml").read_text()
    assert old in text
    for name in ("pos_read_data.csv.gz", "curr_data.csv.gz"):
        text = text.replace(f'"{name}"', json.dumps(str(TX40 / name)))
    (folder / "map.toml").write_text(text.replace(old, new))
    return folder / "map.toml"


@pytest.mark.slow
def test_the_real_tx40_is_imported_and_identified(tmp_path: Path) -> None:
    mapping = str(TX40 / "tx40.toml")
    done = command_line("import", mapping, "--out", "tx40.parquet", *MODEL, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "4467 samples at 500 Hz" in done.stdout
    assert "source 'encoders': 45000 samples at 5000 Hz, jitter 0.00%, no gaps" in done.stdout
    assert "clock: the torque is 0.173 +- 0.812 ms late" in done.stdout
    terms = 'identification.terms=["coulomb","viscous","offset"]'
    words = ("identify", "tx40.parquet", *MODEL, "--set", terms, "--json")
    said = command_line(*words, cwd=tmp_path)
    assert said.returncode == 0, said.stderr
    left = np.array(json.loads(said.stdout)["internal"]["residual"])
    assert np.sqrt(np.mean(left[:4] ** 2)) < 0.75


@pytest.mark.slow
def test_the_tutorial_shows_what_is_printed(tmp_path: Path) -> None:
    """docs/real-recordings.md: the import of the real recording, and its refusal without zeros."""
    text = (ROOT / "docs/real-recordings.md").read_text()
    command, wanted = re.findall(r"```console\n\$ testbed (.*)\n(.*?)```", text, re.DOTALL)[0]
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    done = command_line(*command.split(), cwd=tmp_path)
    assert done.stdout == wanted
    (refusal,) = re.findall(r"```\n(testbed: the recording.*?)```", text, re.DOTALL)
    mapping = str(altered(tmp_path, "[0, -1.5707963267948966", "[0, 0"))
    refused = command_line("import", mapping, "--out", "x.parquet", *MODEL, cwd=tmp_path)
    assert refused.stderr.split() == refusal.split()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("old", "new", "cure"),
    [
        ('unit = "N m"\nside = "motor"', 'unit = "N m"\nside = "joint"', 'side = "motor"'),
        ("[0, -1.5707963267948966", "[0, 0", "offset = [0, -1.5708, 1.5708"),
    ],
)
def test_a_mistake_in_a_real_mapping_is_refused_with_its_cure(
    old: str, new: str, cure: str, tmp_path: Path
) -> None:
    mapping = str(altered(tmp_path, old, new))
    done = command_line("import", mapping, "--out", "tx40.parquet", *MODEL, cwd=tmp_path)
    assert done.returncode == 2
    assert cure in done.stderr
    assert not (tmp_path / "tx40.parquet").exists()


@pytest.mark.slow
def test_what_is_imported_unchecked_is_refused_by_identify(tmp_path: Path) -> None:
    mapping = str(altered(tmp_path, "[torque]", "[torque]\nsign = [1, -1, 1, 1, 1, 1]"))
    done = command_line("import", mapping, "--out", "x.parquet", *MODEL, cwd=tmp_path)
    assert done.returncode == 2
    assert "[torque] sign = [1, 1, 1, 1, 1, 1]" in done.stderr
    words = ("import", mapping, "--out", "x.parquet", *MODEL, "--unchecked")
    assert command_line(*words, cwd=tmp_path).returncode == 0
    refused = command_line("identify", "x.parquet", *MODEL, cwd=tmp_path)
    assert refused.returncode == 2
    assert "[torque] sign = [1, 1, 1, 1, 1, 1]" in refused.stderr


def test_a_guess_is_written_once(tmp_path: Path) -> None:
    csv(tmp_path, some_log())
    done = command_line("import", "--guess", "log.csv", cwd=tmp_path)
    assert done.returncode == 0
    assert "[sources.log]" in done.stdout
    words = ("import", "--guess", "log.csv", "--out", "map.toml")
    assert command_line(*words, cwd=tmp_path).returncode == 0
    assert (tmp_path / "map.toml").read_text() == done.stdout
    again = command_line(*words, cwd=tmp_path)
    assert again.returncode == 2
    assert "map.toml is there" in again.stderr


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("map.toml",), "--out recording.parquet"),
        (("map.toml", "--out", "x.parquet", "--align"), "--align needs --model"),
        (("none.toml", "--out", "x.parquet"), "there is no mapping file 'none.toml'"),
    ],
)
def test_what_is_missing_is_said(words: tuple[str, ...], said: str, tmp_path: Path) -> None:
    (tmp_path / "map.toml").write_text(csv(tmp_path, some_log()))
    done = command_line("import", *words, cwd=tmp_path)
    assert done.returncode == 2
    assert said in done.stderr
    assert not (tmp_path / "x.parquet").exists()


def test_json_for_programs(tmp_path: Path) -> None:
    (tmp_path / "map.toml").write_text(csv(tmp_path, some_log()))
    done = command_line("import", "map.toml", "--out", "x.parquet", "--json", cwd=tmp_path)
    assert json.loads(done.stdout)["import"]["samples"] == 60
    assert tb.Recording.load(tmp_path / "x.parquet").samples == 60


def test_commands_take_a_mapping_for_its_recording(tmp_path: Path) -> None:
    (tmp_path / "map.toml").write_text(csv(tmp_path, some_log()))
    source = opened(tmp_path / "map.toml")
    whole = tb.Recording.from_mapping(tmp_path / "map.toml")
    assert source.names == whole.names
    assert source.samples == whole.samples
    part = source.part(10, 20)
    np.testing.assert_array_equal(part.measured("wrench"), whole.part(10, 20).measured("wrench"))
