"""`testbed validate`: after a run and after `identify --json`, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.experiment.read_result import read_result
from testbed.identification.validate import validate
from tests.helpers.command import command_line
from tests.helpers.measured import measured
from tests.helpers.runs import MODELS, robot, without

pytestmark = pytest.mark.slow

UR5 = str(MODELS["ur5"])


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording, another one, and what `identify --json` says of the first."""
    folder = tmp_path_factory.mktemp("validate")
    for seed, name in ((1, "one"), (2, "other")):
        measured(robot("ur5"), seed).save(folder / f"{name}.parquet")
    words = ("identify", "one.parquet", "--model", UR5, "--json")
    (folder / "result.json").write_text(command_line(*words, cwd=folder).stdout)
    return folder


def test_what_identify_printed_is_validated(place: Path) -> None:
    shown = command_line("validate", "other.parquet", "result.json", cwd=place)
    assert (shown.returncode, shown.stderr) == (0, "")
    assert "j6" in shown.stdout
    done = command_line("validate", "other.parquet", "result.json", "--json", cwd=place)
    assert (done.returncode, done.stderr) == (0, "")
    found = json.loads(done.stdout)
    assert sorted(found) == ["external", "internal"]
    assert all(0.5 < ratio < 1.7 for method in found for ratio in found[method]["ratio"])
    kept = read_result(place / "result.json")
    other = tb.Recording.load(place / "other.parquet")
    for said in kept.estimates:
        here = validate(kept.tree, other, said, settings=kept.settings)
        assert found[said.method]["residual"] == here.residual.tolist()


def test_threads_change_nothing_and_a_wrong_gravity_is_told(place: Path) -> None:
    words = ("validate", "other.parquet", "result.json", "--json")
    plain = command_line(*words, cwd=place)
    assert command_line(*words, "--threads", "1", cwd=place).stdout == plain.stdout
    moon = command_line(*words, "--gravity", "0,0,-1.62", cwd=place)
    assert (moon.returncode, moon.stderr) == (0, "")
    assert max(json.loads(moon.stdout)["external"]["ratio"]) > 10


def test_what_does_not_fit_is_one_line_and_exit_code_two(place: Path) -> None:
    without(measured(robot("ur5"), 3), "wrench").save(place / "torques.parquet")
    both = json.loads((place / "result.json").read_text())
    both.pop("internal")
    (place / "external.json").write_text(json.dumps(both))
    cases = {
        ("other.parquet", "one.parquet"): "not JSON",
        ("torques.parquet", "external.json"): "no wrench",
        ("other.parquet", "result.json", "--model", str(MODELS["puma"])): "SHA-256",
        ("other.parquet", "result.json", "--set", "identification.terms=[]"): "not of this robot",
        ("other.parquet", "result.json", "--gravity", "nan,0,0"): "three finite numbers",
    }
    for words, said in cases.items():
        done = command_line("validate", *words, cwd=place)
        assert (done.returncode, done.stdout) == (2, ""), words
        assert done.stderr.count("\n") == 1
        assert said in done.stderr


def test_a_run_is_validated_and_its_folder_can_be(place: Path) -> None:
    (place / "e.toml").write_text(
        f'name = "e"\nmodel = "{UR5}"\n[motion]\nduration = 8.0\ncandidates = 1\n'
        "[measurement]\nrate = 250.0\nforce_noise = 0.5\nmoment_noise = 0.1\ntorque_noise = 0.5\n"
        "[simulation]\nstep = 1e-3\n"
    )
    done = command_line("run", "e.toml", "--out", "run", cwd=place)
    assert done.returncode == 0, done.stderr
    assert "Rms residuals on that motion" in done.stdout
    found = json.loads((place / "run/result.json").read_text())["validation"]
    assert sorted(found) == ["external", "internal"]
    assert max(found["external"]["ratio"]) < 2
    words = ("validate", "run/recording.parquet", "run", "--json")
    own = json.loads(command_line(*words, cwd=place).stdout)["external"]
    for residual, mean, noise in zip(own["residual"], own["mean"], own["noise"], strict=True):
        assert np.sqrt(residual**2 - mean**2) == pytest.approx(noise, rel=0.1)
