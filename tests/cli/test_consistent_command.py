"""`testbed identify --consistent --write`: as a person uses it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import testbed as tb
from tests.helpers.command import command_line
from tests.helpers.measured import measured
from tests.helpers.paths import ROOT


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("consistent")
    for name in ("puma562.urdf", "puma562.xml"):
        (place / name).write_bytes((ROOT / "models" / name).read_bytes())
    measured(tb.load_tree(place / "puma562.xml"), 1, duration=8.0).save(place / "r.parquet")
    return place


@pytest.mark.slow
@pytest.mark.parametrize("ending", ["urdf", "xml"])
def test_a_file_is_written_with_what_is_printed(folder: Path, ending: str) -> None:
    call = ("identify", "r.parquet", "--model", f"puma562.{ending}", "--write", f"new.{ending}")
    done = command_line(*call, "--json", cwd=folder)
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)["consistent"]
    tree = tb.load_tree(folder / f"new.{ending}")
    for joint, own in zip(tree.joints, tb.standard(tree), strict=True):
        assert own.tolist() == pytest.approx(said["links"][joint.body]["values"], abs=1e-12)
        assert joint.coulomb == said["terms"][f"coulomb/{joint.name}"]["value"]
    text = (folder / f"new.{ending}").read_text()
    assert "r.parquet (sha256" in text
    assert "external and internal" in text


@pytest.mark.slow
def test_the_table_says_what_the_data_told(folder: Path) -> None:
    call = ("identify", "r.parquet", "--model", "puma562.urdf", "--consistent")
    done = command_line(*call, cwd=folder)
    assert done.returncode == 0, done.stderr
    for words in ("told", "Every body can exist", "gave way by", "coulomb/waist"):
        assert words in done.stdout


def test_wishes_without_a_wish_for_bodies_are_said(folder: Path) -> None:
    call = (
        "identify",
        "r.parquet",
        "--model",
        "puma562.urdf",
        "--set",
        "consistent.metric=frobenius",
    )
    done = command_line(*call, cwd=folder)
    assert done.returncode == 2
    assert "say --consistent" in done.stderr


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--set", "consistent.known.mass=-3"], "mass = -3 kg"),
        (["--set", 'consistent.known={mass=3,"mass/link1"=4}'], "mass/link1 make 4 kg"),
        (["--set", 'consistent.known={"mass/lnk1"=4}'], "did you mean 'link1'"),
        (["--set", "consistent.weight=4"], "weight"),
        (["--write", "puma562.urdf"], "--in-place"),
        (["--write", "new.xml"], "ends in .urdf"),
    ],
)
def test_what_cannot_be_is_one_line(folder: Path, words: list[str], said: str) -> None:
    call = ("identify", "r.parquet", "--model", "puma562.urdf", "--consistent", *words)
    done = command_line(*call, cwd=folder)
    assert done.returncode == 2
    assert said in done.stderr
    assert done.stderr.count("\n") == 1
    assert done.stdout == ""
