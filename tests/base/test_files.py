"""Files and folders appear whole or not at all, whoever writes, fails or is killed."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from contextlib import nullcontext, suppress
from multiprocessing import get_context
from pathlib import Path
from types import ModuleType

import pytest

from testbed.core.base import files
from testbed.core.base.files import atomic_output, check_writable, replace_together
from tests.helpers.refusals import refuses


def write(place: Path, kind: str, word: str = "new") -> None:
    """Replace a file, or a folder of two files that agree, by whole content."""
    with atomic_output(place, folder=kind == "folder") as fresh:
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
            atomic_output(target, folder=kind == "folder") as fresh,
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


@pytest.fixture(params=["in one step", "in steps"])
def exchange(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file system that exchanges two paths, and one that cannot."""
    if request.param == "in steps":
        monkeypatch.setattr(files, "_exchange_in_one_step", lambda first, second: errno.EINVAL)


def failing(
    monkeypatch: pytest.MonkeyPatch, module: ModuleType, call: str, number: int,
    error: BaseException,
) -> None:  # fmt: skip
    """Make one call of a module's function, by its number, raise an error."""
    done, real = [0], getattr(module, call)

    def once(*words: object) -> object:
        done[0] += 1
        if done[0] == number:
            raise error
        return real(*words)

    monkeypatch.setattr(module, call, once)


FULL = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.usefixtures("exchange")
@pytest.mark.parametrize("kind", ["file", "folder"])
@pytest.mark.parametrize("error", [FULL, KeyboardInterrupt()])
@pytest.mark.parametrize(("call", "number"), [
    ("rename", 1), ("rename", 2), ("rename", 3), ("replace", 1), ("link", 1), ("fsync", 1),
])  # fmt: skip
def test_a_disk_that_fails_or_ctrl_c_leaves_the_older_one_or_the_new_one(
    kind: str, error: BaseException, call: str, number: int, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """At any step of replacing; nothing else is left, and no message names a temporary file."""
    write(tmp_path / "place", kind, "old")
    failing(monkeypatch, os, call, number, error)
    left, said = "new", "'place'"
    try:
        write(tmp_path / "place", kind)
    except (OSError, KeyboardInterrupt) as raised:
        left, said = "old", str(raised)
    assert content(tmp_path / "place") == left
    assert names(tmp_path) == ["place"]
    assert "place" in said or error is not FULL
    assert ".testbed-" not in said


@pytest.mark.usefixtures("exchange")
@pytest.mark.parametrize("kind", ["file", "folder"])
def test_of_several_that_are_written_together_all_are_replaced_or_none(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One of them is new; the error names the one that could not be put there."""
    old, new, last = (tmp_path / name for name in ("old", "new", "last"))
    for place in (old, last):
        write(place, kind, "before")

    def write_all(*, then: Callable[[], object] = lambda: None) -> None:
        with replace_together():
            for place in (old, new, last):
                write(place, kind, "after")
            assert content(old) == "before"
            then()

    with pytest.raises(ZeroDivisionError):
        write_all(then=lambda: 1 / 0)
    with monkeypatch.context() as broken:
        failing(broken, files, "_exchange", 3, FULL)
        with refuses(OSError, str(last), os.strerror(errno.ENOSPC)):
            write_all()
    assert (content(old), content(last), names(tmp_path)) == ("before", "before", ["last", "old"])
    write_all()
    assert {content(place) for place in (old, new, last)} == {"after"}
    assert names(tmp_path) == ["last", "new", "old"]


@pytest.mark.parametrize("kind", ["file", "folder"])
@pytest.mark.parametrize("before", [True, False])
def test_what_another_program_makes_or_changes_meanwhile_is_not_replaced(
    kind: str, before: bool, tmp_path: Path
) -> None:
    """A folder that somebody made while a command worked was replaced with all that was in it."""
    place = tmp_path / "place"
    if before:
        write(place, kind, "old")
    with files.refuse_changed_targets():
        check_writable(place, folder=kind == "folder")
        write(place, kind, "mine")  # its own change is known
        if kind == "folder":
            (place / "note").write_text("precious")
        else:
            place.unlink()
            place.write_text("precious")
        with refuses(OSError, str(place)):
            write(place, kind, "new")
    assert "precious" in (place / "note" if kind == "folder" else place).read_text()


def test_no_command_writes_two_outputs_to_one_file(tmp_path: Path) -> None:
    """By one name, or through a link."""
    (tmp_path / "link").symlink_to("place")
    with refuses(OSError, "link"):
        check_writable(tmp_path / "place", tmp_path / "link")


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_what_is_replaced_keeps_its_permissions(kind: str, tmp_path: Path) -> None:
    """Nobody else may read what nobody else might."""
    write(tmp_path / "place", kind, "old")
    (tmp_path / "place").chmod(0o700)
    write(tmp_path / "place", kind)
    assert (tmp_path / "place").stat().st_mode & 0o777 == 0o700
