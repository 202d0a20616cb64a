"""`testbed validate`: after a run and after `identify --json`, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import testbed as tb
from testbed.experiment.read_result import read_result
from testbed.identification.validation import validate
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


@pytest.mark.parametrize("columns", [60, 80, 140])
def test_no_number_is_cut_at_any_width(
    columns: int, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    done = command_line("validate", "other.parquet", "result.json", cwd=place)
    assert done.returncode == 0
    assert max(map(len, done.stdout.splitlines())) <= columns
    assert "…" not in done.stdout
    whole = json.loads(
        command_line("validate", "other.parquet", "result.json", "--json", cwd=place).stdout
    )
    for each in whole.values():
        for key in ("residual", "mean", "noise", "spread", "ratio"):
            assert all(f"{number:.3g}" in done.stdout for number in each[key])


def test_what_does_not_fit_is_one_line_and_exit_code_two(place: Path) -> None:
    without(measured(robot("ur5"), 3), "wrench").save(place / "torques.parquet")
    both = json.loads((place / "result.json").read_text())
    both.pop("internal")
    (place / "external.json").write_text(json.dumps(both))
    cases = {
        ("other.parquet", "nowhere.json"): "there is no result",
        ("other.parquet", "."): "",
        ("other.parquet", "one.parquet"): "not JSON",
        ("nowhere.parquet", "result.json"): "there is no recording",
        ("torques.parquet", "external.json"): "no wrench",
        ("other.parquet", "result.json", "--model", str(MODELS["puma"])): "SHA-256",
        ("other.parquet", "result.json", "--set", "identification.zeros=true"): "not of this robot",
        ("other.parquet", "result.json", "--set", "identification.cutof=1"): "unknown key",
    }
    for words, said in cases.items():
        done = command_line("validate", *words, cwd=place)
        if not said:  # the folder has a result
            assert done.returncode == 0
            continue
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
    assert "On a motion that no estimate has seen" in done.stdout
    found = json.loads((place / "run/result.json").read_text())["validation"]
    assert sorted(found) == ["external", "internal"]
    assert max(found["external"]["ratio"]) < 2
    words = ("validate", "run/recording.parquet", "run", "--json")
    again = json.loads(command_line(*words, cwd=place).stdout)
    assert all(ratio < 1.1 for ratio in again["external"]["ratio"])  # its own recording
