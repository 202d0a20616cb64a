"""Models that are small on paper and large in memory, or that refer to what they should not."""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import partial
from itertools import pairwise

Files = dict[str, bytes]

LINK = (
    '<link name="b{k}"><inertial><mass value="1"/><origin xyz=".1 .1 .1"/><inertia ixx="1" '
    'iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>{more}</link>'
)
JOINT = (
    '<joint name="j{k}" type="{kind}"><parent link="b{parent}"/><child link="b{k}"/>'
    '<origin xyz=".1 .2 .3"/><axis xyz="{axis}"/>'
    '<limit lower="-3" upper="3" effort="9" velocity="9"/></joint>'
)
AXES = ("1 0 0", "0 1 0", "0 0 1", "1 1 0")
LEAF = '<body pos="0 0 .1"><joint axis="0 1 0"/><geom size=".1" mass="1"/>{inside}</body>'
ITSELF = (
    b'<COLLADA version="1.4.1"><library_nodes><node id="a"><instance_node url="#a"/></node>'
    b'</library_nodes><library_visual_scenes><visual_scene id="s"><node><instance_node url="#a"/>'
    b"</node></visual_scene></library_visual_scenes>"
    b'<scene><instance_visual_scene url="#s"/></scene></COLLADA>'
)
"""A DAE whose node is part of itself: recursion without end in assimp."""


def urdf(parents: list[int], kind: str = "revolute", more: str = "") -> Files:
    """A URDF tree: the parent of each body, the bedplate being 0."""
    text = ['<robot name="bomb"><link name="b0"/>']
    for k, parent in enumerate(parents, start=1):
        text.append(LINK.format(k=k, more=more))
        text.append(JOINT.format(k=k, parent=parent, kind=kind, axis=AXES[k % 4]))
    return {"model.urdf": "".join([*text, "</robot>"]).encode()}


def mjcf(inside: str, head: str = "") -> Files:
    """An MJCF of one arm, and what else."""
    arm = LEAF.format(inside="")
    text = f'<mujoco model="bomb">{head}<worldbody>{arm}{inside}</worldbody></mujoco>'
    return {"model.xml": text.encode()}


def _laughs() -> Files:
    names = [f"e{k}" for k in range(12)]
    entities = ['<!ENTITY e0 "ha">']
    entities += [f'<!ENTITY {b} "{f"&{a};" * 10}">' for a, b in pairwise(names)]
    return {"model.urdf": f'<!DOCTYPE robot [{"".join(entities)}]><robot name="&e11;"/>'.encode()}


def _attributes() -> Files:
    many = "".join(f' a{k}="1"' for k in range(100_000))
    return {"model.urdf": f'<robot{many} name="r"/>'.encode()}


def _long_name() -> Files:
    text = urdf([0, 1])["model.urdf"]
    return {"model.urdf": text.replace(b'"j1"', b'"' + b"j" * 1_000_000 + b'"')}


def _urdf_mesh(name: str, data: bytes | None = None) -> Files:
    more = f'<visual><geometry><mesh filename="{name}"/></geometry></visual>'
    robot = urdf([0, 1], more=more + more.replace("visual", "collision"))
    return robot if data is None else {**robot, name: data}


def _mjcf_mesh(how: str, **files: bytes) -> Files:
    robot = mjcf(
        '<body><joint axis="1 0 0"/><geom type="mesh" mesh="m"/></body>',
        f'<asset><mesh name="m" {how}/></asset>',
    )
    return robot | {name.replace("_", "."): data for name, data in files.items()}


def _nested_bodies(depth: int) -> Files:
    inside = ""
    for _ in range(depth):
        inside = LEAF.format(inside=inside)
    return mjcf(inside)


def _in_a_row(files: int, inside: str, head: str) -> Files:
    """Files that each hold the next; the last is one body that carries its joint."""
    last = '<mujoco><worldbody><body name="b"><joint/><geom size="1"/></body></worldbody></mujoco>'
    names = ["model.xml", *(f"m{k}.xml" for k in range(files - 1))]
    held = {a: mjcf(inside, head.format(b))["model.xml"] for a, b in pairwise(names)}
    return {**held, names[-1]: last.encode()}


def _ten_each(files: int) -> Files:
    """Models that each hold the next ten times."""
    assets = "".join(f'<model name="m{k}" file="{{0}}"/>' for k in range(10))
    held = (f'<frame><attach model="m{k}" body="b" prefix="p{k}"/></frame>' for k in range(10))
    body = f'<body name="b"><joint/><geom size="1"/>{"".join(held)}</body>'
    return _in_a_row(files, body, f"<asset>{assets}</asset>")


