"""The first commands of somebody new: new, doctor."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from testbed.cli import checkup
from testbed.viewer import show
from tests.helpers.command import command_line
from tests.helpers.runs import MODELS


@pytest.mark.slow
def test_a_new_experiment_runs_as_it_is(tmp_path: Path) -> None:
    done = command_line("new", str(MODELS["gantry"]), cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    file = tmp_path / f"{MODELS['gantry'].stem}.toml"
    assert f"testbed run {file.name}" in done.stdout
    quick = ["motion.duration=10", "motion.candidates=1", "simulation.step=1e-3"]
    ran = command_line("run", file.name, *(w for q in quick for w in ("--set", q)), cwd=tmp_path)
    assert ran.returncode == 0, ran.stderr
    assert "run folder: runs" in ran.stdout
    kept = file.read_bytes()
    again = command_line("new", str(MODELS["gantry"]), cwd=tmp_path)
    assert again.returncode == 2
    assert "is not replaced" in again.stderr
    assert file.read_bytes() == kept


def test_a_mapping_for_a_log(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("t,q1,q2\n" + "".join(f"{k / 100},0,{k}\n" for k in range(9)))
    done = command_line("new", "--recording", "log.csv", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    text = (tmp_path / "log.toml").read_text()
    assert 'columns = ["q1", "q2"]' in text
    assert "\nrate = 100 " in text  # as if t were seconds, which steps below one likely are
    assert "# [torque]  # no column looks like it" in text


@pytest.mark.parametrize("name", ["timestamp_ms", "t [ms]", "time (ms)"])
def test_a_clock_s_unit_may_be_in_its_name_and_is_confirmed(name: str, tmp_path: Path) -> None:
    rows = "".join(f"{4 * k},0,{k}\n" for k in range(9))
    (tmp_path / "log.csv").write_text(f"{name},q_hip_deg,tau_hip\n{rows}")
    done = command_line("new", "--recording", "log.csv", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    text = (tmp_path / "log.toml").read_text()
    assert "\nrate = 250 " in text
    assert 'time_unit = "ms"' in text
    assert 'columns = ["q_hip_deg"]' in text


def test_one_thing_is_asked_for(tmp_path: Path) -> None:
    for words in ((), (str(MODELS["puma"]), "--recording", "none.csv"), ("missing.urdf",)):
        done = command_line("new", *words, cwd=tmp_path)
        assert done.returncode == 2
        assert len(done.stderr.splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_the_doctor_finds_this_installation_well(tmp_path: Path) -> None:
    done = command_line("doctor", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    checks = {each["name"]: each for each in json.loads(done.stdout)["checks"]}
    assert {"testbed", "Python", "mujoco", "pin", "viewer", "compiled kernel"} <= set(checks)
    assert all(each["fine"] for each in checks.values() if each["needed"])
    told = command_line("doctor", cwd=tmp_path)
    assert told.stdout.count("\n") == len(checks)
    marks = {line.split()[0] for line in told.stdout.splitlines()}
    assert {"ok"} <= marks <= {"ok", "-"}  # "-": of what only some users need


def test_what_is_missing_or_old_is_said_with_its_cure(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = ["numpy>=99", "not-there-at-all", "h5py>=99; extra == 'import'"]
    monkeypatch.setattr(checkup, "requires", lambda name: asked)
    found = {each.name: each for each in checkup.checkup()}
    assert "needed is >=99" in found["numpy"].line
    assert "pip install 'not-there-at-all'" in found["not-there-at-all"].line
    assert not found["not-there-at-all"].fine
    assert "MISSING" in found["numpy"].line
    assert "'.[import]'" in found["extra [import]"].line
    assert "MISSING" not in found["extra [import]"].line
    assert Requirement(asked[0]).name == "numpy"


def test_the_doctor_says_how_to_get_a_viewer(monkeypatch: pytest.MonkeyPatch) -> None:
    for program, screen, good, says in (
        (None, True, False, "no command 'rerun'"),
        ("there/rerun", False, True, "no screen here"),
        ("there/rerun", True, True, "there/rerun"),
    ):
        monkeypatch.setattr(show, "viewer_program", lambda found=program: found)
        monkeypatch.setattr(show, "has_screen", lambda found=screen: found)
        (viewer,) = (each for each in checkup.checkup() if each.name == "viewer")
        assert viewer.fine is good
        assert says in viewer.found
        assert ("pip install" in viewer.cure) is not good
