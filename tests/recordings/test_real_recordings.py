"""Real robots, from their logs to what they weigh; what is wrong with a log is seen.

A UR5e on a force plate: witnesses are the authors' numbers (examples/ur5e_plate/README.md) and the
mean of Fz. A Kinova Gen3: its other motion, and its gravity.
"""

from __future__ import annotations

import gzip
import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import testbed as tb
from benchmarks.real import RIVALS, ROBOTS, errors, splits
from testbed.bodies.posterior import Posterior, compute_posterior, corrected_row_parts
from testbed.bodies.prediction_errors import errors_on_recording
from testbed.bodies.prior import prior_of
from testbed.core.base.arrays import Array
from testbed.core.base.errors import RecordingError
from testbed.core.estimation.problem import Problem
from testbed.core.recordings.recording import Recording
from testbed.importing.check.assessment import assess_recording
from testbed.importing.check.mapping_solution import solve_mapping
from testbed.importing.convert import import_recordings
from testbed.importing.guess import guess_mapping
from testbed.importing.import_report import MappingDraft
from tests.helpers.paths import ROOT
from tests.helpers.refusals import refuses

UR5E = ROOT / "examples/ur5e_plate"
FILE = tb.ModelFile(UR5E / "ur5e_arm.urdf")
PLACE, LATE, REST = (-1.79e-3, -5.17e-3, -68.76e-3), 0.049, {1: -1.5706, 4: 0.0}
"""The plate's origin [m], half of the recorder's moving average [s], joints that stay."""


@cache
def draft() -> MappingDraft:
    found = guess_mapping([UR5E / "ur5e_plate.csv.gz"], UR5E, FILE.tree().names)
    return solve_mapping(found, UR5E / "mapping.toml", FILE.tree()).draft


@cache
def recording() -> Recording:
    return import_recordings(UR5E / "ur5e.toml")[0][0]


def log() -> Array:
    with gzip.open(UR5E / "ur5e_plate.csv.gz", "rt") as file:
        return np.loadtxt(file, delimiter=",", skiprows=1)


def test_the_log_alone_gives_frame_sense_clock_and_pedestal() -> None:
    """Horizontal forces are noise: they refute no robot. Nobody writes a line of the mapping."""
    table = draft().tables["wrench"]
    assert (table["sense"], table["pedestal"]) == ("on_plate", "removed")
    apart = Rotation.from_euler("xyz", table["place"]["rpy"]).as_matrix() @ np.diag([1, -1, -1])
    assert np.rad2deg(Rotation.from_matrix(apart).magnitude()) < 1.0
    said = re.search(r"xyz .* \+- (.*) mm", draft().key_comments["wrench", "place"])
    assert said is not None
    sigma = [1e-3 * float(word) for word in said[1].split(", ")]
    assert (np.abs(np.subtract(table["place"]["xyz"], PLACE)) < np.multiply(3, sigma)).all()
    assert abs(table["delay"] - LATE) < 0.01


def test_its_weight_is_what_the_plate_carries_and_joints_at_rest_are_held() -> None:
    file, source, said = tb.hold_still(FILE, recording())
    names = FILE.tree().names
    assert {names.index(name) for name in file.lock} == REST.keys()
    assert [each.code for each in said] == ["position.held"]
    places = [float(file.lock[names[k]] or 0.0) for k in REST]
    np.testing.assert_allclose(places, list(REST.values()), atol=1e-3)
    found = tb.identify(file.tree(), source, "wrench")
    k = found.names.index("mbar1")
    assert abs(found.values[k] - log()[:, 9].mean() / 9.81) < 3 * found.sigma[k] < 0.5
    assert not {"encoder.still", "plate.tare"} & {each.code for each in found.diagnostics}
    asked = replace(FILE, lock=dict.fromkeys(file.lock))
    same = tb.hold_still(asked, recording(), lock_only=True)
    assert (dict(same[0].lock), same[1].names, same[2]) == (dict(file.lock), source.names, ())


def test_a_joint_that_moves_is_not_held_nor_one_that_rests_elsewhere() -> None:
    for lock in ({"elbow_joint": None}, {"shoulder_lift_joint": -1.4}):
        with refuses(RecordingError, *lock):
            tb.hold_still(replace(FILE, lock=lock), recording(), lock_only=True)


