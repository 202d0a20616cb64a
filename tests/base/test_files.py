"""Files and folders appear whole or not at all, whoever writes, fails or is killed."""

from __future__ import annotations

import os
from contextlib import nullcontext, suppress
from multiprocessing import get_context
from pathlib import Path

import pytest

from testbed.files import replacing
from tests.helpers.refusals import refuses


def write(place: Path, kind: str, word: str = "new") -> None:
    """Replace a file, or a folder of two files that agree, by whole content."""
    with replacing(place, folder=kind == "folder") as fresh:
        for path in (fresh / "a", fresh / "b") if kind == "folder" else (fresh,):
            path.parent.mkdir(exist_ok=True)
            path.write_text(f"{word} " * 2000)


def write_often(place: Path, kind: str, name: str) -> None:
    """Again and again."""
    for k in range(100):
        write(place, kind, f"{name}{k}")


def content(place: Path) -> str:
    """The word that a complete file or folder consists of."""
    texts = [path.read_text() for path in (sorted(place.iterdir()) if place.is_dir() else [place])]
    assert [len(text.split()) for text in texts] == [2000] * (1 + place.is_dir())
    (word,) = {word for text in texts for word in text.split()}
    return word


def names(folder: Path) -> list[str]:
    """Of all that is there."""
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["file", "folder"])
def test_a_reader_finds_one_whole_version_at_every_instant(kind: str, tmp_path: Path) -> None:
    """While others write: nobody plots half a recording; a link stays one."""
    place, start = tmp_path / "place", get_context("spawn").Process
    write(tmp_path / "far", kind, "old")
    place.symlink_to("far")
    processes = [start(target=write_often, args=(place, kind, name)) for name in "xyz"]
    for process in processes:
        process.start()
    while any(process.is_alive() for process in processes):
        with suppress(FileNotFoundError) if kind == "folder" else nullcontext():
            place.stat()
    assert {process.exitcode for process in processes} == {0}
    assert content(tmp_path / "far")[1:] == "99"
    assert place.is_symlink()
    assert names(tmp_path) == ["far", "place"]


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_what_fails_leaves_everything_as_it_was(kind: str, tmp_path: Path) -> None:
    """Folders made on the way go, too."""
    write(tmp_path / "place", kind, "old")
    for target in (tmp_path / "place", tmp_path / "new" / "deep" / "place"):
        with (  # noqa: PT012
            pytest.raises(ZeroDivisionError),
            replacing(target, folder=kind == "folder") as fresh,
        ):
            (fresh if kind == "folder" else fresh.parent).mkdir(exist_ok=True)
            (fresh / "a" if kind == "folder" else fresh).write_text("half")
            _ = 1 / 0
    assert content(tmp_path / "place") == "old"
    assert names(tmp_path) == ["place"]


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_a_place_where_nothing_can_stand_is_refused_by_name(kind: str, tmp_path: Path) -> None:
    """A device is not replaced by a file, nor somebody's file by a folder."""
    write(tmp_path / "full", "folder" if kind == "file" else "file", "kept")
    (tmp_path / "text").write_text("a file")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    os.mkfifo(tmp_path / "pipe")
    before = names(tmp_path)
    closed = "/proc/testbed"  # nobody, not even root, may write there
    for name in ("loop", "loop/x", "text/x", "full", "pipe", "/dev/null", closed):
        with refuses(OSError, name.strip("/").partition("/")[0]):
            write(tmp_path / name, kind)
    assert names(tmp_path) == before
    assert content(tmp_path / "full") == "kept"
