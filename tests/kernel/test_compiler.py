"""Compiled code is kept where nobody else can write: it is run without being looked at."""

from __future__ import annotations

import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from testbed.core.kernel import compiler
from testbed.core.kernel.compiler import compiled_folder

pytestmark = pytest.mark.skipif(not hasattr(os, "getuid"), reason="folders have no owners here")
PLACES = ("XDG_CACHE_HOME", "LOCALAPPDATA", "HOME")


def test_the_cache_is_where_the_system_keeps_caches_one_for_each_source_and_numba(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the first of the variables that is set; at home in .cache."""
    monkeypatch.setattr(compiler, "__file__", str(tmp_path / "compiler.py"))
    for name in PLACES:
        monkeypatch.setenv(name, str(tmp_path / name))
    for name in PLACES:
        base, found = tmp_path / name / (".cache" if name == "HOME" else ""), []
        for text in ("one", "two", "one"):
            (tmp_path / "screws.py").write_text(text)
            found.append(compiled_folder())
        assert found[0] == found[2] != found[1]
        with monkeypatch.context() as patch:
            patch.setattr("numba.__version__", "0.0.1")
            found.append(compiled_folder())
        assert found[3] not in found[:2]
        assert {each.parent for each in found} == {base / "testbed"}
        assert {stat.S_IMODE(each.stat().st_mode) & 0o077 for each in found} == {0}
        monkeypatch.delenv(name)


def test_a_folder_that_others_may_write_to_or_that_cannot_be_made_is_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nor one of somebody else; a passing one is made in its place."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "elsewhere"))

    def passing() -> None:
        found = compiled_folder()
        assert found.parent == tmp_path / "elsewhere"
        assert stat.S_IMODE(found.stat().st_mode) == 0o700

    own, somebody = compiled_folder(), os.getuid() + 1
    for opened in (own.parent, own):
        for mode in (0o720, 0o702):
            opened.chmod(mode)
            passing()
        opened.chmod(0o755)
        assert compiled_folder() == own
    with monkeypatch.context() as patch:
        patch.setattr("os.getuid", lambda: somebody)
        passing()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    (tmp_path / "file").write_text("stands in the way")
    passing()


@pytest.mark.slow
def test_processes_keep_code_in_safe_or_named_places_only(tmp_path: Path) -> None:
    """A folder that is made for lack of a safe one goes with the process."""
    cache = tmp_path / "cache"

    def place(**own: str) -> Path:
        code = "from testbed.core.kernel.compiler import settings; print(settings.CACHE_DIR)"
        given = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
        given |= own | {"XDG_CACHE_HOME": str(cache)}
        return Path(
            subprocess.check_output([sys.executable, "-c", code], env=given, text=True)[:-1]
        )

    assert place(NUMBA_CACHE_DIR=str(tmp_path / "named")) == tmp_path / "named"
    assert not cache.exists()
    kept = place()
    assert kept.exists()
    kept.parent.chmod(0o777)
    passing = place(TMPDIR=str(tmp_path))
    assert passing.parent == tmp_path
    assert not passing.exists()
