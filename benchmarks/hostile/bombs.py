"""Models that are small on paper and large in memory, or that refer to what they should not."""

from __future__ import annotations

import struct
from collections.abc import Callable
from itertools import pairwise

LINK = (
    '<link name="b{k}"><inertial><mass value="1"/><origin xyz=".1 .1 .1"/><inertia ixx="1" '
    'iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>{more}</link>'
)
JOINT = (
    '<joint name="j{k}" type="{kind}"><parent link="b{parent}"/><child link="b{k}"/>'
    '<origin xyz=".1 .2 .3"/><axis xyz="{axis}"/>'
    '<limit lower="-3" upper="3" effort="9" velocity="9"/></joint>'
)
ITSELF = (
    b'<COLLADA version="1.4.1"><library_nodes><node id="a"><instance_node url="#a"/></node>'
    b'</library_nodes><library_visual_scenes><visual_scene id="s"><node><instance_node url="#a"/>'
    b"</node></visual_scene></library_visual_scenes>"
    b'<scene><instance_visual_scene url="#s"/></scene></COLLADA>'
)
"""A DAE whose node is part of itself: recursion without end in assimp."""
AXES = ("1 0 0", "0 1 0", "0 0 1", "1 1 0")
LEAF = '<body pos="0 0 .1"><joint axis="0 1 0"/><geom size=".1" mass="1"/>{inside}</body>'


def urdf(parents: list[int], kind: str = "revolute", more: str = "") -> bytes:
    """A URDF tree: the parent of each body, the bedplate being 0."""
    text = ['<robot name="bomb"><link name="b0"/>']
    for k, parent in enumerate(parents, start=1):
        text.append(LINK.format(k=k, more=more))
        text.append(JOINT.format(k=k, parent=parent, kind=kind, axis=AXES[k % 4]))
    return "".join([*text, "</robot>"]).encode()


def mjcf(inside: str, head: str = "") -> bytes:
    """An MJCF of one arm, and what else."""
    arm = LEAF.format(inside="")
    return f'<mujoco model="bomb">{head}<worldbody>{arm}{inside}</worldbody></mujoco>'.encode()


def _laughs() -> bytes:
    names = [f"e{k}" for k in range(12)]
    entities = ['<!ENTITY e0 "ha">']
    pairs = pairwise(names)
    entities += [f'<!ENTITY {b} "{f"&{a};" * 10}">' for a, b in pairs]
    return f'<!DOCTYPE robot [{"".join(entities)}]><robot name="&e11;"/>'.encode()


def _mesh(vertices: int) -> bytes:
    """A binary STL that promises more triangles than it has."""
    return b"\0" * 80 + struct.pack("<I", vertices) + b"\0" * 100


def _meshes(name: str) -> bytes:
    more = f'<visual><geometry><mesh filename="{name}"/></geometry></visual>'
    return urdf([0, 1], more=more + more.replace("visual", "collision"))


MESH = (
    '<asset><mesh name="m" {how}/></asset>',
    '<body><joint axis="1 0 0"/><geom type="mesh" mesh="m"/></body>',
)


def _mjcf_mesh(how: str) -> bytes:
    return mjcf(MESH[1], MESH[0].format(how=how))


def _nested_bodies(depth: int) -> bytes:
    inside = ""
    for _ in range(depth):
        inside = LEAF.format(inside=inside)
    return mjcf(inside)


def _in_a_row(files: int, inside: str, head: str) -> dict[str, bytes]:
    """Files that each hold the next; the last is one body that carries its joint."""
    last = '<mujoco><worldbody><body name="b"><joint/><geom size="1"/></body></worldbody></mujoco>'
    names = ["model.xml", *(f"m{k}.xml" for k in range(files - 1))]
    held = {a: mjcf(inside, head.format(b)) for a, b in pairwise(names)}
    return {**held, names[-1]: last.encode()}


