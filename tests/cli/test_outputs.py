"""Wherever a command is told to write: it can, or it says so before the work, in one line."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path
from typing import get_args, get_type_hints

import pytest
from typer.models import OptionInfo

from testbed.cli.commands import app
from tests.helpers.campaigns import campaign_file
from tests.helpers.command import CLI, command_line
from tests.helpers.ideal import ideal
from tests.helpers.paths import ROOT
from tests.helpers.runs import MODELS, robot

WRITERS: dict[tuple[str, str], tuple[str, ...]] = {
    ("run", "--out"): ("one.toml",),
    ("simulate", "--out"): ("one.toml",),
    ("excite", "--out"): ("puma562.xml",),
    ("excite", "--trajectory"): ("puma562.xml",),
    ("excite", "--page"): ("puma562.xml",),
    ("identify", "--write"): ("made.parquet", "--model", "puma562.xml"),
    ("calibrate", "--out"): ("made.parquet", "--model", "puma562.xml", "--known", "mass=20"),
    ("report", "--out"): ("made.parquet", "--model", "puma562.xml"),
    ("view", "--save"): ("made.parquet", "--model", "puma562.xml"),
    ("campaign", "--out"): ("quick.toml", "--workers", "0"),
    ("campaign", "--rrd"): ("there", "--summary"),
    ("equations", "--out"): ("puma562.xml", "--what", "gravity-forces"),
    ("import", "--out"): ("mapping.toml",),
    ("import", "--page"): ("log.npz", "--guess", "--model", "puma562.xml"),
    ("new", "--out"): ("puma562.xml",),
}
"""Every option that names what is to be written, and what the command reads."""

ENDINGS = {
    "simulate": ".parquet", "excite": ".toml", "--trajectory": ".csv", "--page": ".html",
    "report": ".html", "--write": ".xml", "view": ".rrd", "--rrd": ".rrd", "import": ".parquet",
    "new": ".toml", "calibrate": ".toml", "equations": ".txt",
}  # fmt: skip
READ = {"--model", "--prior", "--plate", "--loaded", "--validate", "--against", "--recording"}
READ |= {"--tls-ca", "--tls-cert", "--tls-key"}
FOLDERS = {("run", "--out"), ("campaign", "--out")}


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All that the commands read."""
    folder = tmp_path_factory.mktemp("place")
    shutil.copy(MODELS["puma"], folder / "puma562.xml")
    (folder / "one.toml").write_text('name = "one"\nmodel = "puma562.xml"\n')
    campaign_file(folder, 1)
    ideal(robot("puma")).save(folder / "made.parquet")
    (folder / "there").mkdir()
    (folder / "there" / "kept").write_text("kept")
    (folder / "closed").mkdir(0o500)
    return folder


def contents(folder: Path) -> dict[Path, bytes | None]:
    return {p: None if p.is_dir() else p.read_bytes() for p in folder.rglob("*")}


def places(writer: tuple[str, str], folder: Path) -> list[str]:
    """Where it cannot write."""
    ending = "" if writer in FOLDERS else ENDINGS.get(writer[1]) or ENDINGS[writer[0]]
    closed = "/proc/testbed" if os.geteuid() == 0 else "closed/x"
    taken = "puma562.xml" if writer in FOLDERS else f"folder{ending}"
    if writer not in FOLDERS:
        (folder / taken).mkdir(exist_ok=True)
    return [".", "", "..", taken, f"puma562.xml/x{ending}", f"{closed}{ending}",
            f"{closed}/deep/er{ending}", f"{'x' * 300}{ending}"]  # fmt: skip


@pytest.mark.parametrize("writer", WRITERS, ids=" ".join)
def test_what_cannot_be_written_is_refused_before_the_work(
    writer: tuple[str, str], place: Path
) -> None:
    command, option = writer
    for out in places(writer, place):
        before = contents(place)
        done = command_line(command, *WRITERS[writer], option, out, cwd=place)
        assert (done.returncode, done.stdout) == (2, ""), (out, done)
        assert len(done.stderr.splitlines()) == 1, (out, done.stderr)
        assert done.stderr.startswith("testbed: ")
        assert contents(place) == before, out


@pytest.mark.parametrize("writer", WRITERS, ids=" ".join)
def test_what_is_read_is_not_replaced(writer: tuple[str, str], place: Path, tmp_path: Path) -> None:
    """Each file that a command's words name, as its own output; by another name of it, too."""
    command, option = writer
    folder = tmp_path / "place"
    shutil.copytree(place, folder, ignore=shutil.ignore_patterns("closed"))
    (folder / "campaign.toml").write_text((folder / "quick.toml").read_text())
    words = ["campaign.toml" if word == "quick.toml" else word for word in WRITERS[writer]]
    read = [word for word in words if (folder / word).is_file()]
    ending = ENDINGS.get(option) or ENDINGS.get(command, "")
    for name in read:
        link = folder / f"link{ending}"
        link.unlink(missing_ok=True)
        link.symlink_to(folder / name)
        for out in (".",) if writer in FOLDERS else (name, link.name):
            before = contents(folder)
            done = command_line(command, *words, option, out, cwd=folder)
            assert done.returncode == 2, (out, done)
            assert len(done.stderr.splitlines()) == 1, (out, done.stderr)
            assert contents(folder) == before, out


def test_a_campaign_keeps_the_file_that_asks_for_it(place: Path, tmp_path: Path) -> None:
    """Alone in its folder, where the folder looks like a campaign's."""
    text = (place / "quick.toml").read_text()
    (tmp_path / "campaign.toml").write_text(text)
    for out in (".", str(tmp_path)):
        done = command_line(
            "campaign", "campaign.toml", "--workers", "0", "--out", out, cwd=tmp_path
        )
        assert done.returncode == 2, done
        assert [p.read_text() for p in tmp_path.iterdir()] == [text]


def test_no_writer_is_left_out() -> None:
    paths = set()
    for command in app.registered_commands:
        assert command.callback is not None
        for name, hint in get_type_hints(command.callback, include_extras=True).items():
            kind, *about = get_args(hint) or (hint,)
            option = isinstance(about[0] if about else None, OptionInfo)
            if option and kind in (Path, Path | None):
                said = about[0].param_decls or (f"--{name.replace('_', '-')}",)
                paths.add(((command.name or command.callback.__name__).strip("_"), said[0]))
    assert {at for at in paths if at[1] not in READ} == set(WRITERS)


def test_a_working_folder_that_was_removed(place: Path, tmp_path: Path) -> None:
    gone = tmp_path / "gone"
    gone.mkdir()
    model = str(place / "puma562.xml")
    done = subprocess.run(
        ["sh", "-c", 'rmdir "$PWD"; exec "$@"', "sh", *CLI, "equations", model, "--out", "x"],
        cwd=gone, env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 2, done.stderr
    assert len(done.stderr.splitlines()) == 1