MESHES = {
    "a mesh that is a device": ("/dev/zero", None),
    "a mesh that is a folder": ("/", None),
    "a mesh from a network": ("http://127.0.0.1:9/x.stl", None),
    "a mesh of a package": ("package://nowhere/x.stl", None),
    "a mesh of four thousand million triangles": ("m.stl", bytes(80) + b"\xff" * 4 + bytes(100)),
    "a scene that holds itself": ("m.dae", ITSELF),
    "materials that are a device": (
        "m.obj", b"mtllib /dev/zero\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
    ),
    **{
        f"a mesh that is {what}, .{kind}": (f"m.{kind}", data)
        for kind in ("stl", "obj", "dae", "ply", "glb", "off")
        for what, data in {"empty": b"", "noise": bytes(range(256)) * 40}.items()
    },
}  # fmt: skip
"""What a URDF names as a mesh, and its content."""

OWN = '<asset><model name="m" file="model.xml"/></asset>'
BODIES: dict[str, tuple[str, str]] = {
    "a file that includes itself": ('<include file="model.xml"/>', ""),
    "an asset that is itself": ("", OWN),
    "attached to itself": ('<body><attach model="m" prefix="p"/></body>', OWN),
    "a thousand million replicas": (
        '<replicate count="1000000000"><geom size="1"/></replicate>', "",
    ),
    "replicas of replicas": (
        '<replicate count="100">' * 5 + '<geom size="1"/>' + "</replicate>" * 5, "",
    ),
    "a large composite": (
        '<body><composite type="cable" count="100000 1 1" curve="s" size="1">'
        '<joint kind="main"/><geom type="capsule" size=".1"/></composite></body>', "",
    ),
    "a large grid": (
        '<flexcomp type="grid" count="300 300 300" spacing=".1 .1 .1" name="f" dim="3"/>', "",
    ),
    "a field of heights": (
        '<geom type="hfield" hfield="h"/>',
        '<asset><hfield name="h" nrow="100000" ncol="100000" size="1 1 1 1"/></asset>',
    ),
    "a large texture": (
        "", '<asset><texture name="t" type="2d" builtin="flat" width="60000" height="60000"/>'
        "</asset>",
    ),
    "a large arena": ("", '<size memory="1000G"/>'),
    "no end of user data": ("", '<size nuserdata="2000000000"/>'),
    "a plugin": ("", '<extension><plugin plugin="mujoco.elasticity.cable"/></extension>'),
    "a ball joint": ('<body><joint type="ball"/><geom size="1"/></body>', ""),
    "a free root": ("<body><freejoint/><geom size='1'/></body>", ""),
    "no time": ("", '<option timestep="0"/>'),
}  # fmt: skip
"""What an MJCF has in its world, and before it."""

BOMBS: dict[str, Callable[[], Files]] = {
    "a chain of 400 joints": lambda: urdf(list(range(400))),
    "a chain of 3000 joints": lambda: urdf(list(range(3000))),
    "400 sliding joints": lambda: urdf(list(range(400)), "prismatic"),
    "a bush of 200": lambda: urdf([0, *[1] * 199]),
    "3000 fixed joints": lambda: urdf(list(range(3000)), "fixed"),
    "floating joints": lambda: urdf([0, 1, 2], "floating"),
    "joints of no kind": lambda: urdf([0, 1, 2], "spring"),
    "a link that is its own parent": lambda: urdf([1]),
    "a circle of links": lambda: urdf([3, 1, 2]),
    "laughs": _laughs,
    "one name of a megabyte": _long_name,
    "a hundred thousand attributes": _attributes,
    **{name: partial(_urdf_mesh, *mesh) for name, mesh in MESHES.items()},
    **{name: partial(mjcf, *texts) for name, texts in BODIES.items()},
    "two files that include each other": lambda: {
        **mjcf('<include file="other.xml"/>'),
        "other.xml": b'<mujoco><include file="model.xml"/></mujoco>',
    },
    "8 files in a row": lambda: _in_a_row(8, "", '<include file="{}"/>'),
    "9 files in a row": lambda: _in_a_row(9, "", '<include file="{}"/>'),
    "two models of ten each": lambda: _ten_each(3),
    "seven models of ten each": lambda: _ten_each(8),
    "a mesh of MJCF that is a device": lambda: _mjcf_mesh('file="/dev/zero"'),
    "a mesh of MJCF with faces beyond its corners": lambda: _mjcf_mesh(
        'file="m.msh"', m_msh=struct.pack("<4i12f3i", 4, 0, 0, 1, *range(12), -5, 1 << 30, 2)
    ),
    "a mesh of nonsense": lambda: _mjcf_mesh('vertex="0 0 0 1 0 0 nan 1 0 0 0 1"'),
    "a mesh of subdivision": lambda: _mjcf_mesh('builtin="supersphere" params="3000 1 1"'),
    "1000 bodies deep": lambda: _nested_bodies(1000),
    "30 bodies deep": lambda: _nested_bodies(30),
    "nothing": lambda: {"model.xml": b""},
    "zeros": lambda: {"model.xml": bytes(10_000_000)},
}
