"""Options: what holds where nothing is said, which of two counts, and where commands may write."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import get_args, get_type_hints

import pytest
from typer.models import OptionInfo

from testbed.cli.commands import app
from testbed.cli.reading import ReadingOptions
from tests.helpers.command import command_line
from tests.helpers.runs import MODELS

ROBOT = "--model puma562.xml"
WRITERS = {
    ("run", "--out"): ("", "table.toml"),
    ("simulate", "--out"): (".parquet", "table.toml"),
    ("excite", "--out"): (".toml", "two.urdf"),
    ("excite", "--trajectory"): (".csv", "two.urdf"),
    ("excite", "--page"): (".html", "two.urdf"),
    ("identify", "--write"): (".xml", f"one.parquet {ROBOT}"),
    ("drives", "--write"): (".xml", f"one.parquet {ROBOT}"),
    ("drives", "--friction"): (".csv", f"one.parquet {ROBOT}"),
    ("sample", "--out"): ("", "result.json"),
    ("calibrate", "--out"): (".toml", f"one.parquet {ROBOT} --known mass=20 --known gain/Mx=1"),
    ("report", "--out"): (".html", f"one.parquet {ROBOT}"),
    ("view", "--save"): (".rrd", f"one.parquet {ROBOT}"),
    ("campaign", "--out"): ("", "quick.toml --workers 0"),
    ("equations", "--out"): (".txt", "puma562.xml --what gravity-forces"),
    ("import", "--out"): (".parquet", "map.toml"),
    ("import", "--page"): (".html", "log.csv --guess --model two.urdf"),
    ("new", "--out"): (".toml", "two.urdf"),
}
"""Every option that names what is to be written; its ending, none of folders; what is read."""
READ = {"--model", "--prior", "--plate", "--loaded", "--validate", "--against", "--recording"}
READ |= {"--unseen"}


def test_no_writer_is_left_out_here() -> None:
    paths = set()
    for command in app.registered_commands:
        assert command.callback is not None
        for name, hint in get_type_hints(command.callback, include_extras=True).items():
            kind, *about = get_args(hint) or (hint,)
            if kind in (Path, Path | None) and about and isinstance(about[0], OptionInfo):
                said = about[0].param_decls or (f"--{name.replace('_', '-')}",)
                paths.add((command.name or command.callback.__name__, said[0]))
    assert {at for at in paths if at[1] not in READ} == set(WRITERS)


@pytest.mark.slow
def test_what_stands_there_is_not_written_over_and_that_is_said_before_the_work(
    place: Path, tmp_path: Path
) -> None:
    """A folder or a file in the way, a name too long; what is read, by its name or by another."""
    home = tmp_path / "home"
    shutil.copytree(place, home)
    for ending, words in WRITERS.values():
        (home / f"taken{ending}/kept").mkdir(parents=True, exist_ok=True)
        for name in words.split() if ending else ():
            link = home / f"link-{name}{ending}"
            if (home / name).is_file() and not link.exists():
                link.symlink_to(name)
        shutil.copy(home / "one.parquet", home / f"theirs{ending or '.folder'}")
    before = {path: path.is_file() and path.read_bytes() for path in home.rglob("*")}
    for (command, option), (ending, words) in WRITERS.items():
        read = [word for word in words.split() if (home / word).is_file() and ending]
        outs = [f"{name}{ending}" for name in ("taken", "puma562.xml/x", "x" * 300)]
        outs.append(f"theirs{ending or '.folder'}")
        for out in (*outs, *read, *(f"link-{name}{ending}" for name in read)):
            done = command_line(command, *words.split(), option, out, cwd=home)
            assert (done.returncode, done.stdout) == (2, ""), (command, option, out)
            assert len(done.stderr.splitlines()) == 1, done.stderr
    assert {path: path.is_file() and path.read_bytes() for path in home.rglob("*")} == before


@pytest.mark.slow
def test_files_of_names_that_nobody_gave_are_kept(place: Path, tmp_path: Path) -> None:
    """Also numbers beside a page; a run's own page is written again."""
    shutil.copytree(place, home := tmp_path / "home")
    for name, words in {
        "one.json": f"report one.parquet {ROBOT}",
        "motion.toml": "excite two.urdf",
        "plate.toml": f"calibrate one.parquet {ROBOT} --known mass=20 --known gain/Mx=1",
        "log.toml": "new --recording log.csv",
        "two.toml": "new two.urdf",
    }.items():
        (home / name).write_text("mine")
        assert command_line(*words.split(), cwd=home).returncode == 2, words
        assert (home / name).read_text() == "mine", words
    for _ in range(2):
        assert command_line("report", "run", cwd=home).returncode == 0


@pytest.mark.slow
def test_a_campaign_keeps_the_file_that_asks_for_it(place: Path, tmp_path: Path) -> None:
    """Alone in its folder, where the folder looks like a campaign's."""
    text = (place / "quick.toml").read_text()
    (tmp_path / "campaign.toml").write_text(text)
    words = ("campaign", "campaign.toml", "--workers", "0", "--out", ".")
    assert command_line(*words, cwd=tmp_path).returncode == 2
    assert [path.read_text() for path in tmp_path.iterdir()] == [text]


def test_of_an_option_and_a_setting_the_option_counts() -> None:
    """Else a joint is held elsewhere than the command line says, or other terms are estimated."""
    held = ReadingOptions(MODELS["puma"], ["robot.lock.waist=0.25"], lock=["waist=0.5", "elbow"])
    assert dict(held.file.lock) == {"waist": 0.5, "elbow": None}
    told = ReadingOptions(
        settings=['identification.terms=["rotor"]'], terms="coulomb,viscous", zeros=True
    )
    table = told.tables.identification
    assert (table.terms, table.zeros) == (("coulomb", "viscous"), True)
    assert ReadingOptions(terms="auto").tables.identification.terms == "auto"


@pytest.mark.slow
def test_a_joint_that_follows_is_held_where_it_is_told_to_be(place: Path) -> None:
    path = place / "mimic.urdf"
    for how in (
        ReadingOptions(path, lock_mimic=True),
        ReadingOptions(path, ["robot.lock_mimic=true"]),
    ):
        assert dict(how.file.lock) == {"j2": None}
        placed = replace(how, lock=["j2=0.5"])
        assert dict(placed.file.lock) == {"j2": 0.5}
    assert not ReadingOptions(path, ["robot.lock_mimic=false"]).file.lock


def test_a_floating_root_is_welded_where_it_is_said_or_its_base_is_measured() -> None:
    for reading, welded in (
        (ReadingOptions(weld_root=True, settings=["identification.zeros=true"]), True),
        (ReadingOptions(settings=['robot.base="measured"']), True),
        (ReadingOptions(settings=["identification.zeros=true"]), False),
    ):
        assert replace(reading, model=MODELS["puma"]).file.weld_root is welded
