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
PLACES = ("XDG_CACHE_HOME", "LOCALAPPDATA", "HOME")


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A place for caches of its own."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "elsewhere"))
    return tmp_path / "cache"


def test_the_cache_is_where_the_system_keeps_caches(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the first of the variables that is set; at home in .cache."""
    for name in PLACES:
        monkeypatch.setenv(name, str(home / name))
    for name in PLACES:
        folder = cache_folder()
        base = home / name / ".cache" if name == "HOME" else home / name
        assert folder.parent == base / "testbed"
        assert folder.name.startswith("kernel-")
        assert stat.S_IMODE(folder.stat().st_mode) & 0o077 == 0
        assert cache_folder() == folder
        monkeypatch.delenv(name)


def test_code_of_other_sources_or_another_numba_is_not_run(
    home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compiler, "__file__", str(tmp_path / "compiler.py"))
    (tmp_path / "screws.py").write_text("one")
    one = cache_folder()
    (tmp_path / "screws.py").write_text("two")
    two = cache_folder()
    (tmp_path / "screws.py").write_text("one")
    assert one == cache_folder() != two
    monkeypatch.setattr("numba.__version__", "0.0.1")
    assert cache_folder() not in (one, two)


@pytest.mark.parametrize("level", ["testbed", "kernel"])
@pytest.mark.parametrize("mode", [0o720, 0o702])
def test_a_folder_that_others_may_write_to_is_not_used(home: Path, mode: int, level: str) -> None:
    own = cache_folder()
    open_to_others = own.parent if level == "testbed" else own
    open_to_others.chmod(mode)
    found = cache_folder()
    assert found.parent.name == "elsewhere"
    assert stat.S_IMODE(found.stat().st_mode) == 0o700
    open_to_others.chmod(0o755)
    assert cache_folder() == own


def test_a_folder_of_somebody_else_is_not_used(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own, nobody = cache_folder(), os.getuid() + 1
    monkeypatch.setattr("os.getuid", lambda: nobody)
    assert cache_folder() != own


def test_where_no_folder_can_be_made_it_is_a_passing_one(home: Path) -> None:
    home.write_text("a file stands in the way")
    assert cache_folder().parent.name == "elsewhere"


@pytest.mark.slow
def test_processes_keep_code_in_safe_or_named_places_only(tmp_path: Path) -> None:
    """A folder that is made for lack of a safe one goes with the process."""

    def place(**own: str) -> Path:
        code = "from testbed.kernel.compiler import settings; print(settings.CACHE_DIR)"
        given = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"} | own
        given["XDG_CACHE_HOME"] = str(tmp_path / "cache")
        command = [sys.executable, "-c", code]
        done = subprocess.run(command, env=given, capture_output=True, text=True, check=True)
        return Path(done.stdout.strip())

    assert place(NUMBA_CACHE_DIR=str(tmp_path / "named")) == tmp_path / "named"
    assert not (tmp_path / "cache").exists()
    kept = place()
    assert kept.exists()
    assert kept.parent == tmp_path / "cache/testbed"
    kept.parent.chmod(0o777)
    passing = place(TMPDIR=str(tmp_path))
    assert passing.parent == tmp_path
    assert not passing.exists()
