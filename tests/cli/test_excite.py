"""`testbed excite` as a person calls it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.helpers.command import command_line, command_process
from tests.helpers.runs import MODELS

QUICK = (
    "--set",
    "excitation.starts=1",
    "--set",
    "excitation.harmonics=4",
    "--set",
    "motion.duration=10",
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("excite")
    done = command_line(
        "excite",
        str(MODELS["puma"]),
        *QUICK,
        "--page",
        "page.html",
        "--trajectory",
        "t.csv",
        cwd=place,
    )
    assert done.returncode == 0, done.stderr
    assert "proven at every moment" in done.stdout
    printed = " ".join(done.stdout.split())
    assert "times smaller than that of the best of 40 random motions" in printed
    return place


@pytest.mark.slow
def test_it_writes_motion_page_and_samples(folder: Path) -> None:
    assert {each.name for each in folder.iterdir()} == {"motion.toml", "page.html", "t.csv"}
    page = (folder / "page.html").read_text()
    assert "limits proven at every moment" in page
    assert page.count("<svg") >= 8


@pytest.mark.slow
def test_a_motion_is_checked(folder: Path) -> None:
    done = command_line("excite", "motion.toml", "--check", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert "proven at every moment" in done.stdout
    tight = ("--set", "motion.max_velocity={elbow=0.3}")
    done = command_line("excite", "motion.toml", "--check", *tight, cwd=folder)
    assert done.returncode == 1
    assert "NOT proven" in done.stdout
    assert "velocity of 'elbow'" in done.stdout
    done = command_line("excite", "motion.toml", "--check", "--json", cwd=folder)
    said = json.loads(done.stdout)
    assert said["holds"] is True
    assert {margin["label"] for margin in said["margins"]} > {"velocity of 'elbow'"}


@pytest.mark.slow
def test_numbers_are_for_programs(tmp_path: Path) -> None:
    done = command_line("excite", str(MODELS["puma"]), *QUICK, "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert said["gain"] > 1
    assert said["proof"]["holds"] is True
    assert len(said["predicted"]["sigma"]) == len(said["predicted"]["names"])
    assert said["searches"][0]["end"] < said["searches"][0]["start"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("none.xml",), "no model file"),
        (("none.toml",), "there is no experiment file"),
        (("motion.toml", "--check"), "there is no motion file"),
        ((str(MODELS["puma"]), "--set", "excitation.criterion=x"), "excitation.criterion"),
        ((str(MODELS["puma"]), "--set", "excitation.plate_range=[1,1,1,1,1,1]"), "plate"),
        ((str(MODELS["puma"]), "--prior", "none.json"), "there is no result"),
        ((str(MODELS["puma"]), *QUICK, "--trajectory", "t.doc"), "as .csv or .parquet"),
    ],
)
def test_wrong_input_is_one_line(words: tuple[str, ...], says: str, tmp_path: Path) -> None:
    done = command_line("excite", *words, cwd=tmp_path)
    assert done.returncode == 2
    assert says in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_ctrl_c_leaves_a_motion_that_may_be_run(tmp_path: Path) -> None:
    """The first one ends the search; the proof and the file follow."""
    import signal
    import subprocess
    import sys
    import time

    many = ("--set", "excitation.starts=10000", "--set", "motion.duration=10")
    words = [sys.executable, "-m", "testbed.cli", "excite", str(MODELS["puma"]), *many]
    with subprocess.Popen(
        words, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as run:
        time.sleep(8)
        run.send_signal(signal.SIGINT)
        out, err = run.communicate(timeout=120)
    assert run.returncode == 0, err
    assert b"stopped before they ended" in out
    done = command_process("excite", "motion.toml", "--check", cwd=tmp_path)
    assert done.returncode == 0


@pytest.mark.slow
def test_too_many_samples_are_counted_before_they_are_made(folder: Path) -> None:
    rows = (folder / "t.csv").read_text().splitlines()
    first, last = (float(rows[k].partition(",")[0]) for k in (1, -1))
    many = (*QUICK, "--out", "many.toml", "--trajectory", "many.csv", "--rate", "1e8")
    done = command_line("excite", str(MODELS["puma"]), *many, cwd=folder)
    assert done.returncode == 2
    assert f"{last - first:g} s at 1e+08 Hz are {1e8 * (last - first):.1e} samples" in done.stderr
    assert list(folder.glob("many*")) == []
