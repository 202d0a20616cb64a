"""A real UR5e on a real force plate, from its log to its weight; what is wrong with it is seen.

Witnesses: the authors' numbers of their rig (examples/ur5e_plate/README.md), and the mean of Fz.
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
from testbed.core.base.arrays import Array
from testbed.core.base.errors import RecordingError
from testbed.core.recordings.recording import Recording
from testbed.importing.check.check import assess
from testbed.importing.check.mapping_solution import solve_mapping
from testbed.importing.check.time_offset import moving_average
from testbed.importing.convert import pieces
from testbed.importing.guess import guessed
from testbed.importing.import_report import Draft
from tests.helpers.paths import ROOT
from tests.helpers.refusals import refuses

UR5E = ROOT / "examples/ur5e_plate"
FILE = tb.ModelFile(UR5E / "ur5e_arm.urdf")
PLACE, LATE, REST = (-1.79e-3, -5.17e-3, -68.76e-3), 0.049, {1: -1.5706, 4: 0.0}
"""The plate's origin [m], half of the recorder's moving average [s], joints that stay."""


@cache
def draft() -> Draft:
    found = guessed([UR5E / "ur5e_plate.csv.gz"], UR5E, FILE.tree().names)
    return solve_mapping(found, UR5E / "mapping.toml", FILE.tree()).draft


@cache
def recording() -> Recording:
    return pieces(UR5E / "ur5e.toml")[0][0]


def log() -> Array:
    with gzip.open(UR5E / "ur5e_plate.csv.gz", "rt") as file:
        return np.loadtxt(file, delimiter=",", skiprows=1)


def test_the_log_alone_gives_frame_sense_clock_and_pedestal() -> None:
    """Horizontal forces are noise: they refute no robot. Nobody writes a line of the mapping."""
    table = draft().tables["wrench"]
    assert (table["sense"], table["pedestal"]) == ("on_plate", "removed")
    apart = Rotation.from_euler("xyz", table["place"]["rpy"]).as_matrix() @ np.diag([1, -1, -1])
    assert np.rad2deg(Rotation.from_matrix(apart).magnitude()) < 1.0
    said = re.search(r"xyz .* \+- (.*) mm", draft().notes["wrench", "place"])
    assert said is not None
    sigma = [1e-3 * float(word) for word in said[1].split(", ")]
    assert (np.abs(np.subtract(table["place"]["xyz"], PLACE)) < np.multiply(3, sigma)).all()
    assert abs(table["delay"] - LATE) < 0.01
    window = re.search(r"averages over about (\d+) ms", draft().notes["wrench", "delay"])
    assert window is not None
    assert abs(float(window[1]) / 2e3 - LATE) < 0.01


def test_a_recorders_moving_average_is_seen_in_a_spectrum_and_nothing_else_is() -> None:
    """Witness: an average of 86 samples of coloured noise, and the noise."""
    rng = np.random.default_rng(1)
    noise = np.cumsum(rng.normal(size=(20_000, 6)), axis=0) + 5 * rng.normal(size=(20_000, 6))
    made = np.apply_along_axis(np.convolve, 0, noise, np.ones(86) / 86, "same")
    assert abs(moving_average(made, 1000.0) - 0.086) < 0.004
    assert moving_average(noise, 1000.0) == 0.0


def test_its_weight_is_what_the_plate_carries_and_joints_at_rest_are_held() -> None:
    file, source, said = tb.hold_still(FILE, recording())
    names = FILE.tree().names
    assert {names.index(name) for name in file.lock} == REST.keys()
    assert [each.code for each in said] == ["position.held"]
    places = [float(file.lock[names[k]] or 0.0) for k in REST]
    np.testing.assert_allclose(places, list(REST.values()), atol=1e-3)
    found = tb.identify(file.tree(), source, "external")
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
    text = (
        (UR5E / "ur5e.toml")
        .read_text()
        .replace("ur5e_plate.csv.gz", str(UR5E / "ur5e_plate.csv.gz"))
    )
    said = "" if pedestal is None else f"pedestal = {pedestal!r}\n"
    text = re.sub("tare = .*\n", "", re.sub("pedestal = .*\n", said, text))
    (tmp_path / "m.toml").write_text(text)
    made = pieces(tmp_path / "m.toml")[0][0]
    taken = tb.pedestal_wrench(FILE.tree()) if made.tare is None else made.tare
    np.testing.assert_allclose(taken, [0, 0, 0 if pedestal == "removed" else 4 * 9.81, 0, 0, 0])
    asked = [each.code for each in assess(FILE.tree(), made).diagnostics]
    assert ("plate.pedestal" in asked) == (pedestal is None)


@pytest.mark.slow
def test_what_is_wrong_with_a_noisy_recording_is_still_seen() -> None:
    """Another sense of the plate, another one of joint 1: noise excuses neither."""
    tree, right = FILE.tree(), recording()
    assert assess(tree, right).certain == ()
    assert right.wrench is not None
    assert [each.kind for each in assess(tree, replace(right, wrench=-right.wrench)).remedies] == [
        "sense"
    ]
    signs = np.where(np.arange(6) == 0, -1.0, 1.0)
    assert assess(tree, replace(right, position=signs * right.position)).certain
