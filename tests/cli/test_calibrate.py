"""`testbed calibrate` and `drives`, and `--plate` of the commands that take what it wrote."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array
from tests.helpers.command import command_line
from tests.helpers.measured import measured
from tests.helpers.plates import mass_of, mixing, on_plate
from tests.helpers.runs import MODELS, robot, without

pytestmark = pytest.mark.slow

PUMA = str(MODELS["puma"])
MATRIX = mixing(7)


def words(*known: str) -> tuple[str, ...]:
    said = (word for each in known for word in ("--known", each))
    return ("calibrate", "one.parquet", "--model", PUMA, "--zeros", *said)


FACTS = (f"mass={mass_of(robot('puma'))}", f"gain/Fz={MATRIX[2, 2]}")


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two recordings of one plate, a third of a perfect one, a calibration."""
    folder = tmp_path_factory.mktemp("calibrate")
    for seed, name in ((1, "one"), (2, "other")):
        right = measured(robot("puma"), seed, noise=0.01)
        on_plate(right, MATRIX).save(folder / f"{name}.parquet")
    right.save(folder / "right.parquet")
    done = command_line(*words(*FACTS), "--json", cwd=folder)
    assert (done.returncode, done.stderr) == (0, "")
    (folder / "said.json").write_text(done.stdout)
    return folder


def identified(place: Path, recording: str, *more: str) -> Array:
    call = ("identify", recording, "--model", PUMA, "--zeros", "--method", "external", "--json")
    done = command_line(*call, *more, cwd=place)
    assert done.returncode == 0, done.stderr
    return np.array(json.loads(done.stdout)["external"]["values"])


def test_what_is_printed_is_what_is_kept(place: Path) -> None:
    said = json.loads((place / "said.json").read_text())
    np.testing.assert_allclose(said["matrix"], MATRIX, atol=1e-3)
    assert said["known"]["mass"][1] == 0
    text = (place / "plate.toml").read_text()
    for name, number in said["numbers"].items():
        assert f'"{name}" = {{ value = {number["value"]!r}' in text
    shown = command_line(*words(*FACTS), "--out", "again.toml", cwd=place)
    assert (shown.returncode, shown.stderr) == (0, "")
    assert (place / "again.toml").read_text() == text
    assert f"{MATRIX[5, 0]:.3f}" in shown.stdout
    assert "plate: again.toml" in shown.stdout


def test_a_calibrated_plate_serves_for_another_recording(place: Path) -> None:
    tree = robot("puma")
    truth = tb.minimal_set(tree, "reaction", zeros=True).values(tb.barycentric(tree))
    faulty = np.abs(identified(place, "other.parquet") - truth).max()
    cured = np.abs(identified(place, "other.parquet", "--plate", "plate.toml") - truth)[:-1].max()
    assert cured < faulty / 10


def test_doubt_about_the_plate_is_in_the_sigmas(place: Path) -> None:
    """Of the file that calibrate wrote, and of one without correlations; not of an exact one."""
    text = (place / "plate.toml").read_text()
    independent = text[: text.index("correlation =")] + text[text.index("robot =") :]
    (place / "independent.toml").write_text(independent)
    (place / "exact.toml").write_text(re.sub(r"sigma = [^,} ]*", "sigma = 0.0", independent))
    sigmas = [
        json.loads(command_line(*call, cwd=place).stdout)["external"]["sigma"]
        for call in (
            ("identify", "other.parquet", "--model", PUMA, "--zeros", "--json", "--plate", file)
            for file in ("exact.toml", "plate.toml", "independent.toml")
        )
    ]
    exact, whole, independent_ones = (
        np.array([each for each in sigma if each is not None]) for sigma in sigmas
    )
    assert len(exact) == len(whole) == len(sigmas[0]) - 1  # the mass: the zero is of one recording
    assert (whole > exact).all()
    assert not np.allclose(whole, independent_ones, rtol=1e-3)


def test_validate_report_and_view_take_the_plate(place: Path) -> None:
    result = ("identify", "right.parquet", "--model", PUMA, "--zeros", "--json")
    (place / "result.json").write_text(command_line(*result, cwd=place).stdout)
    scatter = []
    for more in ((), ("--plate", "plate.toml")):
        call = ("validate", "other.parquet", "result.json", "--json", *more)
        done = command_line(*call, cwd=place)
        assert (done.returncode, done.stderr) == (0, "")
        found = json.loads(done.stdout)["external"]
        scatter.append(np.sqrt(np.square(found["residual"]) - np.square(found["mean"])).max())
    assert scatter[0] > 10 * scatter[1]
    recording = ("other.parquet", "--model", PUMA, "--zeros", "--plate", "plate.toml")
    done = command_line("report", *recording, "--out", "page.html", cwd=place)
    assert done.returncode == 0, done.stderr
    done = command_line("view", *recording, "--save", "page.rrd", cwd=place)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("known", "said"),
    [
        (("mass=20",), "no motion tells gain/Mz"),
        (("weight=20", "gain/Fz=1"), "unknown known fact 'weight'"),
        (("mass", "gain/Fz=1"), "write it as mass=20"),
        (("mass=20", "mbar1=20", "gain/Fz=1"), "'mbar1' is known twice"),
    ],
)
def test_what_does_not_suffice_is_one_line(place: Path, known: tuple[str, ...], said: str) -> None:
    done = command_line(*words(*known), "--out", "none.toml", cwd=place)
    assert (done.returncode, done.stdout) == (2, "")
    assert said in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (place / "none.toml").exists()


