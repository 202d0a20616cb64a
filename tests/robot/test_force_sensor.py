"""A force sensor anywhere in a robot: what lies beyond its cut, what it feels, what it identifies.

If one fails, parameters by a wrist, hip or shoulder sensor are wrong.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import testbed as tb
from testbed.core.base.arrays import Array
from testbed.core.base.errors import ModelError, RecordingError, UnknownName
from testbed.core.dynamics.newton_euler import poses
from testbed.core.dynamics.rank_check import verify_minimal_set
from testbed.core.recordings.views import adapt_to_robot
from testbed.core.robot.force_sensor import ForceSensor, tree_before_sensors, tree_beyond_sensor
from testbed.core.robot.free_base import N_BASE_COORDINATES
from testbed.core.robot.free_root import with_free_base
from testbed.core.robot.model_file import ModelFile
from testbed.lab.experiment.evaluate import evaluate
from testbed.lab.experiment.experiment import Experiment
from testbed.lab.experiment.rig import sensed_robot
from tests.helpers.paths import ROOT
from tests.helpers.refusals import refuses
from tests.helpers.sensors import links_of, random_cut, random_sensors
from tests.helpers.strategies import Rng, few, motions, rngs, trees

URDF = ROOT / "models/puma562.urdf"


@few(25)
@given(st.data(), rngs)
def test_it_feels_what_carries_the_bodies_beyond_it(data: st.DataObject, rng: Rng) -> None:
    """The wrench on the ground of the same bodies alone, carried to the sensor by hand."""
    cut = random_cut(data.draw(trees((1, 7))), rng)
    motion = data.draw(motions(cut))
    assert cut.sensor is not None
    ground = tb.base_wrench(replace(cut, sensor=None, lead=0), motion)
    X_WB = poses(cut, motion.q)[cut.lead - 1]
    turn, place = X_WB.R_AB, X_WB.p_AB_A
    place = place + turn @ cut.sensor.position
    turn = turn @ cut.sensor.rotation
    moment = ground[:, 3:] - np.cross(place, ground[:, :3])
    expected = [np.einsum("mji,mj->mi", turn, part) for part in (ground[:, :3], moment)]
    found = tb.base_wrench(cut, motion)
    np.testing.assert_allclose(found, np.hstack(expected), atol=1e-10 * np.abs(found).max())


@few(25)
@given(trees((1, 8), bare=True), st.booleans(), rngs)
def test_three_witnesses_agree_on_its_minimal_set(tree: tb.Tree, free: bool, rng: Rng) -> None:
    """Rules, recursion and sampled rows, on cuts of random robots, on bases that move as well."""
    if free:
        link = tree.joints[rng.integers(tree.n)].body
        cut = tree_beyond_sensor(with_free_base(tree), links_of(tree), ForceSensor(link))
    else:
        cut = random_cut(tree, rng)
    for tared in (False, True):
        found = verify_minimal_set(cut, tb.minimal_set(cut, "wrench", tared=tared))
        assert found.agrees, found


def test_a_cut_within_a_body_leaves_what_is_fixed_beyond(tmp_path: Path) -> None:
    """A tool welded to the last link; and a humanoid's hand by way of its base's coordinates."""
    tool = """<link name="tool"><inertial><mass value="1.5"/><origin xyz="0 0 0.1"/>
      <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
      <joint name="weld" type="fixed"><parent link="link3"/><child link="tool"/>
      <origin xyz="0 0 0.4"/></joint></robot>"""
    file = tmp_path / "tool.urdf"
    file.write_text(URDF.read_text().replace("</robot>", tool))
    model = ModelFile(file)
    tree = model.tree()
    cut = tree_beyond_sensor(tree, model.links(), ForceSensor("tool"))
    assert [body.mass for body in cut.inertias] == [0, 0, 1.5]
    np.testing.assert_allclose(cut.inertias[2].com, [0, 0, 0.5])
    np.testing.assert_allclose(cut.sensor.position, [0, 0, 0.4])  # type: ignore[union-attr]
    free = tree_beyond_sensor(with_free_base(tree), model.links(), ForceSensor("tool"))
    assert (free.lead, free.n) == (N_BASE_COORDINATES + 3, N_BASE_COORDINATES + 3)


def test_links_that_are_not_there_and_the_root_are_refused() -> None:
    model = ModelFile(URDF)
    for link, kind in (("link9", UnknownName), (model.links()[0].name, ModelError)):
        with pytest.raises(kind):
            tree_beyond_sensor(model.tree(), model.links(), ForceSensor(link))
    for words in (["robot.sensor=link9"], ["sensors.other.link=link9", "robot.sensor=''"]):
        with pytest.raises(UnknownName):
            tb.record(Experiment.from_toml(ROOT / "experiments/force_sensor.toml", words))


@pytest.mark.parametrize("about", ["base", "link2", "link3", "plate"])
@pytest.mark.parametrize("farther", [False, True], ids=["alone", "before-others"])
def test_mujocos_own_sensors_give_the_parameters_to_rounding(about: str, farther: bool) -> None:
    """Simulated with MuJoCo's sensors at the cuts, exact kinematics, no noise."""
    links = {"base", "link2", "link3"} if farther else {about} - {"plate"}
    words = [f"sensors.{each}.position=[0.01, 0.02, -0.03]" for each in links]
    words += [f"sensors.{each}.rpy=[0.1, -0.2, 0.3]" for each in links]
    words += ["motion.duration=4", "simulation.step=1e-3", "simulation.friction=false"]
    words += ["identification.zeros=false", f"robot.sensor={about}"]
    experiment = Experiment.from_toml(ROOT / "experiments/noise_free.toml", words)
    assert set(experiment.force_sensors) == links
    if about == "plate" and farther:  # all that moves lies beyond the first sensor
        with pytest.raises(ModelError):
            sensed_robot(experiment)
        return
    run = evaluate(experiment, tb.record(experiment), methods=("wrench",))
    assert run.score is not None
    assert run.score.metrics["wrench_max_relative_error"] < 1e-10


