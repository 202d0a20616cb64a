"""Options that do not go together, and short ways that give the same as long ones."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from tests.helpers.campaigns import campaign_file
from tests.helpers.command import command_line
from tests.helpers.plates import loaded, resting
from tests.helpers.runs import MODELS, robot

PUMA = MODELS["puma"].name


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A robot, a campaign, and a robot at rest without and with a payload."""
    folder = tmp_path_factory.mktemp("place")
    shutil.copy(MODELS["puma"], folder / PUMA)
    levels = '[[factor]]\nname = "seed"\nset = ["seed=$"]\nvalues = [{}]\n'
    campaign_file(folder, 2, levels.format(", ".join(map(str, range(1, 24)))))
    tree = robot("puma")
    resting(tree, 1).save(folder / "alone.parquet")
    resting(loaded(tree), 2).save(folder / "loaded.parquet")
    (folder / "key.pem").write_text("no key")
    return folder


WRONG: dict[str, tuple[tuple[str, ...], str]] = {
    "joint without payload": (
        ("calibrate", "alone.parquet", "--model", PUMA, "--known", "mass=20", "--joint", "elbow"),
        "--joint says what carries the payload of --loaded: give both",
    ),
    "zeros twice": (
        ("equations", PUMA, "--zeros", "--zero", "mb1x"),
        "--zeros takes those of the file, --zero NAME others: give one",
    ),
    "a key without its certificate": (
        ("campaign", "quick.toml", "--tls-key", "key.pem"),
        "--tls-ca, --tls-cert and --tls-key go together",
    ),
    "a certificate that is not there": (
        (
            *("campaign", "quick.toml", "--scheduler", "tls://127.0.0.1:1", "--tls-key", "key.pem"),
            *("--tls-ca", "key.pem", "--tls-cert", "none.pem"),
        ),
        "there is no file 'none.pem'",
    ),
    "encryption to nobody": (
        (
            *("campaign", "quick.toml", "--tls-key", "key.pem", "--tls-ca", "key.pem"),
            *("--tls-cert", "key.pem"),
        ),
        "the TLS options go with --scheduler",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_options_that_do_not_go_together_are_refused(place: Path, name: str) -> None:
    words, said = WRONG[name]
    done = command_line(*words, cwd=place)
    assert done.returncode == 2
    assert said in " ".join(done.stderr.replace("│", " ").split())
    assert not done.stdout


def test_equations_for_programs_are_those_for_people(place: Path) -> None:
    words = ("equations", PUMA, "--what", "gravity-forces", "--zeros")
    plain = command_line(*words, cwd=place)
    assert plain.returncode == 0, plain.stderr
    document = json.loads(command_line(*words, "--json", cwd=place).stdout)
    assert plain.stdout in document.values()


def test_a_plan_lists_twenty_cells_and_counts_the_others(place: Path) -> None:
    done = command_line("campaign", "quick.toml", "--dry-run", cwd=place)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert sum(line.startswith("cell ") for line in lines) == 20
    assert "cell 19: seed = 20" in lines
    assert "... 3 more" in lines
    assert "23 cells, 2 replicates each: 46 runs" in lines
    few = command_line("campaign", "quick.toml", "--dry-run", "--limit", "5", cwd=place).stdout
    assert "23 cells, 2 replicates each: 5 runs" in few
    many = command_line("campaign", "quick.toml", "--dry-run", "--limit", "99", cwd=place).stdout
    assert "23 cells, 2 replicates each: 46 runs" in many


def test_a_payload_at_rest_is_the_same_in_words_and_for_programs(place: Path) -> None:
    words = ("payload", "alone.parquet", "loaded.parquet", "--model", PUMA, "--at-rest")
    done = command_line(*words, cwd=place)
    assert done.returncode == 0, done.stderr
    found = json.loads(command_line(*words, "--json", cwd=place).stdout)
    mass, sigma = found["mass"]["value"], found["mass"]["sigma"]
    assert found["mass"]["unit"] == found["robot_mass"]["unit"] == "kg"
    true = loaded(robot("puma")).inertias[-1].mass - robot("puma").inertias[-1].mass
    assert abs(mass - true) < 5 * sigma < 0.2
    total = sum(body.mass for body in robot("puma").inertias)
    assert abs(found["robot_mass"]["value"] - total) < 5 * found["robot_mass"]["sigma"] < 0.2
    centre, doubt = found["centre"]
    assert len(centre) == len(doubt) == 3
    line = " ".join(done.stdout.split())
    assert line.startswith(f"Payload: {mass:.2f}"[:12])
    assert "centre of mass" in line
    assert "by 16 poses. What moves of the robot: " in line