ALONE = '[numbers]\n"gain/Fx" = {value = 1.0, sigma = 0.1}'


@pytest.mark.parametrize(
    "text",
    [
        None,
        "numbers = 1",
        "x",
        "[numbers]\nq = {value = 1.0}",
        f"correlation = [[0.5]]\n{ALONE}",
        f"correlation = [[1.0], [0.5, 1.0]]\n{ALONE}",
    ],
)
def test_a_file_that_is_no_plate_is_one_line(place: Path, text: str | None) -> None:
    path = place / "broken.toml"
    path.unlink(missing_ok=True)
    if text is not None:
        path.write_text(text)
    call = ("identify", "one.parquet", "--model", PUMA, "--plate", "broken.toml")
    done = command_line(*call, cwd=place)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize("width", [60, 120])
def test_drives_are_held_against_the_plate(
    place: Path, width: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(width))
    call = ("drives", "right.parquet", "--model", PUMA, "--zeros")
    done = command_line(*call, "--json", cwd=place)
    assert (done.returncode, done.stderr) == (0, "")
    whole = json.loads(done.stdout)
    assert set(whole) == {"joints", "curves", "combined"}
    assert set(whole["curves"]) == {"waist", "shoulder", "elbow"}
    said = whole["joints"]
    for name, friction in (("waist", 6.3), ("shoulder", 5.5), ("elbow", 2.6)):
        constant, coulomb = said[name]["torque_constant"], said[name]["terms"]["coulomb"]
        assert abs(constant["value"] - 1) < 5 * constant["sigma"]
        assert abs(coulomb["value"] - friction) < 5 * coulomb["sigma"]
    shown = command_line(*call, cwd=place)
    assert (shown.returncode, shown.stderr) == (0, "")
    assert max(map(len, shown.stdout.splitlines())) <= width
    for text in ("shoulder", "torque constant", "coulomb", "viscous", "residual"):
        assert text in shown.stdout


def test_drives_need_torques_and_a_plate(place: Path) -> None:
    recording = tb.Recording.load(place / "right.parquet")
    for lacking in ("torque", "wrench"):
        without(recording, lacking).save(place / "half.parquet")
        done = command_line("drives", "half.parquet", "--model", PUMA, cwd=place)
        assert (done.returncode, done.stdout) == (2, "")
        assert f"has no {lacking}" in done.stderr


def test_terms_are_chosen_on_request(place: Path) -> None:
    call = ("drives", "right.parquet", "--model", PUMA, "--zeros", "--choose-terms")
    shown = command_line(*call, cwd=place)
    assert (shown.returncode, shown.stderr) == (0, "")
    assert "waist: coulomb and viscous" in shown.stdout
    said = json.loads(command_line(*call, "--json", cwd=place).stdout)["joints"]["waist"]
    assert said["choice"][0] == {
        "added": "", "held_out_residual": said["choice"][0]["held_out_residual"],
        "standard_errors": 0.0, "taken": True,
    }  # fmt: skip


@pytest.mark.parametrize("width", [60, 120])
def test_a_payload_is_weighed(place: Path, width: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same recording twice: nothing was added, in motion; at rest it never was."""
    monkeypatch.setenv("COLUMNS", str(width))
    call = ("payload", "right.parquet", "right.parquet", "--model", PUMA)
    said = json.loads(command_line(*call, "--json", cwd=place).stdout)
    assert said["joint"] == "elbow"
    assert said["parameters"]["m"]["value"] == 0.0
    assert said["centre"] is None
    shown = command_line(*call, cwd=place)
    assert (shown.returncode, shown.stderr) == (0, "")
    assert max(map(len, shown.stdout.splitlines())) <= width
    resting = command_line(*call, "--at-rest", cwd=place)
    assert (resting.returncode, resting.stdout) == (2, "")
    assert "0 poses at rest" in resting.stderr
    assert resting.stderr.count("\n") == 1
    wrong = command_line(*call, "--joint", "wrist", cwd=place)
    assert wrong.returncode == 2
    assert "'wrist'" in wrong.stderr


@pytest.mark.parametrize("command", ["faults", "effects"])
def test_what_can_be_asked_for_is_listed(command: str, tmp_path: Path) -> None:
    listed = command_line(command, cwd=tmp_path)
    kinds = [line.split()[0] for line in listed.stdout.splitlines() if line]
    assert len(kinds) > 8
    one = command_line(command, kinds[0], cwd=tmp_path)
    assert one.returncode == 0
    assert f'kind = "{kinds[0]}"' in one.stdout
    unknown = command_line(command, "wobble", cwd=tmp_path)
    assert (unknown.returncode, unknown.stderr.count("\n")) == (2, 1)
