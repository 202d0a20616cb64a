"""What came with testbed is found by name; nothing else is."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from testbed.installation import DISTRIBUTION, own_or_shipped, shipped, version
from tests.helpers.command import command_line
from tests.helpers.paths import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def test_every_experiment_and_model_is_found_by_a_short_name() -> None:
    for file in (ROOT / "experiments").rglob("*.toml"):
        name = file.relative_to(ROOT / "experiments").with_suffix("")
        assert shipped(str(name)) == shipped(f"experiments/{name}.toml") == file
    for file in (ROOT / "models").iterdir():
        assert shipped(file.name) == shipped(f"models/{file.name}") == file


def test_an_installed_package_holds_all_that_shipped_files_refer_to() -> None:
    included = PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]
    assert all(place == f"testbed/shipped/{source}" for source, place in included.items())
    held = [ROOT / source for source in included]
    for file in (ROOT / "experiments").rglob("*.toml"):
        for word in file.read_text().replace('"', " ").replace("=", " ").split():
            if word.startswith("../") and file.parent.name == "experiments":
                target = (file.parent / word).resolve()
                assert target.exists(), (file, word)
                assert any(target.is_relative_to(place) for place in held), (file, word)


@pytest.mark.parametrize("name", ["../pyproject.toml", "/etc/passwd", "nothing", "", "models"])
def test_nothing_else_is_found(name: str) -> None:
    with pytest.raises(FileNotFoundError, match="comes with no file"):
        shipped(name)
    assert own_or_shipped(name) == Path(name)


def test_an_own_file_comes_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert own_or_shipped("table6") == ROOT / "experiments" / "table6.toml"
    Path("table6").touch()
    assert own_or_shipped("table6") == Path("table6")


@pytest.mark.slow
def test_commands_take_the_names(tmp_path: Path) -> None:
    done = command_line("minimal", "puma562.xml", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    words = ("--set", "motion.duration=2", "--set", "simulation.step=1e-3", "--out", "r.parquet")
    done = command_line("simulate", "noise_free", *words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert [each.name for each in tmp_path.iterdir()] == ["r.parquet"]


def test_the_version_is_the_projects() -> None:
    assert PROJECT["project"]["name"] == DISTRIBUTION
    assert version() == PROJECT["project"]["version"]
    assert f"\nversion: {version()}\n" in (ROOT / "CITATION.cff").read_text()
