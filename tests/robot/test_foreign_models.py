"""Other people's model files: what they may leave out, and what no plant may hide."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

import testbed as tb
from testbed.errors import ModelError
from testbed.robot.model_file import ModelFile
from testbed.simulation.build import build_plant
from tests.helpers.paths import ROOT

ARM = """<mujoco model="arm"><compiler angle="radian" {compiler}/><option {option}>{flags}</option>
<worldbody>{around}<body name="up"><joint name="j1" axis="0 0 1" range="-2 2" {joint}/>
<inertial mass="2" pos=".1 0 .2" diaginertia=".1 .1 .05"/>
<body name="fore" pos="0 0 .5"><joint name="j2" axis="0 1 0" range="-2 2"/>
<inertial mass="1" pos="0 .1 .2" diaginertia=".05 .05 .02" {inertial}/>
<body name="tool" pos="0 0 .4"><geom size=".05" mass=".5"/></body></body></body>{beside}</worldbody>
{more}</mujoco>"""


def arm(path: Path, **parts: str) -> Path:
    words = ("compiler", "option", "flags", "around", "joint", "inertial", "beside", "more")
    path.write_text(ARM.format(**dict.fromkeys(words, "") | parts))
    return path


def masses(tree: tb.Tree) -> list[float]:
    return [round(inertia.mass, 12) for inertia in tree.inertias]


def test_links_without_names_keep_their_own_masses(tmp_path: Path) -> None:
    text = arm(tmp_path / "r.xml").read_text()
    for name in ("up", "fore", "tool", "j1", "j2"):
        text = text.replace(f'name="{name}"', "")
    (tmp_path / "r.xml").write_text(text)
    tree = tb.load_tree(tmp_path / "r.xml")
    assert masses(tree) == [2.0, 1.5]
    assert len(set(tree.names)) == 2
    build_plant(ModelFile(tmp_path / "r.xml"), tree, 1e-3)


def test_fused_links_keep_what_they_weigh(tmp_path: Path) -> None:
    path = arm(tmp_path / "r.xml", compiler='fusestatic="true"')
    assert masses(tb.load_tree(path)) == [2.0, 1.5]


@pytest.mark.parametrize("mass", [7.0, 0.5])
@pytest.mark.parametrize("also", ["", 'inertiafromgeom="true"', 'balanceinertia="true"'])
def test_a_total_mass_set_by_the_compiler_is_the_robots(
    also: str, mass: float, tmp_path: Path
) -> None:
    """MuJoCo's own compiler is the witness."""
    parts = {"compiler": f'settotalmass="{mass}" {also}', "inertial": ""}
    path = arm(tmp_path / "r.xml", **parts)
    if "fromgeom" in also:
        with_geoms = re.sub("(<inertial[^>]*>)", r'\1<geom size=".04" mass="1"/>', path.read_text())
        path.write_text(with_geoms)
    model = mujoco.MjModel.from_xml_path(str(path))
    tree = tb.load_tree(path)
    own = [model.body("up").subtreemass[0] - model.body("fore").subtreemass[0]]
    own.append(model.body("fore").subtreemass[0])
    np.testing.assert_allclose([body.mass for body in tree.inertias], own, rtol=1e-12)
    assert sum(own) == pytest.approx(mass)
    build_plant(ModelFile(path), tree, 1e-3)


def test_flags_of_the_file_are_those_of_the_tree(tmp_path: Path) -> None:
    parts = {
        "flags": '<flag gravity="disable" frictionloss="disable"/>',
        "joint": 'frictionloss="2" damping="1"',
    }
    tree = tb.load_tree(arm(tmp_path / "r.xml", **parts))
    assert not tree.gravity.any()
    assert (tree.joints[0].coulomb, tree.joints[0].viscous) == (0.0, 1.0)
    build_plant(ModelFile(tmp_path / "r.xml"), tree, 1e-3)


def test_the_narrower_effort_limit_counts(tmp_path: Path) -> None:
    path = arm(tmp_path / "r.xml", joint='actuatorfrcrange="-2 60"')
    assert tb.load_tree(path).joints[0].max_effort == 2.0


def test_room_for_postures_and_bodies_to_be_dragged_do_no_harm(tmp_path: Path) -> None:
    marker = '<body name="marker" mocap="true" pos="1 0 0"><geom size=".1"/></body>'
    path = arm(tmp_path / "r.xml", around=marker, more='<size nkey="3"/>')
    tree = tb.load_tree(path)
    assert masses(tree) == [2.0, 1.5]
    build_plant(ModelFile(path), tree, 1e-3)


