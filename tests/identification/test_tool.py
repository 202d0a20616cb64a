"""What a force sensor carries, by motion and at rest, and payloads in the words of controllers.

If one fails, payloads that people type into their robots are wrong. The witness of poses is a UR5
by rotations of SciPy alone; what is written is read back as the vendors read it.
"""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from scipy.spatial.transform import Rotation

import testbed as tb
from testbed.applications.payload.payload import UNITS, PayloadEstimate
from testbed.applications.payload.static_fit import StaticPoses
from testbed.applications.payload.tool import tool_from_motion, tool_from_static_poses
from testbed.applications.payload.vendors import VENDOR_WRITERS, flange_payload
from testbed.core.base.arrays import Array
from testbed.core.base.errors import RecordingError, SettingsError, UnknownName
from testbed.core.base.transform import Transform
from testbed.core.parameters.symbols import STANDARD_NAMES
from testbed.core.robot.force_sensor import ForceSensor, tree_beyond_sensor
from testbed.core.robot.inertia import ZERO_INERTIA, Inertia
from testbed.core.robot.repair import ModelLink
from testbed.core.robot.tree import SensorPlacement
from testbed.importing.static_poses import read_static_poses
from tests.helpers.command import command_line
from tests.helpers.paths import ROOT
from tests.helpers.refusals import refuses
from tests.helpers.runs import robot
from tests.helpers.sensors import links_of, random_sensors
from tests.helpers.strategies import Rng, few, rngs

UR5 = ROOT / "tests/golden/robots/ur5.urdf"
MASS, CENTRE = 1.4, np.array([0.012, -0.008, 0.095])
ZERO = np.array([1.0, -2.0, 0.5, 0.01, 0.02, -0.03])
NOISE = np.repeat([0.05, 0.002], 3)
DOWN = np.array([0.0, 0.0, -9.81])
KGF, LBF, DEG = 9.80665, 4.4482216, float(np.rad2deg(1.0))


def orientation(q: Array) -> Rotation:
    """Of the last link, by the UR5's Denavit-Hartenberg table."""
    turns = [Rotation.from_rotvec(np.outer(each, [0, 0, 1])) for each in q.T]
    tilts = [Rotation.from_rotvec([each, 0, 0], degrees=True) for each in (90, 0, 0, 90, -90)]
    whole = turns[0]
    for tilt, turn in zip(tilts, turns[1:], strict=True):
        whole = whole * tilt * turn
    return whole


def poses(
    count: int, seed: int, gravity: Array = DOWN, zero: Array = ZERO
) -> tuple[Array, Array, Array]:
    """Joint positions, what the sensor shows, and its orientation."""
    rng = np.random.default_rng([71, seed])
    q = rng.uniform(-2.5, 2.5, (count, 6))
    turn = orientation(q)
    force = -MASS * turn.inv().apply(gravity)
    shown = np.hstack([force, np.cross(CENTRE, force)]) + zero
    return q, shown + NOISE * rng.normal(size=shown.shape), turn.as_matrix()


def sensed_ur5() -> tb.Tree:
    return tb.load_tree(UR5, sensor=ForceSensor("b6"))


def seen_from(turn: Array, wrench: Array) -> Array:
    """A wrench along other axes."""
    found: Array = np.einsum("pij,pkj->pki", turn, wrench.reshape(-1, 2, 3)).reshape(-1, 6)
    return found


@few(10)
@given(rngs)
def test_static_poses_give_mass_centre_zero_and_gravity(rng: Rng) -> None:
    """A robot hung anyhow, a sensor turned anyhow: within five standard deviations."""
    gravity, sensor = Rotation.random(rng=rng).apply(DOWN), Rotation.random(rng=rng)
    q, wrench, _ = poses(17, int(rng.integers(999)), gravity, 0 * ZERO)
    seen = sensor.inv().apply(wrench.reshape(-1, 3)).reshape(-1, 6) + ZERO
    tree = tb.load_tree(UR5, sensor=ForceSensor("b6", rotation=sensor.as_matrix()))
    found = tool_from_static_poses(tree, StaticPoses(q, seen))
    numbers = [found.mass, *found.centre, *found.force_zero, *found.moment_zero]
    truth = [MASS, *sensor.inv().apply(CENTRE), *ZERO]
    z = [(value - true) / sigma for (value, sigma), true in zip(numbers, truth, strict=True)]
    assert np.abs(z).max() < 5
    assert found.unidentifiable == ()
    assert np.cross(found.gravity, gravity / 9.81) == pytest.approx(0, abs=2e-2)
    assert found.tilt[0] == pytest.approx(np.arccos(np.clip(-gravity[2] / 9.81, -1, 1)), abs=2e-2)


