"""What a force sensor carries: by a motion, and by a dozen poses at rest.

If one fails, payloads that people type into their robots are wrong.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from scipy.spatial.transform import Rotation

import testbed as tb
from testbed.applications.payload.static_fit import StaticPoses
from testbed.applications.payload.tool import tool_at_rest, tool_of
from testbed.core.base.arrays import Array
from testbed.core.base.errors import RecordingError, SettingsError
from testbed.core.robot.force_sensor import ForceSensor, beyond_sensor
from testbed.core.robot.inertia import Inertia
from testbed.importing.static_poses import read_static_poses
from tests.helpers.command import command_line
from tests.helpers.paths import ROOT
from tests.helpers.sensors import links_of, random_sensors
from tests.helpers.strategies import few, rngs

UR5 = ROOT / "tests/golden/robots/ur5.urdf"
ZERO = np.array([1.0, -2.0, 0.5, 0.01, 0.02, -0.03])
NOISE = np.repeat([0.02, 5e-4], 3)


def wrist(rng: np.random.Generator, mass: float = 0.28) -> tuple[tb.Tree, Array]:
    """A UR5 whose last link is a tool ahead of a sensor, and its centre in the sensor's frame."""
    tree = tb.load_tree(UR5)
    sensor = replace(random_sensors(tree, rng)[0], link=tree.joints[-1].body)
    ahead = sensor.position / np.linalg.norm(sensor.position)
    place = sensor.position + rng.uniform(0.04, 0.1) * ahead + rng.uniform(-0.02, 0.02, 3)
    tool = Inertia.about_centre(mass, place, 1e-3 * mass * np.eye(3))
    tree = replace(tree, inertias=(*tree.inertias[:-1], tool))
    cut = beyond_sensor(tree, links_of(tree), sensor)
    return cut, sensor.rotation.T @ (place - sensor.position)


def at_rest(cut: tb.Tree, poses: int, gravity: Array, rng: np.random.Generator) -> StaticPoses:
    """What the sensor shows in random poses, its zero and its noise included."""
    q = rng.uniform(-2.5, 2.5, (poses, cut.n))
    motion = tb.Motion(np.arange(float(poses)), q, 0 * q, 0 * q)
    wrench = tb.base_wrench(cut, motion, gravity)
    return StaticPoses(q, wrench + ZERO + NOISE * rng.normal(size=wrench.shape))


@few(10)
@given(rngs)
def test_static_poses_give_mass_centre_zero_and_gravity(rng: np.random.Generator) -> None:
    """A robot hung anyhow; within five of its own standard deviations, and as near as is asked."""
    cut, centre = wrist(rng)
    gravity = Rotation.random(rng=rng).apply([0, 0, -9.81])
    found = tool_at_rest(cut, at_rest(cut, 17, gravity, rng))
    numbers = [found.mass, *found.centre, *found.force_zero, *found.moment_zero]
    z = [
        (value - truth) / sigma
        for (value, sigma), truth in zip(numbers, [0.28, *centre, *ZERO], strict=True)
    ]
    assert np.abs(z).max() < 5
    assert found.unidentifiable == ()
    assert {each.code for each in found.diagnostics} <= {"tool.level", "tool.wall", "tool.upwards"}
    assert np.cross(found.gravity, gravity / 9.81) == pytest.approx(0, abs=5e-3)
    assert found.tilt[0] == pytest.approx(np.arccos(np.clip(-gravity[2] / 9.81, -1, 1)), abs=5e-3)


def test_its_standard_deviations_hold_with_few_poses() -> None:
    """Six poses leave 24 numbers over: a normal law's 95 % are 95 % still."""
    inside = []
    for seed in range(60):
        rng = np.random.default_rng([42, seed])
        cut, centre = wrist(rng)
        found = tool_at_rest(cut, at_rest(cut, 6, np.array([0, 0, -9.81]), rng))
        numbers = zip((found.mass, *found.centre), (0.28, *centre), strict=True)
        inside += [abs(value - truth) < 1.96 * sigma for (value, sigma), truth in numbers]
    assert 0.9 < np.mean(inside) < 0.985


def test_poses_that_are_all_alike_leave_everything_open() -> None:
    """Turned about the vertical only, weight and zero cannot be separated."""
    rng = np.random.default_rng(7)
    cut, _ = wrist(rng)
    q = np.tile(rng.uniform(-1, 1, cut.n), (9, 1))
    motion = tb.Motion(np.arange(9.0), q, 0 * q, 0 * q)
    wrench = tb.base_wrench(cut, motion) + ZERO + NOISE * rng.normal(size=(9, 6))
    assert "mass and gravity" in tool_at_rest(cut, StaticPoses(q, wrench)).unidentifiable


