"""Files and folders appear whole or not at all, whoever writes, fails or is killed."""

from __future__ import annotations

import errno
import os
import random
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from testbed import files
from testbed.files import replacing
from tests.helpers.paths import ROOT

WRITER = """
import sys
from pathlib import Path
from testbed import files
from testbed.files import replacing
place, folder, times = Path(sys.argv[1]), sys.argv[2] == "folder", int(sys.argv[3])
if sys.argv[4] == "two steps":
    files._exchanged = lambda a, b: False
print("here", flush=True)
for k in range(times):
    with replacing(place, folder=folder) as fresh:
        for name in ("a", "b") if folder else ("",):
            path = fresh / name
            path.parent.mkdir(exist_ok=True)
            path.write_text(f"{sys.argv[5]}{k} " * 2000)
"""
"""Replaces a file, or a folder of two files that agree, again and again."""


def writer(
    place: Path, kind: str, times: int, steps: str = "one step", name: str = "w"
) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", WRITER, str(place), kind, str(times), steps, name]
    path = os.environ | {"PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=path)
    assert process.stdout is not None
    with process.stdout as words:
        assert words.readline() == "here\n"
    return process


def content(place: Path) -> str:
    """The word that a complete file or folder consists of."""
    texts = [path.read_text() for path in sorted(place.iterdir())] if place.is_dir() else []
    assert not texts or len(texts) == 2
    words = {word for text in texts or [place.read_text()] for word in text.split()}
    assert all(len(text.split()) == 2000 for text in texts)
    (word,) = words
    return word


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def nests(folder: Path) -> list[str]:
    return [name for name in names(folder) if name.startswith(".testbed-")]


def write(place: Path, kind: str, word: str = "new") -> None:
    with replacing(place, folder=kind == "folder") as fresh:
        for path in (fresh / "a", fresh / "b") if kind == "folder" else (fresh,):
            path.parent.mkdir(exist_ok=True)
            path.write_text(f"{word} " * 2000)


@pytest.mark.parametrize("kind", ["file", "folder"])
@pytest.mark.slow
def test_at_every_instant_one_of_them_is_there(kind: str, tmp_path: Path) -> None:
    place = tmp_path / "place"
    write(place, kind, "old")
    process = writer(place, kind, 400)
    looks = 0
    while process.poll() is None:
        place.stat()
        looks += 1
    assert looks > 400
    assert content(place) == "w399"
    assert names(tmp_path) == ["place"]


@pytest.mark.slow
@pytest.mark.parametrize("steps", ["one step", "two steps"])
@pytest.mark.parametrize("kind", ["file", "folder"])
def test_three_writers_at_once(kind: str, steps: str, tmp_path: Path) -> None:
    place = tmp_path / "place"
    processes = [writer(place, kind, 100, steps, name) for name in "xyz"]
    assert [process.wait() for process in processes] == [0, 0, 0]
    assert content(place)[1:] == "99"
    assert names(tmp_path) == ["place"]


@pytest.mark.parametrize("steps", ["one step", "two steps"])
@pytest.mark.parametrize("kind", ["file", "folder"])
@pytest.mark.slow
def test_what_a_killed_writer_leaves_is_swept_by_the_next(
    kind: str, steps: str, tmp_path: Path
) -> None:
    place = tmp_path / "place"
    write(place, kind, "old")
    chance = random.Random(1)
    left = 0
    for _ in range(12):
        process = writer(place, kind, 10**9, steps)
        time.sleep(chance.uniform(0, 0.05))
        process.kill()
        process.wait()
        left += bool(nests(tmp_path))
        if steps == "one step":
            assert content(place)
        write(tmp_path / "another", "file")
        assert content(place)
        assert not nests(tmp_path)
    assert left


def test_an_older_folder_is_put_back_if_its_writer_dies_between_two_renames(
    tmp_path: Path,
) -> None:
    place = tmp_path / "place"
    write(place, "folder", "old")
    nest, lock = files._new_nest(tmp_path)
    (nest / "older").mkdir()
    place.rename(nest / "older" / "place")
    os.close(lock)
    write(tmp_path / "another", "file")
    assert content(place) == "old"
    assert not nests(tmp_path)


def test_a_living_writer_is_left_alone(tmp_path: Path) -> None:
    def meanwhile() -> None:
        for k in range(20):
            write(tmp_path / f"other{k % 3}", "folder")

    with replacing(tmp_path / "slow") as fresh:
        fresh.write_text("first half, ")
        thread = threading.Thread(target=meanwhile)
        thread.start()
        process = writer(tmp_path / "third", "file", 20)
        thread.join()
        assert process.wait() == 0
        fresh.write_text(fresh.read_text() + "second half")
    assert (tmp_path / "slow").read_text() == "first half, second half"
    assert not nests(tmp_path)


def test_folders_of_other_machines_and_of_other_names_are_not_touched(tmp_path: Path) -> None:
    others = [tmp_path / ".testbed-ANOTHER-abc", tmp_path / ".testbedfoo", tmp_path / "fresh"]
    for path in others:
        path.mkdir()
    (tmp_path / f"{files.NEST}link").symlink_to(others[-1])
    (tmp_path / f"{files.NEST}file").write_text("no nest")
    write(tmp_path / "place", "file")
    assert all(path.is_dir() for path in others)
    assert names(others[-1]) == []


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_what_fails_leaves_everything_as_it_was(kind: str, tmp_path: Path) -> None:
    place = tmp_path / "place"
    write(place, kind, "old")
    for target in (place, tmp_path / "new" / "deep" / "place"):
        with (  # noqa: PT012
            pytest.raises(ZeroDivisionError),
            replacing(target, folder=kind == "folder") as fresh,
        ):
            (fresh if kind == "folder" else fresh.parent).mkdir(exist_ok=True)
            (fresh / "a" if kind == "folder" else fresh).write_text("half")
            _ = 1 / 0
    assert content(place) == "old"
    assert names(tmp_path) == ["place"]


def test_a_link_stays_and_what_it_points_to_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "far").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "far/place")
    for word in ("first", "second"):
        write(tmp_path / "link", "file", word)
        assert content(tmp_path / "far/place") == word
    assert (tmp_path / "link").is_symlink()


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_places_where_nothing_can_stand(kind: str, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("a file")
    (tmp_path / "full").mkdir()
    (tmp_path / "full/a").write_text("kept")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    os.mkfifo(tmp_path / "pipe")
    before = names(tmp_path)
    wrong = {
        "loop": "cannot be written",
        "loop/x": "cannot be written",
        "a\0b": "cannot be written: .*embedded null",
        "x" * 300: "cannot be written: File name too long",
        "file/x": "cannot be written: Not a directory",
        "/dev/null/x": "Not a directory",
        "file" if kind == "folder" else "full": "choose another name",
        "pipe": "is a file" if kind == "folder" else "is a device or pipe",
        "/dev/null": "is a file" if kind == "folder" else "is a device or pipe",
    }
    for name, said in wrong.items():
        with pytest.raises(OSError, match=said):
            write(tmp_path / name, kind)
    assert names(tmp_path) == before
    assert (tmp_path / "full/a").read_text() == "kept"


def test_a_folder_that_may_not_be_written(tmp_path: Path) -> None:
    if os.geteuid() == 0:
        place = Path("/proc/testbed")  # root may write anywhere else
    else:
        place = tmp_path / "closed"
        tmp_path.chmod(0o500)
    with pytest.raises(OSError, match="may not be written there"):
        write(place, "file")


def test_a_file_is_meant_unless_a_folder_is_said(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    with pytest.raises(OSError, match="'.*folder' is a folder"), replacing(tmp_path / "folder"):
        pass


def test_folders_made_on_the_way_go_where_nothing_can_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*arguments: object, **named: object) -> str:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("tempfile.mkdtemp", full)
    with pytest.raises(OSError, match=r"may not be written there: No space left"):
        write(tmp_path / "new" / "deep" / "place", "file")
    assert names(tmp_path) == []


def test_writing_leaves_no_file_open(tmp_path: Path) -> None:
    """Nor does sweeping, nor a nest that somebody else holds."""
    own = Path("/proc/self/fd")
    if not own.is_dir():
        pytest.skip("this system does not list open files")
    held, lock = files._new_nest(tmp_path)
    before = len(names(own))
    for k in range(10):
        left, dead = files._new_nest(tmp_path)
        os.close(dead)
        write(tmp_path / "place", "file", f"w{k}")
        assert not left.exists()
    assert len(names(own)) == before
    os.close(lock)
    assert held.exists()


def test_where_there_are_no_locks_files_are_written_and_nothing_is_swept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody can know there whether the writer of a nest is alive."""
    left, dead = files._new_nest(tmp_path)
    os.close(dead)

    def without(*arguments: object) -> None:
        raise OSError(37, "No locks available")

    monkeypatch.setattr("fcntl.flock", without)
    write(tmp_path / "place", "file")
    assert content(tmp_path / "place") == "new"
    assert nests(tmp_path) == [left.name]


@pytest.mark.parametrize(("code", "other"), [("EINVAL", True), ("ENOSYS", True), ("EACCES", False)])
def test_a_file_system_that_cannot_exchange_is_no_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: str, other: bool
) -> None:
    """Two steps do it then; other errors are what they are."""
    number = getattr(errno, code)
    monkeypatch.setattr("ctypes.get_errno", lambda: number)
    here, nowhere = tmp_path / "here", tmp_path / "nowhere"
    here.mkdir()
    if other:
        assert files._exchanged(here, nowhere) is False
    else:
        with pytest.raises(PermissionError):
            files._exchanged(here, nowhere)
    assert here.is_dir()


def test_an_older_folder_is_put_back_if_the_fresh_one_cannot_take_its_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where two steps are needed and the second fails."""
    write(tmp_path / "place", "folder", "old")
    rename = Path.rename

    def refused(self: Path, target: Path) -> Path:
        if self.name == "fresh":
            raise PermissionError(errno.EACCES, "Permission denied")
        return rename(self, target)

    monkeypatch.setattr(files, "_exchanged", lambda a, b: False)
    monkeypatch.setattr(Path, "rename", refused)
    with pytest.raises(PermissionError):
        write(tmp_path / "place", "folder", "new")
    assert content(tmp_path / "place") == "old"
    assert names(tmp_path) == ["place"]