def test_its_standard_deviations_hold_with_few_poses() -> None:
    """Six poses leave 24 numbers over: a normal law's 95 % are 95 % still."""
    inside = []
    for seed in range(60):
        found = tool_from_static_poses(sensed_ur5(), StaticPoses(*poses(6, 100 + seed)[:2]))
        numbers = zip((found.mass, *found.centre), (MASS, *CENTRE), strict=True)
        inside += [abs(value - truth) < 1.96 * sigma for (value, sigma), truth in numbers]
    assert 0.9 < np.mean(inside) < 0.985


def test_what_tells_no_tool_is_said_or_refused() -> None:
    """Poses that are all alike, a robot without a sensor, no gravity."""
    q, wrench, _ = poses(9, 7)
    alike = StaticPoses(0 * q + q[0], 0 * wrench + wrench[0] + NOISE * wrench / 10)
    assert "mass and gravity" in tool_from_static_poses(sensed_ur5(), alike).unidentifiable
    for tree in (tb.load_tree(UR5), sensed_ur5().with_gravity([0, 0, 0])):
        with pytest.raises(SettingsError):
            tool_from_static_poses(tree, StaticPoses(q, wrench))


Fault = Callable[[Array, Array, Array], tuple[Array, Array]]


def scaled(*factors: float) -> Fault:
    return lambda q, wrench, turn: (q, wrench * np.repeat(factors, 3))