@few(25)
@given(st.data(), rngs)
def test_between_two_sensors_is_the_difference_of_wrenches(data: st.DataObject, rng: Rng) -> None:
    """Of one plate or sensor less the next, in a recording: the wrench of the bodies between."""
    tree = data.draw(trees((2, 7)))
    motion, links, sensors = data.draw(motions(tree)), links_of(tree), random_sensors(tree, rng)
    part = {"": tree} | {each.name: tree_beyond_sensor(tree, links, each) for each in sensors}

    def felt(some: tb.Tree) -> Array:
        own = [tree.index(name) for name in some.names]
        columns = (each[:, own] for each in (motion.q, motion.qd, motion.qdd))
        return tb.base_wrench(some, tb.Motion(motion.t, *columns))

    recording = tb.Recording(
        tree.names,
        motion.t,
        motion.q,
        wrench=felt(tree),
        sensors=np.hstack([felt(part[each.name]) for each in sensors]),
        sensor_names=tuple(each.name for each in sensors),
    )
    for own in (None, *sensors):
        others = [each for each in sensors if each is not own]
        between = (
            tree_beyond_sensor(tree, links, own, others)
            if own
            else tree_before_sensors(tree, links, others)
        )
        found = adapt_to_robot(recording, between)
        size = np.abs(felt(part[own.name if own else ""])).max()
        assert found.wrench is not None
        np.testing.assert_allclose(found.wrench, felt(between), atol=1e-9 * size)
        assert adapt_to_robot(found, between) is found


def test_a_recording_keeps_what_moves_the_sensor() -> None:
    """Other joints' columns go, temperatures and torques, too; a joint that lacks is named."""
    model = ModelFile(URDF)
    tree = tree_beyond_sensor(model.tree(), model.links(), ForceSensor("link1"))
    other = tree_beyond_sensor(model.tree(), model.links(), ForceSensor("base"))
    names = ("spare", *reversed(tree.names))
    q = np.arange(12.0).reshape(3, 4)
    recording = tb.Recording(
        names, np.arange(3.0), q, torque=q, wrench=np.zeros((3, 6)), temperature=q
    )
    found = adapt_to_robot(recording, tree)
    assert (found.names, found.signals) == (tree.names, ("time", "position", "wrench"))
    np.testing.assert_array_equal(found.part(0, 3).position, q[:, :0:-1])
    with refuses(RecordingError, other.names[0]):
        adapt_to_robot(replace(recording, names=("a", "b", "c", "d")), other)