def test_a_motion_gives_all_ten_about_the_sensor() -> None:
    rng = np.random.default_rng(3)
    cut, centre = wrist(rng, mass=1.5)
    t = np.arange(6000) / 500
    phase = 0.4 * np.outer(t, np.arange(1, 7)) + np.arange(6)
    speed = 0.4 * np.arange(1.0, 7.0)
    q, qd, qdd = np.sin(phase), speed * np.cos(phase), -(speed**2) * np.sin(phase)
    motion = tb.Motion(t, q, np.array(qd), np.array(qdd))
    wrench = tb.base_wrench(cut, motion) + 0.1 * NOISE * rng.normal(size=(len(t), 6))
    recording = tb.Recording(
        cut.names, t, motion.q, wrench=wrench, velocity=motion.qd, acceleration=motion.qdd
    )
    found = tool_of(cut, tb.identify(cut, recording))
    assert all(found.identifiable)
    assert found.centre is not None
    np.testing.assert_allclose(found.values[0], 1.5, rtol=1e-3)
    np.testing.assert_allclose(found.centre[0], centre, atol=2e-4)
    assert np.abs(found.values[0] - 1.5) < 5 * found.sigma[0]


def test_a_table_is_read_as_people_write_it_and_refused_in_one_line(tmp_path: Path) -> None:
    rng = np.random.default_rng(11)
    cut, _ = wrist(rng)
    table = at_rest(cut, 12, np.array([0, 0, -9.81]), rng)
    heading = [*(name.upper() for name in cut.names), "fx", "fy", "fz", "mx", "my", "mz"]
    rows = np.hstack([np.rad2deg(table.position), table.wrench])
    for mark in (",", ";", "\t", " "):
        file = tmp_path / "poses.txt"
        lines = [mark.join(heading), *(mark.join(f"{x:.9g}" for x in row) for row in rows)]
        file.write_text("\n".join(lines))
        position, wrench, _ = read_static_poses(file, cut, degrees=True)
        np.testing.assert_allclose(position, table.position, atol=1e-8)
        np.testing.assert_allclose(wrench, table.wrench, atol=1e-7)
    for text in ("", "a,b\n1,2", ",".join(heading) + "\n" + "x," * 12, ",".join(heading)):
        file.write_text(text)
        with pytest.raises(RecordingError):
            read_static_poses(file, cut)
    with pytest.raises(SettingsError):
        tool_at_rest(tb.load_tree(UR5), table)
    with pytest.raises(SettingsError):
        tool_at_rest(cut.with_gravity([0, 0, 0]), table)
    words = ("tool", str(file), "--at-rest", "--model", str(UR5), "--sensor", "b6")
    bad = command_line(*words, cwd=tmp_path)
    assert (bad.returncode, bad.stderr.count("\n")) == (2, 1)


@pytest.mark.slow
def test_a_sensors_mapping_is_checked_and_its_frame_is_solved(tmp_path: Path) -> None:
    """Of a recording whose sensor is turned by 30 degrees, or shows the opposite sense."""
    rng = np.random.default_rng(5)
    tree = tb.load_tree(UR5)
    cut = beyond_sensor(tree, links_of(tree), ForceSensor(tree.joints[-1].body))
    t = np.arange(6000) / 300
    speed = 0.3 * np.arange(1.0, 7.0)
    phase = np.outer(t, speed) + np.arange(6)
    q, qd, qdd = np.sin(phase), speed * np.cos(phase), -(speed**2) * np.sin(phase)
    wrench = tb.base_wrench(cut, tb.Motion(t, q, np.array(qd), np.array(qdd)))
    wrench = wrench + 0.1 * NOISE * rng.normal(size=wrench.shape)
    turn = Rotation.from_euler("z", 30, degrees=True).as_matrix()
    names = [f"q{k}" for k in range(6)]
    heads = ["t", *names, "Fx", "Fy", "Fz", "Mx", "My", "Mz"]
    said = [
        "rate = 300",
        f"joints = {list(cut.names)}",
        '[sources.log]\nfile = "log.csv"\ntime = "t"\ntime_unit = "s"',
        f'[position]\nsource = "log"\nunit = "rad"\ncolumns = {names}',
        f'[wrench]\nsource = "log"\nsense = "on_robot"\ncolumns = {heads[7:]}',
        'units = ["N", "N m"]',
    ]
    (tmp_path / "map.toml").write_text("\n".join(said).replace("'", '"'))
    words = ["import", "map.toml", "--out", "x.parquet", "--model", str(UR5)]
    words += ["--set", f"robot.sensor={tree.joints[-1].body}", "--force"]
    for shown, code, remedy in (
        (wrench, 0, ""),
        (-wrench, 2, 'sense = "on_plate"'),
        (np.hstack([wrench[:, :3] @ turn, wrench[:, 3:] @ turn]), 2, "rpy = [0, 0, 0.5236]"),
    ):
        table = np.column_stack([t, q, shown])
        np.savetxt(tmp_path / "log.csv", table, delimiter=",", header=",".join(heads), comments="")
        done = command_line(*words, cwd=tmp_path)
        assert done.returncode == code, done.stderr
        assert remedy in done.stderr