TENDON = '<tendon><fixed name="t" {}><joint joint="j1" coef="1"/></fixed></tendon>'
HIDDEN = {
    "spring": {"joint": 'stiffness="5" springref="1"'},
    "oscillator": {"joint": 'springdamper="0.1 0.7"'},
    "damping of a higher order": {"joint": 'damping="1 2 3"'},
    "tendon spring": {"more": TENDON.format('stiffness="9" springlength="0.3"')},
    "tendon damper": {"more": TENDON.format('damping="3"')},
    "tendon inertia": {"more": TENDON.format('armature="3"')},
    "tendon's end": {"more": TENDON.format('range="-.1 .1"')},
    "compensated gravity": {"fore": 'gravcomp="1"'},
    "fluid": {"option": 'density="1000" viscosity="2"'},
}


@pytest.mark.parametrize("what", HIDDEN)
def test_what_else_acts_on_the_robot_is_left_out_and_said(what: str, tmp_path: Path) -> None:
    """The plant is the robot that was read, which is the one of the file without it."""
    parts = dict(HIDDEN[what])
    fore = parts.pop("fore", "")
    path = arm(tmp_path / "r.xml", **parts)
    path.write_text(path.read_text().replace('name="fore"', f'name="fore" {fore}'))
    tree = tb.load_tree(path)
    assert [line.startswith("left out: ") for line in tree.warnings] == [True]
    assert masses(tree) == [2.0, 1.5]
    build_plant(ModelFile(path), tree, 1e-3)


def test_an_arm_beside_the_plate_is_refused(tmp_path: Path) -> None:
    other = (
        '<body name="other" pos="1 0 0"><joint name="j3" axis="0 1 0"/>'
        '<inertial mass="1" pos="0 0 .1" diaginertia=".1 .1 .1"/></body></worldbody>'
    )
    text = (ROOT / "models/puma562.xml").read_text().replace("</worldbody>", other)
    (tmp_path / "r.xml").write_text(text)
    with pytest.raises(ModelError, match="does every arm stand on the sensor"):
        build_plant(ModelFile(tmp_path / "r.xml"), tb.load_tree(tmp_path / "r.xml"), 1e-3)


def test_a_clipped_sensor_is_refused(tmp_path: Path) -> None:
    text = (ROOT / "models/puma562.xml").read_text()
    text = text.replace('<force name="bedplate_force"', '<force cutoff="50" name="bedplate_force"')
    (tmp_path / "r.xml").write_text(text)
    with pytest.raises(ModelError, match="is it unfiltered"):
        build_plant(ModelFile(tmp_path / "r.xml"), tb.load_tree(tmp_path / "r.xml"), 1e-3)


WRONG = {
    "axis": ('axis="0 0 1"', 'axis="nan 0 0"'),
    "place": ('pos="0 0 .5"', 'pos="nan 0 .5"'),
    "centre": ('pos="0 .1 .2"', 'pos="0 nan .2"'),
    "gravity": ("<option ", '<option gravity="0 0 nan" '),
    "friction": ('range="-2 2" ', 'range="-2 2" frictionloss="-1" '),
    "name of a limit": (
        "<worldbody>",
        '<custom><numeric name="velocity_limit/j9" data="1"/></custom><worldbody>',
    ),
}


@pytest.mark.parametrize("what", WRONG)
def test_numbers_no_robot_can_have_are_refused(what: str, tmp_path: Path) -> None:
    path = arm(tmp_path / "r.xml")
    path.write_text(path.read_text().replace(*WRONG[what], 1))
    with pytest.raises(ModelError) as caught:
        tb.load_tree(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('xyz="0 0 0.6718"', 'xyz="0 0 nan"'),
        ('<axis xyz="0 0 1"/>', '<axis xyz="0 0 0"/>'),
        ('lower="-2.793" upper="2.793"', 'lower="3" upper="-3"'),
        ('<origin xyz="0 0.02 0.45"/>', '<origin xyz="0 nan 0.45"/>'),
        ('friction="6.3"', 'friction="-6.3"'),
        ('encoding="ascii"', 'encoding="foo"'),
    ],
)
def test_urdfs_no_robot_can_have_are_refused(old: str, new: str, tmp_path: Path) -> None:
    text = (ROOT / "models/puma562.urdf").read_text()
    text = text.replace('<?xml version="1.0"?>', '<?xml version="1.0" encoding="ascii"?>')
    assert old in text
    (tmp_path / "r.urdf").write_text(text.replace(old, new, 1))
    with pytest.raises(ModelError):
        tb.load_tree(tmp_path / "r.urdf")


def test_nothing_is_left_in_the_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """MuJoCo likes to leave MUJOCO_LOG.TXT."""
    path = arm(tmp_path / "r.xml")
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    tree = tb.load_tree(path)
    build_plant(ModelFile(path), tree, 1e-3)
    assert list((tmp_path / "here").iterdir()) == []
    assert np.isfinite(tree.gravity).all()
