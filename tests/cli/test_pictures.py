"""view and report on the command line: run folders and recordings, and what cannot be shown."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import testbed as tb
from testbed.experiment.run import Run
from testbed.experiment.run_folder import write_run
from tests.helpers.command import command_line
from tests.helpers.ideal import ideal
from tests.helpers.paths import ROOT
from tests.helpers.runs import MODELS, noisy, robot, without

pytestmark = pytest.mark.slow

TX40 = ROOT / "examples/tx40"
REAL = ("--model", str(TX40 / "tx40.urdf"))
PUMA = str(ROOT / "models/puma562.xml")


@pytest.fixture(scope="module")
def folder(puma_run: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("runs") / "puma"
    write_run(puma_run, path)
    return path


@pytest.fixture(scope="module")
def recording(puma_recording: tb.Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recordings") / "mine.parquet"
    puma_recording.save(path)
    return path


@pytest.mark.slow
def test_a_run_folders_report_is_checked_on_another_motion(folder: Path, tmp_path: Path) -> None:
    done = command_line("report", str(folder), "--out", "page.html", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    numbers = json.loads((tmp_path / "page.json").read_text())
    assert numbers["has_truth"]
    assert numbers["figures"][0]["title"].endswith("a motion that no estimate has seen")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["page.html", "page.json"]


@pytest.mark.slow
def test_a_recordings_report_needs_a_model_and_takes_settings(
    recording: Path, tmp_path: Path
) -> None:
    words = ["report", str(recording), "--model", PUMA, "--zeros", "--out", "page.html"]
    done = command_line(*words, "--set", "identification.cutoff=8", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    numbers = json.loads((tmp_path / "page.json").read_text())
    assert not numbers["has_truth"]
    assert [row["name"] for row in numbers["parameters"]][:2] == ["mbar1", "mb*2z"]
    assert numbers["figures"][0]["title"].endswith("the motion that was identified")
    assert "on rows 8 Hz" in dict(numbers["asked"])["identification"]


@pytest.mark.slow
def test_folders_and_recordings_are_shown_side_by_side(
    folder: Path, recording: Path, tmp_path: Path
) -> None:
    words = ["view", str(folder), str(recording), "--model", PUMA, "--save", "both.rrd"]
    done = command_line(*words, cwd=tmp_path)
    assert done.returncode == 0
    assert "both.rrd" in done.stdout
    assert (tmp_path / "both.rrd").stat().st_size > 1e5


@pytest.mark.slow
@pytest.mark.parametrize("command", ["view", "report"])
def test_a_wrench_alone_is_shown_and_what_lacks_is_said(command: str, tmp_path: Path) -> None:
    without(noisy(ideal(robot("gantry"))), "torque").save(tmp_path / "r.parquet")
    model = ["--model", str(MODELS["gantry"])]
    out = ["--save", "r.rrd"] if command == "view" else []  # a page stands beside the recording
    done = command_line(command, "r.parquet", *model, *out, cwd=tmp_path)
    assert done.returncode == 0
    said = done.stdout if command == "view" else (tmp_path / "r.html").read_text()
    assert "no internal estimate: the recording has no torque" in said


@pytest.mark.parametrize("command", ["view", "report"])
def test_what_cannot_be_shown_is_said(
    command: str, folder: Path, recording: Path, tmp_path: Path
) -> None:
    """One line, exit code 2, nothing written."""
    (tmp_path / "empty").mkdir()
    (tmp_path / "text.parquet").write_text("no recording")
    faults = {
        ("nothing",): "there is no run folder or recording 'nothing'",
        ("empty",): "is no run folder",
        (str(recording),): "a recording needs --model",
        (str(recording), "--model", "none.urdf"): "none.urdf",
        (str(recording), "--model", str(MODELS["ur5"])): "of another robot",
        ("text.parquet", "--model", PUMA): "text.parquet",
        (str(folder), "--model", PUMA): "is a run folder: it has its own model",
        (str(folder), "--set", "identification.cutoff=8"): "is a run folder: it has its own model",
        (str(recording), "--model", PUMA, "--set", "identification.cut=8"): "did you mean 'cutoff'",
    }
    before = sorted(p.name for p in tmp_path.iterdir())
    save = ["--save", "x.rrd"] if command == "view" else []  # there may be no screen
    for words, said in faults.items():
        done = command_line(command, *words, *save, cwd=tmp_path)
        assert done.returncode == 2, words
        assert said in done.stderr
        assert done.stderr.count("\n") == 1
        assert done.stdout == ""
    assert sorted(p.name for p in tmp_path.iterdir()) == before


def halves(folder: Path) -> tuple[str, str]:
    """Mapping files of the two halves of a real recording."""
    text = (TX40 / "tx40.toml").read_text().replace('file = "', f'file = "{TX40}/')
    for name, cut in (("first.toml", "stop = 4.6"), ("second.toml", "start = 4.6")):
        (folder / name).write_text(text.replace("rate = 500\n", f"rate = 500\n{cut}\n", 1))
    return "first.toml", "second.toml"


@pytest.mark.slow
def test_a_real_recording_is_reported_and_judged_by_another(tmp_path: Path) -> None:
    """Two mapping files, chosen terms, bodies that can exist; no truth anywhere."""
    first, second = halves(tmp_path)
    words = ["report", first, *REAL, "--validate", second, "--out", "page.html"]
    words += ["--terms", "auto", "--consistent", "--set", "identification.cutoff=10"]
    done = command_line(*words, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    numbers = json.loads((tmp_path / "page.json").read_text())
    assert not numbers["has_truth"]
    ids = [section["id"] for section in numbers["figures"]]
    assert ids == ["prediction", "spectra", "bodies"]
    assert numbers["figures"][0]["title"].endswith("a motion that no estimate has seen")
    assert numbers["figures"][0]["heads"][-1] == "over what is allowed, internal"
    assert any(key == "terms" and "foretold" in said for key, said in numbers["asked"])
    assert any(line.startswith("second.toml: ") for line in numbers["warnings"])


@pytest.mark.slow
def test_a_real_recording_is_shown_moving(tmp_path: Path) -> None:
    first, _ = halves(tmp_path)
    done = command_line("view", first, *REAL, "--save", "moving.rrd", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "moving.rrd").stat().st_size > 1e5


@pytest.mark.slow
def test_a_recording_that_cannot_be_true_is_not_reported(tmp_path: Path) -> None:
    first, _ = halves(tmp_path)
    wrong = (tmp_path / first).read_text().replace("offset = [0, -1.57", "offset = [0, 1.57")
    (tmp_path / first).write_text(wrong)
    for command in (("report",), ("view", "--save", "x.rrd")):
        done = command_line(*command, first, *REAL, cwd=tmp_path)
        assert done.returncode == 2
        assert "cannot be true of this robot" in done.stderr
    assert sorted(p.name for p in tmp_path.iterdir()) == ["first.toml", "second.toml"]


def test_a_run_folder_is_judged_by_its_own_unseen_motion(folder: Path, tmp_path: Path) -> None:
    for words in (["--validate", "other.parquet"], ["--consistent"]):
        done = command_line("report", str(folder), *words, cwd=tmp_path)
        assert done.returncode == 2
        assert "are for recordings" in done.stderr