@pytest.mark.parametrize("pedestal", ["removed", "included", None, 4.0])
def test_what_a_reading_contains_of_the_pedestal_is_said_once(
    pedestal: str | float | None, tmp_path: Path
) -> None:
    """The file's pedestal has 4 kg: as said or as a number, it is the same weight."""
    text, data = (UR5E / "ur5e.toml").read_text(), "ur5e_plate.csv.gz"
    text = text.replace(data, str(UR5E / data))
    said = "" if pedestal is None else f"pedestal = {pedestal!r}\n"
    text = re.sub("tare = .*\n", "", re.sub("pedestal = .*\n", said, text))
    (tmp_path / "m.toml").write_text(text)
    made = import_recordings(tmp_path / "m.toml")[0][0]
    taken = tb.pedestal_wrench(FILE.tree()) if made.tare is None else made.tare
    np.testing.assert_allclose(taken, [0, 0, 0 if pedestal == "removed" else 4 * 9.81, 0, 0, 0])
    asked = [each.code for each in assess_recording(FILE.tree(), made).diagnostics]
    assert ("plate.pedestal" in asked) == (pedestal is None)


@pytest.mark.slow
def test_what_is_wrong_with_a_noisy_recording_is_still_seen() -> None:
    """Another sense of the plate, another one of joint 1: noise excuses neither."""
    tree, right = FILE.tree(), recording()
    assert assess_recording(tree, right).errors == ()
    upside = assess_recording(tree, replace(right, wrench=-right.measured("wrench")))
    assert [each.kind for each in upside.remedies] == ["sense"]
    signs = np.where(np.arange(6) == 0, -1.0, 1.0)
    assert assess_recording(tree, replace(right, position=signs * right.position)).errors


GEN3 = ROOT / "examples/kinova_gen3"
TREE = tb.load_tree(GEN3 / "gen3.urdf")
SENSORS: dict[str, object] = {"unit": "N m"}
CURRENTS: dict[str, object] = {
    "columns": [f"Cur{k}" for k in range(1, 8)], "unit": "A", "gain": [9.13] * 4 + [5.852] * 3
}  # fmt: skip
"""All that a person writes of the torques; 9.13 and 5.852 N m/A are the authors'."""


def recordings(folder: Path, torque: dict[str, object]) -> list[Recording]:
    """Both motions, as `import --guess` takes them."""
    found = []
    for motion in (1, 2):
        draft = guess_mapping([GEN3 / f"motion_{motion}.csv.gz"], folder, TREE.names)
        for key, value in torque.items():
            draft = draft.with_key("torque", key, value)
        path = folder / f"{motion}.toml"
        path.write_text(draft.with_key("position", "unit", "rad").text)
        found.append(import_recordings(path)[0][0])
    return found


def added(recording: Recording) -> Posterior:
    rows = corrected_row_parts(Problem.from_recording(TREE, recording, "torque"), None)
    return compute_posterior(rows, prior_of(TREE))


def left(found: Posterior, unseen: Recording) -> dict[str, Array]:
    """Rms errors of the prediction of another motion, by what predicts."""
    laws = dict.fromkeys(name.split("/")[0] for name in found.names[found.count :])
    settings = tb.Settings(terms=[*laws])
    problem = Problem.from_recording(TREE, unseen, "torque", settings)
    return dict(errors_on_recording(problem, problem.source, found.models).residual)


@pytest.mark.parametrize(
    ("torque", "better"), [(SENSORS, 0.35), (CURRENTS, 0.85)], ids=["sensors", "currents"]
)
def test_each_motion_foretells_the_other_better_than_the_file(
    tmp_path: Path, torque: dict[str, object], better: float
) -> None:
    """Over all joints, also than the file with its friction fitted."""
    first, second = recordings(tmp_path, torque)
    assert first.temperature is not None
    assert 29 < first.temperature.min() < first.temperature.max() < 40
    for seen, unseen in ((first, second), (second, first)):
        total = {k: np.linalg.norm(e) for k, e in left(added(seen), unseen).items()}
        assert total["posterior"] < better * min(total["file"], total["refitted"])


def test_sensors_and_currents_agree_that_the_file_is_wrong(tmp_path: Path) -> None:
    """Two instruments of one arm: first moments that are nearer to each other than to the file."""
    sensors, currents = (added(recordings(tmp_path, each)[0]) for each in (SENSORS, CURRENTS))
    for name in ("mb*2y", "mb*4y", "mb*6y"):
        at, beside = sensors.names.index(name), currents.names.index(name)
        one, other, file = sensors.values[at], currents.values[beside], sensors.file[at]
        assert sensors.share[at] > 0.9 < currents.share[beside]
        assert abs(one - other) < min(abs(one - file), abs(other - file))


@pytest.mark.slow
def test_the_default_predicts_an_unseen_part_better_than_all_rivals() -> None:
    """A KUKA LBR Med 7, 10.5 s, its second half seen."""
    squares = errors(*dict(splits(*ROBOTS["med7"]))["second half"])[1]
    assert squares[-1] < 0.8**2 * np.nanmin(squares[: len(RIVALS)])
