"""Options: what holds where nothing is said, which of two counts, and where commands may write."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import get_args, get_type_hints

import pytest
from typer.models import OptionInfo

from testbed.cli.commands import app
from testbed.cli.reading import Reading
from tests.helpers.command import command_line
from tests.helpers.runs import MODELS

ROBOT = "--model puma562.xml"
WRITERS = {
    ("run", "--out"): "table.toml",
    ("simulate", "--out"): "table.toml",
    ("excite", "--out"): "two.urdf",
    ("excite", "--trajectory"): "two.urdf",
    ("excite", "--page"): "two.urdf",
    ("identify", "--write"): f"one.parquet {ROBOT}",
    ("calibrate", "--out"): f"one.parquet {ROBOT} --known mass=20",
    ("report", "--out"): f"one.parquet {ROBOT}",
    ("view", "--save"): f"one.parquet {ROBOT}",
    ("campaign", "--out"): "quick.toml --workers 0",
    ("campaign", "--rrd"): "run --summary",
    ("equations", "--out"): "puma562.xml --what gravity-forces",
    ("import", "--out"): "map.toml",
    ("import", "--page"): "log.csv --guess --model two.urdf",
    ("new", "--out"): "two.urdf",
}
"""Every option that names what is to be written, and what the command reads."""
ENDINGS = {
    "simulate": ".parquet", "import": ".parquet", "report": ".html", "--page": ".html",
    "--write": ".xml", "view": ".rrd", "--rrd": ".rrd", "--trajectory": ".csv", "excite": ".toml",
    "new": ".toml", "calibrate": ".toml", "equations": ".txt",
}  # fmt: skip
READ = {"--model", "--prior", "--plate", "--loaded", "--validate", "--against", "--recording"}
READ |= {"--tls-ca", "--tls-cert", "--tls-key"}
FOLDERS = {("run", "--out"), ("campaign", "--out")}


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
def test_what_cannot_be_written_is_said_before_the_work(place: Path, tmp_path: Path) -> None:
    """A folder where a file should be, a file where a folder should, a name that is too long."""
    before, kept = sorted(place.rglob("*")), (place / "puma562.xml").read_bytes()
    for (command, option), words in WRITERS.items():
        folder = (command, option) in FOLDERS
        ending = "" if folder else ENDINGS.get(option) or ENDINGS[command]
        taken = tmp_path / f"taken{ending}"
        taken.mkdir(exist_ok=True)
        (taken / "kept").touch()
        for out in (str(taken), f"puma562.xml/x{ending}", "x" * 300 + ending):
            done = command_line(command, *words.split(), option, out, cwd=place)
            assert (done.returncode, done.stdout) == (2, ""), (command, option, out)
            assert len(done.stderr.splitlines()) == 1, done.stderr
    assert sorted(place.rglob("*")) == before
    assert (place / "puma562.xml").read_bytes() == kept
    assert all([p.name for p in each.iterdir()] == ["kept"] for each in tmp_path.iterdir())


@pytest.mark.slow
def test_what_is_read_is_not_replaced(place: Path, tmp_path: Path) -> None:
    """Not by its own name and not by another: whoever mistypes keeps the data."""
    for (command, option), words in WRITERS.items():
        if (command, option) in FOLDERS:
            continue
        for name in [word for word in words.split() if (place / word).is_file()]:
            shutil.copy(place / name, tmp_path / name)
            link = tmp_path / f"link{ENDINGS.get(option) or ENDINGS[command]}"
            link.unlink(missing_ok=True)
            link.symlink_to(tmp_path / name)
            said = words.replace(name, str(tmp_path / name)).split()
            for out in (tmp_path / name, link):
                done = command_line(command, *said, option, str(out), cwd=place)
                assert done.returncode == 2, (command, option, out)
                assert len(done.stderr.splitlines()) == 1
            assert (tmp_path / name).read_bytes() == (place / name).read_bytes()


@pytest.mark.slow
def test_a_campaign_keeps_the_file_that_asks_for_it(place: Path, tmp_path: Path) -> None:
    """Alone in its folder, where the folder looks like a campaign's."""
    text = (place / "quick.toml").read_text()
    (tmp_path / "campaign.toml").write_text(text)
    words = ("campaign", "campaign.toml", "--workers", "0", "--out", ".")
    assert command_line(*words, cwd=tmp_path).returncode == 2
    assert [path.read_text() for path in tmp_path.iterdir()] == [text]


def test_of_an_option_and_a_setting_the_option_counts() -> None:
    held = Reading(settings=["robot.lock.waist=0.25"], lock=["waist=0.5", "elbow"])
    assert dict(held.model_file(MODELS["puma"]).lock) == {"waist": 0.5, "elbow": None}
    told = Reading(settings=['identification.terms=["rotor"]'], terms="coulomb,viscous", zeros=True)
    table = told.tables().identification
    assert (table.terms, table.zeros) == (("coulomb", "viscous"), True)
    assert Reading(terms="auto").tables().identification.terms == "auto"


@pytest.mark.slow
def test_a_joint_that_follows_is_held_where_it_is_told_to_be(place: Path) -> None:
    path = place / "mimic.urdf"
    for how in ({"lock_mimic": True}, {"settings": ["robot.lock_mimic=true"]}):
        assert dict(Reading(**how).model_file(path).lock) == {"follows": None}
        placed = Reading(**how, lock=["follows=0.5"])
        assert dict(placed.model_file(path).lock) == {"follows": 0.5}
    assert not Reading(settings=["robot.lock_mimic=false"]).model_file(path).lock


def test_a_floating_root_is_welded_where_it_is_said_or_its_base_is_measured() -> None:
    settings = ["identification.zeros=true"]
    for reading, welded in (
        (Reading(weld_root=True), True),
        (Reading(weld_root=True, settings=settings), True),
        (Reading(settings=['robot.base="measured"']), True),
        (Reading(settings=settings), False),
    ):
        assert reading.model_file(MODELS["puma"]).weld_root is welded
