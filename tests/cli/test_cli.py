"""The command line: exit codes, one clear line, nothing half-written, nothing heavy at start."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
from typer.models import CommandInfo
from typer.testing import CliRunner

import testbed as tb
from testbed.cli.commands import app
from testbed.instruments.catalogue import catalogue
from tests.helpers.command import command_line
from tests.helpers.paths import GOLDEN, ROOT

pytestmark = pytest.mark.slow

QUICK = ["motion.duration=4", "simulation.step=5e-4", "motion.candidates=2"]
PUMA = str(ROOT / "models/puma562.xml")
TABLE6 = str(ROOT / "experiments/table6.toml")


def sets(*settings: str) -> list[str]:
    return [word for setting in (*QUICK, *settings) for word in ("--set", setting)]


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "r.parquet"
    settings = ["motion.duration=10", "simulation.step=5e-4", "motion.candidates=5"]
    tb.simulate(tb.Experiment.load(TABLE6, settings)).save(path)
    return path


def test_run_prints_the_table_and_obeys_the_claim(tmp_path: Path) -> None:
    done = command_line("run", TABLE6, *sets("expect.external_max_z.at_most=100"), cwd=tmp_path)
    assert "mb*2z" in done.stdout
    assert "coulomb/elbow" not in done.stdout
    every = command_line("run", TABLE6, "--all", *sets("expect={}"), cwd=tmp_path)
    assert "coulomb/elbow" in every.stdout
    assert done.returncode == (1 if "FAILS" in done.stdout else 0)
    failed = command_line(
        "run", TABLE6, *sets("expect.external_rms_relative_error.at_most=1e-9"), cwd=tmp_path
    )
    assert failed.returncode == 1
    assert "FAILS" in failed.stdout


@pytest.mark.slow
def test_run_speaks_json(tmp_path: Path) -> None:
    done = command_line("run", TABLE6, "--json", *sets(), cwd=tmp_path)
    result = json.loads(done.stdout)
    assert result["name"] == "table6"
    assert (tmp_path / result["folder"] / "recording.parquet").is_file()
    assert done.stderr == ""


@pytest.mark.slow
def test_simulate_then_identify_is_run(recording: Path, tmp_path: Path) -> None:
    done = command_line(
        "identify", str(recording), "--model", PUMA, "--zeros", "--json", cwd=tmp_path
    )
    result = json.loads(done.stdout)
    assert result["external"]["values"][0] == pytest.approx(1.061, rel=0.01)
    assert result["internal"]["names"][-1] == "viscous/elbow"
    shown = command_line("identify", str(recording), "--model", PUMA, "--zeros", cwd=tmp_path)
    assert "K*1zz" in shown.stdout


def test_minimal_shows_both_sets(tmp_path: Path) -> None:
    done = command_line("minimal", PUMA, "--zeros", cwd=tmp_path)
    assert "joint torques tell 9 combinations and the bedplate 12" in done.stdout
    assert "K1yz - l12z*mb*2y" in done.stdout
    sets = json.loads(command_line("minimal", PUMA, "--json", cwd=tmp_path).stdout)
    assert (len(sets["dynamic"]["names"]), len(sets["reaction"]["names"])) == (15, 20)


def write(path: Path, text: str) -> str:
    path.write_text(text)
    return str(path)


def damaged(recording: Path, path: Path, column: str, value: float | None) -> str:
    table = pq.read_table(recording)
    k = table.schema.get_field_index(column)
    values = table[column].to_numpy().copy()
    if value is not None:
        values[100] = value
    table = table.set_column(k, table.schema.field(column), [values])
    pq.write_table(table.slice(0, 400 if value is None else table.num_rows), path)
    return str(path)


@pytest.mark.slow
def test_wrong_input_is_one_line_exit_code_two_and_nothing_left(
    recording: Path, tmp_path: Path
) -> None:
    place = tmp_path / "inputs"
    place.mkdir()
    broken = write(place / "broken.xml", "<mujoco><worldbody>")
    toml = write(place / "e.toml", 'name = "e"\nmodel = "broken.xml"\n')
    gone = write(place / "gone.toml", 'name = "e"\nmodel = "gone.xml"\n')
    nan = damaged(recording, place / "nan.parquet", "wrench/Fz", float("nan"))
    short = damaged(recording, place / "short.parquet", "time", None)
    ur5 = str(GOLDEN / "robots/ur5.urdf")
    empty = tmp_path / "empty"
    empty.mkdir()
    cases = {
        ("run", "nowhere.toml"): "there is no experiment file",
        ("run", toml): "not well-formed XML",
        ("run", gone): "there is no model file",
        ("run", TABLE6, "--set", "motion.duraton=1"): "did you mean 'duration'",
        ("run", TABLE6, "--set", "motion.duration=1e12"): "more than the 2e+06",
        ("run", TABLE6, "--out", str(place)): "is no run folder: it holds broken.xml",
        ("run", TABLE6, "--out", toml): "is a file",
        ("minimal", PUMA, "--gravity", "nan", "0", "0"): "three finite numbers",
        ("minimal", broken): "not well-formed XML",
        ("minimal", "nowhere.urdf"): "there is no model file",
        ("identify", "nowhere.parquet", "--model", PUMA): "there is no recording",
        ("identify", nan, "--model", PUMA): "'wrench/Fz' is nan at sample 100",
        ("identify", short, "--model", PUMA): "too short",
        ("identify", str(recording), "--model", ur5): "another robot",
        ("identify", PUMA, "--model", PUMA): "unknown format of a recording",
        ("identify", str(recording), "--model", PUMA, "--set", "identification.cutof=3"): (
            "did you mean 'cutoff'"
        ),
        ("identify", str(recording), "--model", PUMA, "--set", "motion.duration=3"): (
            "unknown key 'motion'"
        ),
        ("run", TABLE6, "--set", "duration=20"): "did you mean motion.duration?",
    }
    for arguments, said in cases.items():
        done = command_line(*arguments, cwd=empty)
        assert done.returncode == 2, (arguments, done.stderr)
        assert said in done.stderr, (arguments, done.stderr)
        assert done.stderr.count("\n") == 1, (arguments, done.stderr)
        assert "Traceback" not in done.stderr
        assert done.stdout == ""
        assert list(empty.iterdir()) == [], arguments


@pytest.mark.slow
def test_a_recording_without_an_estimate_is_kept(tmp_path: Path) -> None:
    done = command_line("run", TABLE6, *sets("motion.duration=0.5"), "--out", "short", cwd=tmp_path)
    assert done.returncode == 2
    assert "the recording is kept in 'short'" in done.stderr
    assert "too short" in done.stderr
    assert tb.Recording.load(tmp_path / "short/recording.parquet").samples == 500


@pytest.mark.slow
def test_a_run_of_another_experiment_is_replaced_by_force_only(tmp_path: Path) -> None:
    place = ("--out", "place")
    assert command_line("run", TABLE6, *sets(), *place, cwd=tmp_path).returncode in (0, 1)
    before = (tmp_path / "place/result.json").read_bytes()
    other = command_line("run", TABLE6, *sets(), "--set", "seed=7", *place, cwd=tmp_path)
    assert other.returncode == 2
    assert "--force replaces it" in other.stderr
    assert command_line("run", TABLE6, *sets(), *place, cwd=tmp_path).returncode in (0, 1)
    assert (tmp_path / "place/result.json").read_bytes() == before
    forced = command_line(
        "run", TABLE6, *sets(), "--set", "seed=7", *place, "--force", cwd=tmp_path
    )
    assert forced.returncode in (0, 1)
    assert (tmp_path / "place/result.json").read_bytes() != before


@pytest.mark.parametrize("kept", ["torque", "wrench"])
@pytest.mark.slow
def test_half_a_recording_gives_its_half_of_the_answer(
    kept: str, recording: Path, tmp_path: Path
) -> None:
    whole = tb.Recording.load(recording)
    gone: dict[str, Any] = {"torque" if kept == "wrench" else "wrench": None}
    replace(whole, truth=None, **gone).save(tmp_path / "half.parquet")
    method, other = ("external", "internal") if kept == "wrench" else ("internal", "external")
    call = ("identify", "half.parquet", "--model", PUMA, "--zeros")
    done = command_line(*call, "--json", cwd=tmp_path)
    assert done.returncode == 0
    assert set(json.loads(done.stdout)) - {"model", "settings"} == {method}
    said = command_line(*call, cwd=tmp_path)
    assert f"no {other} estimate" in said.stdout
    refused = command_line(*call, "--method", other, cwd=tmp_path)
    assert refused.returncode == 2
    assert f"its {kept} allows the {method} one" in refused.stderr


@pytest.mark.slow
def test_gravity_is_a_vector_however_it_is_written(tmp_path: Path) -> None:
    ways = (("0,0,-1.62",), ("0", "0", "-1.62"))
    said = [
        command_line("minimal", PUMA, "--json", "--gravity", *way, cwd=tmp_path) for way in ways
    ]
    assert said[0].stdout == said[1].stdout
    assert json.loads(said[0].stdout)["gravity"] == [0, 0, -1.62]


def test_equations_go_to_a_file_but_never_over_the_model(tmp_path: Path) -> None:
    words = ["equations", PUMA, "--what", "joint-forces", "--language", "c"]
    shown = command_line(*words, cwd=tmp_path)
    assert shown.returncode == 0
    written = command_line(*words, "--out", "puma.c", cwd=tmp_path)
    assert (written.returncode, written.stderr) == (0, "")
    assert (tmp_path / "puma.c").read_text().strip() == shown.stdout.strip()
    (tmp_path / "mine.xml").write_text(Path(PUMA).read_text())
    for place in ("mine.xml", "./mine.xml"):
        over = command_line("equations", "mine.xml", *words[2:], "--out", place, cwd=tmp_path)
        assert over.returncode == 2
        assert "is read by this command" in " ".join(over.stderr.split())
    assert (tmp_path / "mine.xml").read_text() == Path(PUMA).read_text()


def test_the_version_is_told(tmp_path: Path) -> None:
    assert command_line("--version", cwd=tmp_path).stdout.startswith("testbed ")


def test_a_body_that_cannot_be_is_repaired_and_said(tmp_path: Path) -> None:
    """By commands about kinematics at once, by `new` in the file, and by a run only from there."""
    text = (ROOT / "models/puma562.urdf").read_text().replace('ixx="0.3"', 'ixx="3.0"')
    model = write(tmp_path / "bad.urdf", text)
    known = command_line("minimal", model, cwd=tmp_path)
    assert known.returncode == 0
    assert "'link1'" in known.stdout
    refused = command_line("new", model, "--strict", cwd=tmp_path)
    assert refused.returncode == 2
    assert "link 'link1'" in refused.stderr
    assert not (tmp_path / "bad.toml").exists()
    written = command_line("new", model, cwd=tmp_path)
    assert written.returncode == 0
    assert "link 'link1' has principal moments" in written.stdout
    file = tmp_path / "bad.toml"
    short = ["motion.duration=2", "motion.candidates=1", "simulation.step=1e-3"]
    words = [word for each in short for word in ("--set", each)]
    ran = command_line("simulate", file.name, *words, "--out", "r.parquet", cwd=tmp_path)
    assert ran.returncode == 0, ran.stderr
    head, _, table = file.read_text().partition("[robot.repair]")
    file.write_text(head + table.partition("\n\n")[2])
    bare = command_line("simulate", file.name, *words, "--out", "s.parquet", cwd=tmp_path)
    assert bare.returncode == 2
    assert "link 'link1'" in bare.stderr
    assert "`testbed new`" in bare.stderr


def test_help_imports_nothing_heavy(tmp_path: Path) -> None:
    heavy = ("mujoco", "pinocchio", "scipy", "pyarrow", "rerun", "numpy", "pydantic")
    code = f"import sys, testbed.cli\nprint([m for m in {heavy!r} if m in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("command", app.registered_commands, ids=lambda each: each.name or "")
def test_every_command_helps_with_all_that_it_says_and_an_example(command: CommandInfo) -> None:
    assert command.callback is not None
    name = command.name or command.callback.__name__
    said = " ".join(CliRunner().invoke(app, [name, "--help"]).stdout.split())
    assert "Example: testbed" in said
    for paragraph in (command.callback.__doc__ or "").replace("`", "").split("\n\n"):
        assert " ".join(paragraph.split()) in said


def test_the_help_of_run_lists_every_fault(tmp_path: Path) -> None:
    done = command_line("run", "--help", cwd=tmp_path)
    said = set(re.findall("[a-z_]+", done.stdout))
    assert {entry.kind for entry in catalogue()} <= said
