"""What came with testbed is found by name wherever one works; nothing else is."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from testbed.installation import DISTRIBUTION, own_or_shipped, shipped, version
from tests.helpers.paths import ROOT
from tests.helpers.refusals import refuses

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def test_shipped_files_are_found_by_short_names_and_an_own_file_comes_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`testbed run table6` works in any folder; `testbed run ../x` opens no file of the package."""
    for file in (ROOT / "experiments").rglob("*.toml"):
        name = file.relative_to(ROOT / "experiments").with_suffix("")
        assert shipped(str(name)) == shipped(f"experiments/{name}.toml") == file
    for other in ("../pyproject.toml", "/etc/passwd", "nothing", "", "models"):
        with refuses(FileNotFoundError, other):
            shipped(other)
    monkeypatch.chdir(tmp_path)
    assert own_or_shipped("puma562.xml") == ROOT / "models/puma562.xml"
    Path("puma562.xml").touch()
    assert own_or_shipped("puma562.xml") == Path("puma562.xml")


def test_an_installed_package_holds_all_that_its_experiments_refer_to() -> None:
    """Else they fail for everybody but developers."""
    included = PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]
    assert all(place == f"testbed/shipped/{source}" for source, place in included.items())
    for file in (ROOT / "experiments").glob("*.toml"):
        for word in file.read_text().replace('"', " ").replace("=", " ").split():
            if word.startswith("../"):
                target = (file.parent / word).resolve()
                assert target.exists(), (file, word)
                assert any(target.is_relative_to(ROOT / place) for place in included), (file, word)


def test_the_version_is_the_projects() -> None:
    assert (PROJECT["project"]["name"], PROJECT["project"]["version"]) == (DISTRIBUTION, version())
    assert f"\nversion: {version()}\n" in (ROOT / "CITATION.cff").read_text()
