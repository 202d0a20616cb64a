"""Compiled code is kept where nobody else can write: it is run without being looked at."""

from __future__ import annotations

import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from testbed.kernel import compiler
from testbed.kernel.compiler import cache_folder

pytestmark = pytest.mark.skipif(not hasattr(os, "getuid"), reason="folders have no owners here")


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A place for caches of its own."""
    place = tmp_path / "cache"
    monkeypatch.setenv("XDG_CACHE_HOME", str(place))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "elsewhere"))
    (tmp_path / "elsewhere").mkdir()
    return place


def test_the_users_own_folder_is_taken_and_taken_again(home: Path) -> None:
    folder = cache_folder()
    assert folder.parent == home / "testbed"
    assert folder.name.startswith("kernel-")
    assert len(folder.name) == len("kernel-") + 16
    assert stat.S_IMODE(folder.stat().st_mode) & 0o077 == 0
    assert cache_folder() == folder


@pytest.mark.parametrize(
    ("first", "second"), [("XDG_CACHE_HOME", "LOCALAPPDATA"), ("LOCALAPPDATA", "HOME")]
)
def test_systems_name_the_place_each_in_their_way(
    first: str, second: str, home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv(first, str(home / "first"))
    monkeypatch.setenv(second, str(home / "second"))
    assert cache_folder().parent == home / "first" / "testbed"


def test_without_a_name_it_is_the_cache_at_home(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("XDG_CACHE_HOME", "LOCALAPPDATA"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(home))
    assert cache_folder().parent == home / ".cache" / "testbed"


def test_every_version_of_the_sources_has_its_own(
    home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compiler, "__file__", str(tmp_path / "compiler.py"))
    (tmp_path / "screws.py").write_text("one")
    one = cache_folder()
    (tmp_path / "screws.py").write_text("two")
    two = cache_folder()
    (tmp_path / "rows.py").write_text("")
    (tmp_path / "screws.py").write_text("one")
    assert len({one, two, home}) == 3
    assert cache_folder() == one
    monkeypatch.setattr("numba.__version__", "0.0.1")
    assert cache_folder() not in (one, two)


@pytest.mark.parametrize("level", ["testbed", "kernel"])
@pytest.mark.parametrize("mode", [0o770, 0o707, 0o777])
def test_a_folder_that_others_may_write_to_is_not_used(home: Path, mode: int, level: str) -> None:
    own = cache_folder()
    open_to_others = own.parent if level == "testbed" else own
    open_to_others.chmod(mode)
    found = cache_folder()
    assert found != own
    assert found.parent.name == "elsewhere"
    assert found.name.startswith("testbed-kernel-")
    assert stat.S_IMODE(found.stat().st_mode) == 0o700
    open_to_others.chmod(0o755)
    assert cache_folder() == own


def test_a_folder_of_somebody_else_is_not_used(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own = cache_folder()
    nobody = os.getuid() + 1
    monkeypatch.setattr("os.getuid", lambda: nobody)
    assert cache_folder() != own


def test_where_no_folder_can_be_made_it_is_a_passing_one(home: Path) -> None:
    home.write_text("a file stands in the way")
    assert cache_folder().parent.name == "elsewhere"


def in_a_process(home: Path, **environment: str) -> tuple[Path, bool]:
    """Where a process keeps compiled code, and whether that is there once it has ended."""
    code = "from testbed.kernel.compiler import settings; print(settings.CACHE_DIR)"
    given = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"} | environment
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=given | {"XDG_CACHE_HOME": str(home)},
        capture_output=True,
        text=True,
        check=True,
    )
    place = Path(done.stdout.strip())
    return place, place.exists()


@pytest.mark.slow
def test_numba_keeps_its_code_there_and_passing_folders_pass(tmp_path: Path) -> None:
    home = tmp_path / "cache"
    kept, there = in_a_process(home)
    assert there
    assert kept.parent == home / "testbed"
    (home / "testbed").chmod(0o777)
    passing, there = in_a_process(home, TMPDIR=str(tmp_path))
    assert passing.parent == tmp_path
    assert not there


def test_a_place_that_the_person_names_is_left_alone(tmp_path: Path) -> None:
    named, _ = in_a_process(tmp_path / "cache", NUMBA_CACHE_DIR=str(tmp_path / "named"))
    assert named == tmp_path / "named"
    assert not (tmp_path / "cache").exists()
