"""What a copy of a model brings along, and meshes that kill their readers."""

from __future__ import annotations

import os
import struct
from pathlib import Path

import pytest

import testbed as tb
from testbed.bodies.shapes.appearance import load_shapes
from testbed.core.base.diagnostics import sentences
from testbed.core.base.errors import ModelError
from testbed.core.robot.model_file import copy_model
from tests.helpers.refusals import refuses

LINK = (
    '<link name="{name}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" '
    'ixz="0" iyz="0"/></inertial>{more}</link>'
)
VISUAL = '<visual><geometry><mesh filename="{}"/></geometry></visual>'
JOINT = (
    '<joint name="j" type="revolute"><parent link="base"/><child link="arm"/>'
    '<axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="9" velocity="2"/></joint>'
)
STL = b"\0" * 80 + struct.pack("<I12fH", 1, *[0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0], 0)
SECRET = "SECRET"
KINDS = ("stl", "obj", "dae", "ply", "msh", "off", "glb", "gltf")
ITSELF = (
    '<COLLADA version="1.4.1"><library_nodes><node id="a"><instance_node url="#a"/></node>'
    '</library_nodes><library_visual_scenes><visual_scene id="s"><node><instance_node url="#a"/>'
    '</node></visual_scene></library_visual_scenes><scene><instance_visual_scene url="#s"/></scene>'
    "</COLLADA>"
)


def robot(path: Path, *meshes: str) -> Path:
    """A URDF of one arm that refers to meshes."""
    path.parent.mkdir(parents=True, exist_ok=True)
    more = "".join(map(VISUAL.format, meshes))
    links = LINK.format(name="base", more="") + LINK.format(name="arm", more=more)
    path.write_text(f'<robot name="r">{links}{JOINT}</robot>')
    return path


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_of_a_home_folder_goes_along(kind: str, tmp_path: Path) -> None:
    """Through a link, by a path upwards, by another ending: all are named, none is copied."""
    home, load = tmp_path / "home", tmp_path / "load"
    home.mkdir()
    (home / "key").write_text(SECRET)
    (home / f"scan.{kind}").write_text(f"solid {SECRET}\nfacet\n")
    names = [f"link.{kind}", "notes.txt", f"../home/scan.{kind}", f"scan.{kind}"]
    path = robot(load / "r.urdf", *names)
    (load / names[0]).symlink_to(home / "key")
    (load / names[1]).write_text(SECRET)
    (load / names[3]).symlink_to(home / names[3])
    copy = copy_model(path, tmp_path / "out/copy")
    assert [each for each in (tmp_path / "out/copy").rglob("*") if each.is_file()] == [copy]
    assert any(names[0] in line for line in sentences(tb.load_tree(path).diagnostics))
    assert not tb.load_tree(copy).diagnostics


@pytest.mark.parametrize("package", [True, False])
def test_meshes_in_their_usual_place_go_along(package: bool, tmp_path: Path) -> None:
    """Beside the model, in a folder beside its own, of a package."""
    top = tmp_path / "arm"
    names = ["own.stl", "../meshes/part.stl"]
    if package:
        names += ["../../deep/part.stl", "package://arm/any/part.stl"]
        top.mkdir()
        (top / "package.xml").write_text("<package/>")
    path = robot(top / "urdf/r.urdf" if not package else top / "a/b/r.urdf", *names)
    places = [path.parent / name for name in names[: 3 if package else 2]]
    places += [top / "any/part.stl"] * package
    for place in places:
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(STL)
    copy_model(path, tmp_path / "out/copy")
    assert len(list((tmp_path / "out/copy").rglob("*.stl"))) == len(names)
    assert not tb.load_tree(path).diagnostics


def test_a_mesh_that_kills_or_blocks_its_reader_is_left_out(tmp_path: Path) -> None:
    """Named in the diagnostics; what can be read is drawn."""
    path = robot(tmp_path / "r.urdf", "good.stl", "self.dae", "pipe.obj")
    (tmp_path / "good.stl").write_bytes(STL)
    (tmp_path / "self.dae").write_text(ITSELF)
    (tmp_path / "pipe.obj").write_text("mtllib\tm.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    os.mkfifo(tmp_path / "m.mtl")
    seen = load_shapes(path, tb.load_tree(path))
    assert len(seen.shapes) == 1
    said = " ".join(sentences(seen.diagnostics))
    assert "self.dae" in said
    assert "pipe.obj" in said
    assert "good.stl" not in said


def test_a_pipe_as_a_mesh_of_mjcf_is_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "p.stl")
    (tmp_path / "r.xml").write_text(
        '<mujoco><asset><mesh name="m" file="p.stl"/></asset><worldbody><body><joint/>'
        '<geom type="mesh" mesh="m" mass="1"/></body></worldbody></mujoco>'
    )
    with refuses(ModelError, "p.stl"):
        tb.load_tree(tmp_path / "r.xml")