def _ten_each(files: int) -> dict[str, bytes]:
    """Models that each hold the next ten times."""
    assets = "".join(f'<model name="m{k}" file="{{0}}"/>' for k in range(10))
    held = (f'<frame><attach model="m{k}" body="b" prefix="p{k}"/></frame>' for k in range(10))
    body = f'<body name="b"><joint/><geom size="1"/>{"".join(held)}</body>'
    return _in_a_row(files, body, f"<asset>{assets}</asset>")


Bomb = Callable[[], dict[str, bytes]]
BOMBS: dict[str, Bomb] = {
    "a chain of 20 joints": lambda: {"model.urdf": urdf(list(range(20)))},
    "a chain of 60 joints": lambda: {"model.urdf": urdf(list(range(60)))},
    "a chain of 150 joints": lambda: {"model.urdf": urdf(list(range(150)))},
    "a chain of 400 joints": lambda: {"model.urdf": urdf(list(range(400)))},
    "a chain of 3000 joints": lambda: {"model.urdf": urdf(list(range(3000)))},
    "400 sliding joints": lambda: {"model.urdf": urdf(list(range(400)), "prismatic")},
    "a star of 300": lambda: {"model.urdf": urdf([0] * 300)},
    "a bush of 200": lambda: {"model.urdf": urdf([0, *[1] * 199])},
    "3000 fixed joints": lambda: {"model.urdf": urdf(list(range(3000)), "fixed")},
    "floating joints": lambda: {"model.urdf": urdf([0, 1, 2], "floating")},
    "planar joints": lambda: {"model.urdf": urdf([0, 1, 2], "planar")},
    "joints of no kind": lambda: {"model.urdf": urdf([0, 1, 2], "spring")},
    "a link that is its own parent": lambda: {"model.urdf": urdf([1])},
    "a circle of links": lambda: {"model.urdf": urdf([3, 1, 2])},
    "laughs": lambda: {"model.urdf": _laughs()},
    "one name of a megabyte": lambda: {
        "model.urdf": urdf([0, 1]).replace(b'"j1"', b'"' + b"j" * 1_000_000 + b'"')
    },
    "a hundred thousand attributes": lambda: {
        "model.urdf": b"<robot "
        + b" ".join(b'a%d="1"' % k for k in range(100_000))
        + b' name="r"/>'
    },
    "a mesh that is a device": lambda: {"model.urdf": _meshes("/dev/zero")},
    "a mesh that is a folder": lambda: {"model.urdf": _meshes("/")},
    "a mesh from a network": lambda: {"model.urdf": _meshes("http://127.0.0.1:9/x.stl")},
    "a mesh of a package": lambda: {"model.urdf": _meshes("package://nowhere/x.stl")},
    **{
        f"a mesh that is {what}, .{kind}": lambda kind=kind, data=data: {  # type: ignore[misc]
            "model.urdf": _meshes(f"m.{kind}"),
            f"m.{kind}": data,
        }
        for kind in ("stl", "obj", "dae", "ply", "glb", "off")
        for what, data in {"empty": b"", "noise": bytes(range(256)) * 40}.items()
    },
    "a scene that holds itself": lambda: {"model.urdf": _meshes("m.dae"), "m.dae": ITSELF},
    "materials that are a device": lambda: {
        "model.urdf": _meshes("m.obj"),
        "m.obj": b"mtllib /dev/zero\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
    },
    "a mesh of MJCF with faces beyond its corners": lambda: {
        "model.xml": _mjcf_mesh('file="m.msh"'),
        "m.msh": struct.pack("<4i12f3i", 4, 0, 0, 1, *range(12), -5, 1 << 30, 2),
    },
    "a mesh of four thousand million triangles": lambda: {
        "model.urdf": _meshes("m.stl"),
        "m.stl": _mesh(0xFFFFFFFF),
    },
    "a file that includes itself": lambda: {"model.xml": mjcf('<include file="model.xml"/>')},
    "an asset that is itself": lambda: {
        "model.xml": mjcf("", '<asset><model name="m" file="model.xml"/></asset>')
    },
    "attached to itself": lambda: {
        "model.xml": mjcf(
            '<body><attach model="m" prefix="p"/></body>',
            '<asset><model name="m" file="model.xml"/></asset>',
        )
    },
    "two files that include each other": lambda: {
        "model.xml": mjcf('<include file="other.xml"/>'),
        "other.xml": b'<mujoco><include file="model.xml"/></mujoco>',
    },
    "two assets of each other": lambda: {
        "model.xml": mjcf("", '<asset><model name="m" file="other.xml"/></asset>'),
        "other.xml": mjcf("", '<asset><model name="m" file="model.xml"/></asset>'),
    },
    "8 files in a row": lambda: _in_a_row(8, "", '<include file="{}"/>'),
    "9 files in a row": lambda: _in_a_row(9, "", '<include file="{}"/>'),
    "two models of ten each": lambda: _ten_each(3),
    "seven models of ten each": lambda: _ten_each(8),
    "a thousand million replicas": lambda: {
        "model.xml": mjcf('<replicate count="1000000000"><geom size="1"/></replicate>')
    },
    "replicas of replicas": lambda: {
        "model.xml": mjcf('<replicate count="100">' * 5 + '<geom size="1"/>' + "</replicate>" * 5)
    },
    "half a million replicas": lambda: {
        "model.xml": mjcf('<replicate count="500000"><site size="1"/></replicate>')
    },
    "a large composite": lambda: {
        "model.xml": mjcf(
            '<body><composite type="cable" count="100000 1 1" curve="s" size="1">'
            '<joint kind="main"/><geom type="capsule" size=".1"/></composite></body>'
        )
    },
    "a large grid": lambda: {
        "model.xml": mjcf(
            '<flexcomp type="grid" count="300 300 300" spacing=".1 .1 .1" name="f" dim="3"/>'
        )
    },
    "a field of heights": lambda: {
        "model.xml": mjcf(
            '<geom type="hfield" hfield="h"/>',
            '<asset><hfield name="h" nrow="100000" ncol="100000" size="1 1 1 1"/></asset>',
        )
    },
    "a large texture": lambda: {
        "model.xml": mjcf(
            "",
            '<asset><texture name="t" type="2d" builtin="flat" width="60000" height="60000"/>'
            "</asset>",
        )
    },
    "a large arena": lambda: {"model.xml": mjcf("", '<size memory="1000G"/>')},
    "no end of user data": lambda: {"model.xml": mjcf("", '<size nuserdata="2000000000"/>')},
    "keys without end": lambda: {"model.xml": mjcf("", '<size nkey="2000000000"/>')},
    "a mesh of MJCF that is a device": lambda: {"model.xml": _mjcf_mesh('file="/dev/zero"')},
    "a mesh of MJCF that lies": lambda: {
        "model.xml": _mjcf_mesh('file="m.stl"'),
        "m.stl": _mesh(0xFFFFFFFF),
    },
    "a mesh of nonsense": lambda: {"model.xml": _mjcf_mesh('vertex="0 0 0 1 0 0 nan 1 0 0 0 1"')},
    "a mesh of many vertices": lambda: {
        "model.xml": _mjcf_mesh(f'vertex="{" ".join(str(k % 97) for k in range(300_000))}"')
    },
    "a mesh of subdivision": lambda: {
        "model.xml": _mjcf_mesh('builtin="supersphere" params="3000 1 1"')
    },
    "a plugin": lambda: {
        "model.xml": mjcf("", '<extension><plugin plugin="mujoco.elasticity.cable"/></extension>')
    },
    "1000 bodies deep": lambda: {"model.xml": _nested_bodies(1000)},
    "30 bodies deep": lambda: {"model.xml": _nested_bodies(30)},
    "a ball joint": lambda: {
        "model.xml": mjcf('<body><joint type="ball"/><geom size="1"/></body>')
    },
    "a free root": lambda: {"model.xml": mjcf("<body><freejoint/><geom size='1'/></body>")},
    "no time": lambda: {"model.xml": mjcf("", '<option timestep="0"/>')},
    "a script": lambda: {"model.xml": b"#!/bin/sh\nrm -rf ~\n"},
    "nothing": lambda: {"model.xml": b""},
    "zeros": lambda: {"model.xml": b"\0" * 10_000_000},
}
