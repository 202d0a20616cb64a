"""Experiment files: every key is checked and named; `new` writes one for any robot, and it runs."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args, get_origin

import numpy as np
import pytest
from pydantic import BaseModel

import testbed as tb
from benchmarks.robots import MOST_SIGMAS
from testbed.core.base.errors import ExperimentError, TestbedError
from testbed.core.base.toml_text import MAX_FILE_BYTES, apply_settings
from testbed.core.robot.model_file import mimic_joints, nearest_consistent_bodies
from testbed.core.robot.refusals import InertiaError
from testbed.lab.experiment.assumptions import COULOMB_SHARE, assumptions
from testbed.lab.experiment.evaluate import evaluate
from testbed.lab.experiment.experiment import Experiment, run_name
from testbed.lab.experiment.motions import experiment_motion
from testbed.lab.experiment.new_experiment import new_experiment, read_robot
from testbed.lab.experiment.results import default_folder
from testbed.lab.experiment.rig import robot_of
from testbed.lab.experiment.robot_tables import JointTable
from testbed.motion.limits import joint_limits
from tests.helpers.command import command_line
from tests.helpers.paths import REAL, ROOT
from tests.helpers.refusals import refuses
from tests.helpers.runs import MODELS

TABLE6 = ROOT / "experiments/table6.toml"


def test_what_ships_is_readable_and_makes_a_claim() -> None:
    for path in sorted((ROOT / "experiments").glob("*.toml")):
        experiment = tb.Experiment.from_toml(path)
        assert experiment.claim
        assert experiment.expect
        assert Path(experiment.model).is_file()


def test_settings_override_keys_and_the_resolved_file_says_the_same(tmp_path: Path) -> None:
    words = ["motion.duration=7", "measurement.torque_constant_error.elbow=-0.01", "name=other"]
    experiment = tb.Experiment.from_toml(TABLE6, words)
    assert (experiment.motion.duration, experiment.name) == (7, "other")
    assert experiment.measurement.torque_constant_error["elbow"] == -0.01
    assert experiment.measurement.torque_constant_error["waist"] == 0.08
    (tmp_path / "again.toml").write_text(experiment.as_toml())
    again = tb.Experiment.from_toml(tmp_path / "again.toml")
    assert again == experiment
    assert default_folder(again) == default_folder(experiment)
    assert default_folder(experiment.model_copy(update={"seed": 5})) != default_folder(experiment)
    content: dict[str, Any] = {}
    apply_settings(
        content, ['robot.lock."arm.elbow"=0.5', "robot.'a.b'.c='x'", "motion.duration=3"]
    )
    quoted = {"lock": {"arm.elbow": 0.5}, "a.b": {"c": "x"}}
    assert content == {"robot": quoted, "motion": {"duration": 3}}


def test_all_faults_are_named_at_once() -> None:
    with pytest.raises(ExperimentError) as caught:
        tb.Experiment.from_toml(TABLE6, ["motion.duration=-1", "speed=1", "seed=-4"])
    assert all(word in str(caught.value) for word in ("duration", "speed", "seed"))


def is_number(kind: Any) -> bool:
    """Whether a key takes a number with a fraction, and perhaps something else."""
    lists = (dict, list, tuple)
    return kind is float or (get_origin(kind) not in lists and any(map(is_number, get_args(kind))))


def numbers_of(table: type[BaseModel], path: str = "") -> Iterator[str]:
    """Paths of all keys of numbers in a table and those within it."""
    for name, field in table.model_fields.items():
        kind = field.annotation
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            yield from numbers_of(kind, f"{path}{name}.")
        elif is_number(kind):
            yield f"{path}{name}"


def test_no_number_is_infinite() -> None:
    """Whatever key is added: a motion without end, or noise without end, would be simulated."""
    paths = [*numbers_of(Experiment), *numbers_of(JointTable, "robot.joint.waist.")]
    assert len(paths) > 10
    for k, path in enumerate(paths):
        with refuses(ExperimentError, path):
            tb.Experiment.from_toml(TABLE6, [f"{path}={('inf', '-inf', 'nan')[k % 3]}"])


def test_files_that_would_cost_memory_or_the_stack_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "e.toml"
    whole = TABLE6.read_text() + "#" * (MAX_FILE_BYTES - TABLE6.stat().st_size)
    path.write_text(whole)
    found = tb.Experiment.from_toml(path, [f"model='{MODELS['puma']}'"])
    assert found.name == "table6"
    for text in (
        whole + "#",
        f"a = {'[' * 100_000}",
        ".".join("a" * 50_000) + " = 1\n",
        f"seed = {'9' * 5000}\n",
    ):
        path.write_text(text)
        with refuses(ExperimentError, "e.toml"):
            tb.Experiment.from_toml(path)


ARM = """<mujoco model="arm"><worldbody><body name="upper" pos="0 0 {l}">
  <joint name="turn" axis="0 0 1"/>
  <inertial pos="0 {l} 0" mass="{m}" diaginertia="{i} {i} {i}"/>
  <body name="fore" pos="{l} 0 {l}"><joint name="lift" axis="0 1 0" range="-60 60"/>
  <inertial pos="{l} 0 0" mass="{m}" diaginertia="{i} {i} {i}"/>
  </body></body></worldbody></mujoco>"""
TIP = """<body name="tip" pos=".5 0 0"><joint name="bend" axis="0 1 0"/>
  <geom size=".1"/></body></body></body>"""


def arm(folder: Path, length: float = 1.0, mass: float = 1.0, *changes: tuple[str, str]) -> Path:
    text = ARM.format(l=length / 2, m=mass, i=mass * length**2 / 20)
    for change in changes:
        text = text.replace(*change)
    (folder / "arm.xml").write_text(text)
    return folder / "arm.xml"


def written(model: Path, folder: Path, *, tried: bool = False) -> tb.Experiment:
    file = folder / "new.toml"
    file.write_text(new_experiment(model, folder, run_trial=tried), encoding="utf-8")
    return tb.Experiment.from_toml(file)


@pytest.mark.parametrize("name", sorted(MODELS))
def test_what_it_says_is_the_models(name: str, tmp_path: Path) -> None:
    """Counts, limits, friction; defaults in comments may be taken as they stand."""
    experiment = written(MODELS[name], tmp_path)
    tree, own = robot_of(experiment), tb.load_tree(MODELS[name])
    text = (tmp_path / "new.toml").read_text()
    for model in ("torque", "wrench"):
        assert re.search(rf"\b{tb.minimal_set(own, model).count}\b", text.splitlines()[0])
    limits = dict(zip(own.names, joint_limits(own).velocity, strict=True))
    assert experiment.motion.max_velocity == pytest.approx(limits, rel=1e-5)
    for joint, before in zip(tree.joints, own.joints, strict=True):
        assert joint.coulomb > 0 or joint.viscous > 0  # a robot without friction is no test
        if before.coulomb or before.viscous:
            assert (joint.coulomb, joint.viscous) == (before.coulomb, before.viscous)
    (tmp_path / "shown.toml").write_text(text.replace("# gravity", "gravity"))
    shown = tb.Experiment.from_toml(tmp_path / "shown.toml")
    np.testing.assert_allclose(robot_of(shown).gravity, tree.gravity)
    assert experiment.identification.zeros is False  # symmetry is for a person to say
    gains = np.array(list(experiment.measurement.torque_constant_error.values()))
    np.testing.assert_array_equal(np.sign(gains), [(-1) ** k for k in range(len(gains))])
    experiment_motion(experiment, tree)  # proven


@pytest.mark.parametrize(("length", "mass"), [(0.05, 20.0), (20.0, 0.05)])
def test_assumptions_go_with_the_robots_size(length: float, mass: float, tmp_path: Path) -> None:
    """Weights go by mass; where gravity outweighs inertia, moments by mass times length."""
    usual = assumptions(tb.load_tree(arm(tmp_path)))
    path = arm(tmp_path, length, mass)
    found, least = assumptions(tb.load_tree(path)), 0.5 * mass * min(length, 1.0)
    most = 3 * mass * max(length, length**2)
    assert found.force_noise / usual.force_noise >= 0.5 * mass
    assert least <= found.moment_noise / usual.moment_noise <= most
    assert least <= found.torque_noise / usual.torque_noise <= most


def test_friction_is_assumed_from_the_load_within_the_whole_range(tmp_path: Path) -> None:
    """Of a pendulum between 0 and 1 rad the rms of m g l sin q is 0.522 m g l."""
    mass, reach = 100.0, 0.01
    (tmp_path / "pendulum.urdf").write_text(f"""<robot name="pendulum"><link name="base"/>
      <link name="bob"><inertial><origin xyz="0 0 {-reach}"/><mass value="{mass}"/>
      <inertia ixx="1e-6" ixy="0" ixz="0" iyy="1e-6" iyz="0" izz="1e-6"/></inertial></link>
      <joint name="swing" type="revolute"><parent link="base"/><child link="bob"/>
      <axis xyz="0 1 0"/><limit lower="0" upper="1" effort="1000" velocity="1"/></joint></robot>""")
    load = mass * 9.81 * reach * np.sqrt(0.5 - np.sin(2.0) / 4)
    found = robot_of(written(tmp_path / "pendulum.urdf", tmp_path)).joints[0].coulomb
    assert found == pytest.approx(COULOMB_SHARE * load, rel=0.1)


def test_joints_and_links_of_any_name_roots_that_float_and_impossible_bodies(
    tmp_path: Path,
) -> None:
    name = 'l (1) = "a.b"'
    quoted = name.replace('"', "&quot;")
    (tmp_path / "odd.xml").write_text(f"""<mujoco><worldbody><body name="b"><freejoint/>
      <geom size=".1"/><body name='{quoted}' pos="0 0 .2">
      <joint name="a b.&quot;c&quot; = 0" axis="0 1 0"/>
      <inertial mass="1" pos=".1 0 0" diaginertia="1 1 9"/></body></body></worldbody></mujoco>""")
    experiment = written(tmp_path / "odd.xml", tmp_path)
    tree = robot_of(experiment)
    assert experiment.weld_root
    assert tree.names == ('a b."c" = 0',)
    assert list(experiment.robot.repair) == [name]


@pytest.mark.slow
def test_bodies_that_cannot_be_are_written_as_they_will_be_taken(tmp_path: Path) -> None:
    """To the last digits."""
    path = REAL / "icub_description/robots/icub_reduced.urdf"
    experiment = written(path, tmp_path)
    found = nearest_consistent_bodies(path, weld_root=experiment.weld_root)
    assert set(experiment.robot.repair) == set(found.bodies)
    assert len(found.bodies) > 3
    tree, own = robot_of(experiment), tb.load_tree(path, weld_root=experiment.weld_root)
    for a, b in zip(tree.inertias, own.inertias, strict=True):
        np.testing.assert_allclose(a.pseudo, b.pseudo, rtol=1e-12, atol=1e-15)
    with pytest.raises(InertiaError):
        new_experiment(path, tmp_path, strict=True)


def test_followers_grippers_loops_and_stiff_joints_are_held(tmp_path: Path) -> None:
    """A joint that is merely slow stays, and so does one that is followed and carries more."""
    panda = written(REAL / "panda_description/urdf/panda.urdf", tmp_path)
    assert (panda.robot.lock, robot_of(panda).n) == ({"panda_finger_joint1": 0.0}, 7)
    for damping, held in (("1e9", {"turn"}), ("1e2", set())):
        change = ('name="turn"', f'name="turn" damping="{damping}"')
        assert set(read_robot(arm(tmp_path, 1.0, 1.0, change), None).lock) == held
    with_tip = ("</body></body></worldbody>", TIP + "</worldbody>")
    weld = '<equality><weld body1="upper" body2="tip"/></equality></mujoco>'
    loop = arm(tmp_path, 1.0, 1.0, with_tip, ("</mujoco>", weld))
    assert set(written(loop, tmp_path).robot.lock) == {"lift", "bend"}
    coupled = (
        '<tendon><fixed name="t"><joint joint="turn" coef="1"/><joint joint="lift" coef="-2"/>'
        '</fixed></tendon><equality><tendon tendon1="t"/></equality></mujoco>'
    )
    path = arm(tmp_path, 1.0, 1.0, with_tip, ("</mujoco>", coupled))
    assert mimic_joints(path) == ("turn",)
    led = tb.load_tree(path, lock={"lift": 0.5})
    posed = tb.load_tree(arm(tmp_path, 1.0, 1.0, with_tip), lock={"lift": 0.5, "turn": 1.0})
    np.testing.assert_allclose(led.joints[0].rotation, posed.joints[0].rotation, atol=1e-12)
    moved = '<body name="hand" mocap="true"/></worldbody>'
    weld = '<equality><weld body1="hand" body2="fore"/></equality></mujoco>'
    mocap = arm(tmp_path, 1.0, 1.0, ("</worldbody>", moved), ("</mujoco>", weld))
    assert tb.load_tree(mocap).names == ("turn", "lift")  # what a program moves welds nothing
    endless = arm(tmp_path, 1.0, 1.0, ("-60 60", "-1e16 1e16"))
    np.testing.assert_allclose(joint_limits(tb.load_tree(endless)).high, np.pi)


@pytest.mark.slow
def test_bodies_of_which_some_touch_in_every_posture_are_left_out_by_name(tmp_path: Path) -> None:
    """A ball that slides between two posts too near for it; the rest stays watched."""
    path = tmp_path / "slot.xml"
    path.write_text("""<mujoco><worldbody><geom size=".25" pos="-.4 0 .5"/>
      <body name="mast"><joint name="a" axis="0 0 1" range="-9 9"/><geom size=".1" pos="0 0 -.5"/>
      <body name="ball" pos="0 0 .5"><joint name="slide" type="slide" axis="1 0 0" range="-.3 .3"/>
      <geom size=".2"/></body></body>
      <body name="post"><joint name="b" axis="0 0 1" range="-9 9"/><geom size=".25" pos=".4 0 .5"/>
      </body></worldbody></mujoco>""")
    said = written(path, tmp_path, tried=True).excitation
    pairs = {frozenset(pair) for pair in said.exclude}
    assert pairs
    assert pairs <= {frozenset(("ball", other)) for other in ("plate", "post")}
    assert said.clearance != "off"


def test_what_is_no_robot_or_does_not_run_is_refused(tmp_path: Path) -> None:
    massless = (
        '<robot><link name="a"/><link name="b"/><joint name="j" type="continuous">'
        '<parent link="a"/><child link="b"/></joint></robot>'
    )
    clipped = MODELS["puma"].read_text().replace("<force name", '<force cutoff="50" name')
    for name, text in (("no.urdf", "<robot/>"), ("r.urdf", massless), ("clipped.xml", clipped)):
        (tmp_path / name).write_text(text)
        with refuses(TestbedError, name):
            new_experiment(tmp_path / name, tmp_path)


def test_a_run_is_named_for_the_robot_where_the_file_says_nothing() -> None:
    assert run_name(Path("sawyer/robot.xml"), "MuJoCo Model") == "sawyer"
    assert run_name(Path("ur5_gripper.urdf"), "ur5") == "ur5_gripper"
    assert run_name(Path("robot.xml"), "puma562") == "puma562"


ROBOTS = {
    "light links that rub": "xarm_description/urdf/xarm7",
    "a light gripper": "z1_description/urdf/z1",
    "a frame of 1e-9 kg": "so_arm_description/urdf/so101",
    "tool frames without inertia": "talos_data/robots/talos_left_arm",
    "moments of -2e-22": "anymal_b_simple_description/robots/anymal",
    "two arms, two grippers": "baxter_description/urdf/baxter",
    "a hand, links that break the triangle": "allegro_hand_description/urdf/allegro_left_hand",
    "a gripper that touches": "ur_description/urdf/ur5_gripper",
    "a small finger": "finger_edu_description/robots/finger_edu",
    "joints without limits": "double_pendulum_description/urdf/double_pendulum_continuous",
}
SHORT, LONG = 4.0, 10.0
"""Seconds that most are recorded for, and a period that is usual."""


@pytest.mark.slow
@pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS)
def test_any_robot_runs_as_new_writes_it(robot: str, tmp_path: Path) -> None:
    """Else whoever has another robot than ours stops at the second command."""
    made = command_line("new", str(REAL / f"{robot}.urdf"), "--out", "r.toml", cwd=tmp_path)
    assert made.returncode == 0, made.stderr
    motion = tomllib.loads((tmp_path / "r.toml").read_text())["motion"]
    period = 1 / motion["fundamental"]  # of many parameters only a whole one holds enough values
    seconds = period if period > LONG else SHORT
    # distances to meshes take most of the time, and `new` has looked at them
    words = [f"motion.duration={seconds}", "motion.candidates=1", "excitation.clearance=off"]
    experiment = tb.Experiment.from_toml(tmp_path / "r.toml", words)
    run = evaluate(experiment, tb.record(experiment))
    assert 0 < run.metrics["wrench_max_z"] < MOST_SIGMAS
