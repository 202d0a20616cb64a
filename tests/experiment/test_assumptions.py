"""What `new` assumes goes with the robot's size, and a second of what it writes has run."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import testbed as tb
from testbed.errors import ExperimentError, LoopError
from testbed.excitation.limits import limits_of
from testbed.experiment.assumptions import assumptions
from testbed.experiment.experiment import run_name
from testbed.experiment.new_experiment import new_experiment
from testbed.experiment.robot_found import find_robot
from testbed.experiment.simulate import simulate
from testbed.robot.load import mimic_joints
from tests.helpers.paths import ROOT
from tests.helpers.runs import MODELS

ARM = """<mujoco model="arm"><worldbody><body name="upper" pos="0 0 {l}">
  <joint name="turn" axis="0 0 1"/>
  <inertial pos="0 {l} 0" mass="{m}" diaginertia="{i} {i} {i}"/>
  <body name="fore" pos="{l} 0 {l}"><joint name="lift" axis="0 1 0" range="-60 60"/>
  <inertial pos="{l} 0 0" mass="{m}" diaginertia="{i} {i} {i}"/>
  </body></body></worldbody></mujoco>"""


def arm(folder: Path, length: float, mass: float) -> Path:
    path = folder / "arm.xml"
    path.write_text(ARM.format(l=length / 2, m=mass, i=mass * length**2 / 20))
    return path


def content(path: Path, *, tried: bool = True, exact: bool = False) -> dict[str, Any]:
    text = new_experiment(path, path.parent, tried=tried, exact_torque_constants=exact)
    return tomllib.loads(text)


@pytest.mark.parametrize("length", [0.05, 20.0])
@pytest.mark.parametrize("mass", [0.05, 20.0])
def test_assumptions_go_with_the_robot_s_size_and_it_runs(
    length: float, mass: float, tmp_path: Path
) -> None:
    """Weights go by mass; where gravity outweighs inertia, moments by mass times length."""
    usual = assumptions(tb.load_tree(arm(tmp_path, 1.0, 1.0)))
    path = arm(tmp_path, length, mass)
    scaled = assumptions(tb.load_tree(path))
    least = 0.5 * mass * min(length, 1.0)
    assert scaled.force_noise / usual.force_noise >= 0.5 * mass
    assert least <= scaled.moment_noise / usual.moment_noise <= 3 * mass * max(length, length**2)
    assert least <= scaled.torque_noise / usual.torque_noise <= 3 * mass * max(length, length**2)
    short = {"motion.duration=2", "motion.candidates=1", "simulation.warm_up=0.5"}
    recording = simulate(tb.Experiment.of_content(content(path), tmp_path / "e.toml", short))
    assert np.isfinite(recording.position).all()


def test_a_robot_ten_times_as_heavy_is_measured_ten_times_as_coarsely(puma: tb.Tree) -> None:
    """Exactly so, but for rounding to one digit, and frictionless."""
    heavy = puma.without_friction()
    light = replace(heavy, inertias=tuple(scaled(i, 0.1) for i in heavy.inertias))
    one, ten = assumptions(light), assumptions(heavy)
    for name in ("force_noise", "moment_noise", "torque_noise"):
        assert getattr(ten, name) == pytest.approx(10 * getattr(one, name), rel=1e-9)
    for joint in puma.names:
        for key in ("coulomb", "viscous"):
            assert ten.joints[joint][key] == pytest.approx(10 * one.joints[joint][key], rel=0.06)


def scaled(inertia: tb.Inertia, by: float) -> tb.Inertia:
    return tb.Inertia(by * inertia.mass, by * inertia.first_moment, by * inertia.tensor)


def test_the_puma_s_are_those_of_the_shipped_experiments() -> None:
    found = assumptions(tb.load_tree(MODELS["puma"]))
    assert (found.force_noise, found.moment_noise, found.torque_noise) == (0.5, 0.1, 0.5)
    assert found.step == 5e-4
    assert found.clearance is None
    assert not found.joints


def test_a_rotor_without_end_turns_about_zero(tmp_path: Path) -> None:
    text = arm(tmp_path, 1.0, 1.0).read_text().replace("-60 60", "-1e16 1e16")
    (tmp_path / "rotor.xml").write_text(text)
    limits = limits_of(tb.load_tree(tmp_path / "rotor.xml"))
    np.testing.assert_allclose(limits.high, np.pi)
    np.testing.assert_allclose(limits.low, -np.pi)


TIP = """<body name="tip" pos=".5 0 0"><joint name="bend" axis="0 1 0"/>
  <geom size="{}"/></body></body></body>"""


def with_tip(folder: Path, size: float) -> str:
    text = arm(folder, 1.0, 1.0).read_text()
    head, tail = text.rsplit("</body></body>", 1)
    return head + TIP.format(size) + tail


def test_bodies_of_which_some_touch_in_every_posture_are_left_out_by_name(tmp_path: Path) -> None:
    """A ball that slides between two posts too near for it, each of them free in half of its way.

    The rest stays watched.
    """
    path = tmp_path / "slot.xml"
    path.write_text("""<mujoco><worldbody><geom size=".25" pos="-.4 0 .5"/>
      <body name="mast"><joint name="a" axis="0 0 1" range="-9 9"/><geom size=".1" pos="0 0 -.5"/>
      <body name="ball" pos="0 0 .5"><joint name="slide" type="slide" axis="1 0 0" range="-.3 .3"/>
      <geom size=".2"/></body></body>
      <body name="post"><joint name="b" axis="0 0 1" range="-9 9"/><geom size=".25" pos=".4 0 .5"/>
      </body></worldbody></mujoco>""")
    said = content(path)["excitation"]
    pairs = {frozenset(pair) for pair in said["exclude"]}
    assert pairs
    assert pairs <= {frozenset(("ball", other)) for other in ("plate", "post")}
    assert "clearance" not in said


COUPLED = """<tendon><fixed name="t"><joint joint="turn" coef="1"/>
  <joint joint="lift" coef="-2"/></fixed></tendon><equality>{}</equality></mujoco>"""


def test_a_tendon_of_two_joints_is_a_joint_that_follows(tmp_path: Path) -> None:
    path, free = tmp_path / "coupled.xml", tmp_path / "free.xml"
    free.write_text(with_tip(tmp_path, 0.1))
    equality = COUPLED.format('<tendon tendon1="t"/>')
    path.write_text(free.read_text().replace("</mujoco>", equality))
    assert mimic_joints(path) == ("turn",)
    led = tb.load_tree(path, lock={"lift": 0.5})
    posed = tb.load_tree(free, lock={"lift": 0.5, "turn": 1.0})
    assert led.names == posed.names == ("bend",)
    np.testing.assert_allclose(led.joints[0].rotation, posed.joints[0].rotation, atol=1e-12)


def test_a_loop_names_the_joints_to_hold_and_new_holds_them(tmp_path: Path) -> None:
    text = with_tip(tmp_path, 0.1)
    weld = '<equality><weld body1="upper" body2="tip"/></equality></mujoco>'
    path = tmp_path / "loop.xml"
    path.write_text(text.replace("</mujoco>", weld))
    with pytest.raises(LoopError, match=r"<weld> \(number 1\).*--lock") as refused:
        tb.load_tree(path)
    assert set(refused.value.joints) == {"lift", "bend"}
    assert tb.load_tree(path, lock=refused.value.joints).names == ("turn",)
    assert set(content(path)["robot"]["lock"]) == {"lift", "bend"}


def test_bodies_that_a_program_moves_weld_nothing(tmp_path: Path) -> None:
    text = arm(tmp_path, 1.0, 1.0).read_text()
    text = text.replace("</worldbody>", '<body name="hand" mocap="true"/></worldbody>')
    weld = '<equality><weld body1="hand" body2="fore"/></equality></mujoco>'
    path = tmp_path / "mocap.xml"
    path.write_text(text.replace("</mujoco>", weld))
    assert tb.load_tree(path).names == ("turn", "lift")
    content(path)


def test_what_does_not_run_is_not_written(tmp_path: Path) -> None:
    text = (ROOT / "models/puma562.xml").read_text()
    path = tmp_path / "clipped.xml"
    path.write_text(text.replace("<force name", '<force cutoff="50" name'))
    with pytest.raises(ExperimentError, match="unfiltered"):
        content(path)


def test_joints_that_damping_holds_are_held(tmp_path: Path) -> None:
    """A thousand times the weight at a usual speed; a joint that is merely slow stays."""
    text = arm(tmp_path, 1.0, 1.0).read_text()
    path = tmp_path / "damped.xml"
    for damping, held in (("1e9", {"turn"}), ("1e2", set())):
        path.write_text(text.replace('name="turn"', f'name="turn" damping="{damping}"'))
        assert set(find_robot(path, None).lock) == held
        assert set(content(path)["robot"].get("lock", {})) == held


def test_exact_torque_constants_and_names_of_models(tmp_path: Path) -> None:
    path = arm(tmp_path, 1.0, 1.0)
    assert "torque_constant_error" in content(path, tried=False)["measurement"]
    exact = content(path, tried=False, exact=True)
    assert "torque_constant_error" not in exact["measurement"]
    (tmp_path / "robot.xml").write_text(path.read_text())
    assert content(tmp_path / "robot.xml", tried=False)["name"] == "arm"
    assert run_name(Path("sawyer/robot.xml"), "MuJoCo Model") == "sawyer"
    assert run_name(Path("ur5_gripper.urdf"), "ur5") == "ur5_gripper"