FAULTS: dict[str, tuple[Fault, str, str]] = {
    "nothing": (scaled(1, 1), "", ""),
    "moments in N mm": (scaled(1, 1000), "tool.reach", "moments-in-mm"),
    "moments in N cm": (scaled(1, 100), "tool.reach", "moments-in-cm"),
    "forces in kgf": (scaled(1 / KGF, 1), "tool.reach", "forces-in-kgf"),
    "forces in lbf": (scaled(1 / LBF, 1), "tool.reach", "forces-in-lbf"),
    "lbf and lbf in": (scaled(1 / LBF, 1 / 0.11298), "tool.reach", "wrench-in-lbf-in"),
    "opposite moments": (scaled(1, -1), "tool.behind", "moments-opposite"),
    "opposite forces": (scaled(-1, 1), "tool.upwards", "forces-opposite"),
    "all opposite": (scaled(-1, -1), "tool.upwards", "opposite-signs"),
    "base": (lambda q, w, r: (q, seen_from(r, w)), "tool.base-axes", "base-axes"),
    "UR's base": (
        lambda q, w, r: (q, seen_from(np.diag([-1, -1, 1]) @ r, w)), "tool.turned-base", "base-axes"
    ),
    "degrees": (lambda q, w, r: (np.rad2deg(q), w), "tool.degrees", ""),
    "an encoder's sign": (
        lambda q, w, r: (q * [1, 1, 1, 1, -1, 1], w), "tool.residual", "other-unit"
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", FAULTS)
@pytest.mark.parametrize("zero", [ZERO, 0 * ZERO], ids=["offset", "tared"])
def test_a_fault_is_named_first_and_nothing_of_a_right_table(name: str, zero: Array) -> None:
    fault, code, cause = FAULTS[name]
    for count, seed in ((8, 0), (16, 1)):
        found = tool_from_static_poses(
            sensed_ur5(), StaticPoses(*fault(*poses(count, seed, zero=zero)))
        )
        assert [each.code for each in found.diagnostics] == [code] * (code != "")
        assert [*found.diagnostics[0].causes[:1]] == [cause] * (cause != "") if code else True


@pytest.mark.parametrize(
    ("angle", "code"), [(0.5, ""), (16, "tool.level"), (90, "tool.wall"), (180, "tool.upwards")]
)
def test_gravity_shows_how_the_base_stands(angle: float, code: str) -> None:
    gravity = Rotation.from_euler("y", angle, degrees=True).apply(DOWN)
    for count in (4, 12):
        found = tool_from_static_poses(sensed_ur5(), StaticPoses(*poses(count, 3, gravity)[:2]))
        assert [each.code for each in found.diagnostics] == [code] * (code != "")
        right = sensed_ur5().with_gravity(gravity)
        assert (
            tool_from_static_poses(right, StaticPoses(*poses(count, 3, gravity)[:2])).diagnostics
            == ()
        )


def test_a_cable_that_pulls_beside_the_centre_is_the_first_cause() -> None:
    q, wrench, turn = poses(16, 6)
    pull = np.einsum("pji,j->pi", turn, [-3.0, 0, 0])
    wrench = wrench + np.hstack([pull, np.cross([0, 0, 0.25], pull)])
    said = {
        each.code: each
        for each in tool_from_static_poses(sensed_ur5(), StaticPoses(q, wrench)).diagnostics
    }
    assert said.keys() == {"tool.residual", "tool.level"}
    assert said["tool.level"].causes[0] == "cable"


JOINTS = [f"j{k}" for k in range(1, 7)]
AXES = ["Fx", "Fy", "Fz", "Mx", "My", "Mz"]
HEADINGS: dict[str, tuple[list[str], list[str], float, float, float]] = {
    "brackets": ([f"J{k} [deg]" for k in range(1, 7)],
                 [f"{x} [N]" for x in AXES[:3]] + [f"{x} [Nmm]" for x in AXES[3:]], DEG, 1, 1e3),
    "suffixes": ([f"joint_{k}_deg" for k in range(1, 7)],
                 ["Fx_kgf", "Fy_kgf", "Fz_kgf", "Tx_Nm", "Ty_Nm", "Tz_Nm"], DEG, 1 / KGF, 1),
    "by size": ([f"A{k}" for k in range(1, 7)], [f"force_{x}" for x in "xyz"] +
                [f"moment_{x}" for x in "xyz"], DEG, 1, 1),
}  # fmt: skip


@pytest.mark.parametrize("name", HEADINGS)
def test_headings_are_read_as_recordings_are(name: str, tmp_path: Path) -> None:
    """Beside numbers of poses, times and comments; a row with an empty field is left out."""
    joints, axes, angle, force, moment = HEADINGS[name]
    q, wrench, _ = poses(12, 8)
    columns = np.hstack([q * angle, wrench * np.repeat([force, moment], 3)])
    rows = [["time [s]", "no", *joints, *axes, "remark"]]
    rows += [[f"{7.5 * k}", f"{k}", *map(str, row), "a pose"] for k, row in enumerate(columns)]
    rows[4][9] = ""
    (tmp_path / "poses.csv").write_text("\n".join(map(";".join, rows)))
    position, forces, said = read_static_poses(tmp_path / "poses.csv", sensed_ur5())
    kept = np.delete(np.arange(12), 3)
    np.testing.assert_allclose(position, q[kept], atol=1e-7)
    np.testing.assert_allclose(forces, wrench[kept], atol=1e-6)
    assert len(said) == 1 + (name == "by size")


def write_table(path: Path, heads: list[str], table: Array) -> None:
    np.savetxt(path, table, delimiter=",", header=",".join(heads), comments="")


@pytest.mark.parametrize(
    ("joints", "axes", "named"),
    [
        (JOINTS[:5], AXES, "j6"),
        (["q1", "q2", "q4", "q5", "q6"], AXES, "j3"),
        (JOINTS, AXES[:5], "Mz"),
        (["j1 [mm]", *JOINTS[1:]], AXES, "mm"),
        (JOINTS, ["Fx [A]", *AXES[1:]], "Fx [A]"),
    ],
)
def test_what_a_table_lacks_is_named(
    joints: list[str], axes: list[str], named: str, tmp_path: Path
) -> None:
    rows = np.random.default_rng(1).normal(size=(8, len(joints) + len(axes)))
    write_table(tmp_path / "poses.csv", [*joints, *axes], rows)
    with refuses((RecordingError, UnknownName), named):  # type: ignore[arg-type]
        read_static_poses(tmp_path / "poses.csv", sensed_ur5())


@pytest.mark.parametrize(("scale", "code"), [(1.0, 0), (1000.0, 2)], ids=["good", "wrong"])
def test_controllers_take_what_poses_identify_and_nothing_that_they_contradict(
    scale: float, code: int, tmp_path: Path
) -> None:
    """About the flange that the model names, by the words that a controller reads."""
    q, wrench, _ = poses(12, 9)
    table = np.hstack([q, wrench * np.repeat([1, scale], 3)])
    write_table(tmp_path / "poses.csv", [*JOINTS, *AXES], table)
    words = ("tool", "poses.csv", "--at-rest", "--model", str(UR5), "--sensor", "b6")
    done = command_line(*words, "--as", "ur", "--flange", "b6", cwd=tmp_path)
    assert done.returncode == code, done.stderr
    if code == 0:
        call = ast.parse(done.stdout.splitlines()[-1], mode="eval").body
        assert isinstance(call, ast.Call)
        mass, centre = map(ast.literal_eval, call.args)
        assert mass == pytest.approx(MASS, abs=0.01)
        np.testing.assert_allclose(centre, CENTRE, atol=1e-3)
        others = [command_line(*words, "--as", each, cwd=tmp_path) for each in ("franka", "kuka")]
        assert [each.returncode for each in others] == [0, 0]
        assert not [each for each in others if re.search('inertia":|,J {', each.stdout)]


def swinging(cut: tb.Tree, rate: float, size: float) -> tuple[tb.Motion, Array]:
    """Joints that swing by so many radians, each faster than the one before, and the wrench."""
    t, speed = np.arange(6000) / rate, 0.1 * size * np.arange(1.0, 7.0)
    phase = np.outer(t, speed) + np.arange(6)
    motion = tb.Motion(t, np.sin(phase), speed * np.cos(phase), -(speed**2) * np.sin(phase))
    noise = NOISE / 50 * np.random.default_rng(5).normal(size=(len(t), 6))
    return motion, tb.base_wrench(cut, motion) + noise


def test_a_motion_gives_all_ten_about_the_sensor() -> None:
    rng, tree = np.random.default_rng(3), tb.load_tree(UR5)
    sensor = replace(random_sensors(tree, rng)[0], link=tree.joints[-1].body)
    place = 1.5 * sensor.position + rng.uniform(-0.02, 0.02, 3)
    tool = Inertia.about_centre(1.5, place, 1.5e-3 * np.eye(3))
    tree = replace(tree, inertias=(*tree.inertias[:-1], tool))
    cut = tree_beyond_sensor(tree, links_of(tree), sensor)
    motion, wrench = swinging(cut, 500, 4.0)
    recording = tb.Recording(
        cut.names, motion.t, motion.q, wrench=wrench, velocity=motion.qd, acceleration=motion.qdd
    )
    found = tool_from_motion(cut, tb.identify(cut, recording))
    assert all(found.identifiable)
    assert found.centre is not None
    np.testing.assert_allclose(found.values[0], 1.5, rtol=1e-3)
    centre = sensor.rotation.T @ (place - sensor.position)
    np.testing.assert_allclose(found.centre[0], centre, atol=2e-4)
    assert np.abs(found.values[0] - 1.5) < 5 * found.sigma[0]


MAPPING = """
rate = 300
joints = ["j1", "j2", "j3", "j4", "j5", "j6"]
[sources.log]
file = "log.csv"
time = "t"
time_unit = "s"
[position]
source = "log"
unit = "rad"
columns = ["j1", "j2", "j3", "j4", "j5", "j6"]
[wrench]
source = "log"
sense = "on_robot"
columns = ["Fx", "Fy", "Fz", "Mx", "My", "Mz"]
units = ["N", "N m"]
"""


@pytest.mark.slow
def test_a_sensors_mapping_is_checked_and_its_frame_is_solved(tmp_path: Path) -> None:
    """Of a recording whose sensor is turned by 30 degrees, or shows the opposite sense."""
    tree = tb.load_tree(UR5)
    motion, wrench = swinging(tree_beyond_sensor(tree, links_of(tree), ForceSensor("b6")), 300, 3.0)
    turned = seen_from(Rotation.from_euler("z", -30, degrees=True).as_matrix()[None], wrench)
    (tmp_path / "map.toml").write_text(MAPPING)
    words = ["import", "map.toml", "--out", "x.parquet", "--model", str(UR5)]
    for shown, code, remedy in (
        (wrench, 0, ""),
        (-wrench, 2, 'sense = "on_plate"'),
        (turned, 2, "rpy = [0, 0, 0.5236]"),
    ):
        table = np.column_stack([motion.t, motion.q, shown])
        write_table(tmp_path / "log.csv", ["t", *JOINTS, *AXES], table)
        done = command_line(*words, "--set", "robot.sensor=b6", "--force", cwd=tmp_path)
        assert done.returncode == code, done.stderr
        assert remedy in done.stderr


# payloads in the words of controllers

TURN = Rotation.from_euler("xyz", [0.3, -0.8, 2.0]).as_matrix()
PLACE = np.array([0.02, -0.05, 0.11])
FLANGE = ModelLink("tool0", 2, "forearm", "forearm", Transform(TURN, PLACE), ZERO_INERTIA)


def points() -> tuple[Array, Array]:
    """A payload as masses and places in the frame of its link."""
    rng = np.random.default_rng(8)
    return rng.uniform(0.05, 0.4, 6), rng.normal(scale=0.1, size=(6, 3))


def central(mass: Array, place: Array) -> tuple[float, Array, Array]:
    """Mass, centre, and inertia about it."""
    centre = mass @ place / mass.sum()
    arm = place - centre
    tensor = np.einsum("k,kij->ij", mass, (arm**2).sum(1)[:, None, None] * np.eye(3))
    return float(mass.sum()), centre, tensor - np.einsum("k,ki,kj->ij", mass, arm, arm)


def estimate() -> PayloadEstimate:
    """Of those points, about their link's frame, by Pinocchio."""
    mass, centre, inertia = central(*points())
    values = pin.Inertia(mass, centre, inertia).toDynamicParameters()
    root = 1e-4 * np.random.default_rng(2).normal(size=(10, 10))
    covariance = root @ root.T
    return PayloadEstimate(
        names=STANDARD_NAMES, units=UNITS, values=values, covariance=covariance, joint="elbow",
        rank=10, p_value=0.5,
    )  # fmt: skip


def read_back(vendor: str, text: str) -> tuple[float, Array, Array]:
    """Mass [kg], centre [m] and inertia about it [kg m^2], by the vendor's definition."""
    number = r"(-?[\d.]+(?:e-?\d+)?)"
    if vendor == "ur":
        call = ast.parse(text.splitlines()[-1], mode="eval").body
        assert isinstance(call, ast.Call)
        mass, centre, (xx, yy, zz, xy, xz, yz) = map(ast.literal_eval, call.args)
        return mass, np.array(centre), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    if vendor == "franka":
        said = json.loads(text)
        inertia = np.array(said["inertia"]).reshape(3, 3, order="F")
        return said["mass"], np.array(said["centerOfMass"]), inertia
    found = re.search(r"\{M (\S+),CM \{(.*?)\},J \{(.*?)\}\}", text)
    assert found is not None
    frame, moments = (
        [float(x) for x in re.findall(rf"[XYZABC] {number}", part)] for part in found.groups()[1:]
    )
    turn = Rotation.from_euler("ZYX", frame[3:], degrees=True).as_matrix()
    return float(found[1]), np.array(frame[:3]) / 1000, turn @ np.diag(moments) @ turn.T


def test_every_vendor_reads_the_payload_at_the_flange() -> None:
    """Wrong end-effector inertias cost a Franka a fifth of its tracking; also beyond a sensor."""
    turn = Rotation.from_euler("xyz", [1.0, 0.2, -0.5]).as_matrix()
    sensor = SensorPlacement(np.array([0.1, 0.0, 0.2]), turn, "wrist", 2)
    felt = replace(robot("puma"), sensor=sensor)
    mass, place = points()
    moved = place @ turn.T + sensor.position
    for tree, link, seen in (
        (robot("puma"), None, place),
        (robot("puma"), FLANGE, (place - PLACE) @ TURN),
        (felt, None, place),
        (felt, FLANGE, (moved - PLACE) @ TURN),
    ):
        load, expected = flange_payload(estimate(), tree, link), central(mass, seen)
        assert load.frame == ("tool0" if link else "wrist" if tree is felt else "link3")
        for vendor, text in VENDOR_WRITERS.items():
            read = read_back(vendor, text(load))
            for k in range(3):
                np.testing.assert_allclose(read[k], expected[k], rtol=1e-12, atol=1e-14)


def test_sigma_is_the_spread_of_what_is_written() -> None:
    found, tree = estimate(), robot("puma")
    load = flange_payload(found, tree, FLANGE)
    rng, rows = np.random.default_rng(1), []
    for values in rng.multivariate_normal(found.values, found.covariance, 500):
        own = flange_payload(replace(found, values=values), tree, FLANGE)
        rows.append([own.inertia.mass, *own.inertia.com, *own.inertia_components])
    np.testing.assert_allclose(np.std(rows, axis=0), load.sigma, rtol=0.12)


def test_what_no_controller_should_get_is_refused() -> None:
    found, tree = estimate(), robot("puma")
    flat = replace(found, values=found.values - np.eye(10)[4] * 1.0)
    partial = replace(found, unidentifiable=("Iyz",))
    for each, link, culprit in (
        (flat, None, "payload"),
        (partial, None, "Iyz"),
        (found, replace(FLANGE, body=1), "tool0"),
    ):
        with refuses(SettingsError, culprit):
            flange_payload(each, tree, link)
