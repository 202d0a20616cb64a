"""Recordings that the project has not made: Pinocchio reads the URDF and inverts the dynamics.

The root link is put onto a free joint that rests: what holds it is the plate's wrench. Masses and
centres are changed in the URDF before Pinocchio reads it, so that the robot is not the file's.
Friction, noise and a 17-bit encoder are added here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

import testbed as tb
from testbed.core.base.arrays import Array
from tests.helpers.paths import GOLDEN, REAL, ROOT

FINGERS = ("panda_finger_joint1", "panda_finger_joint2")
ROBOTS: Mapping[str, tuple[Path, tuple[str, ...]]] = {
    "puma562": (ROOT / "models/puma562.urdf", ()),
    "ur5": (GOLDEN / "robots/ur5.urdf", ()),
    "xarm7": (REAL / "xarm_description/urdf/xarm7.urdf", ()),
    "panda": (REAL / "panda_description/urdf/panda.urdf", FINGERS),
    "kinova": (REAL / "kinova_description/robots/kinova.urdf", ()),
    "scara": (GOLDEN / "robots/scara_rrpr.urdf", ()),
    "gantry": (GOLDEN / "robots/gantry_ppp_rrr.urdf", ()),
    "tree": (GOLDEN / "robots/random_tree_08.urdf", ()),
}
"""Model files, and joints that are held."""

RATE, SECONDS = 500.0, 30.0

ROUGH, OFF = 0.15, 0.02
"""Relative error of the file's masses, and of its centres of mass [m]."""

ENCODER = 2 * np.pi / 2**17
"""Least step of a position [rad or m]."""


@dataclass(frozen=True, eq=False)
class Truth:
    """A robot as its file has it, and what was measured of the real one.

    Attributes:
        tree: By the file.
        position: By encoders, (M, n) [rad or m].
        torque: With friction and noise, (M, n) [N m or N].
        wrench: Of the plate on the robot without its pedestal, with noise, (M, 6) [N, N m].
        weight: Mean vertical force [N].
    """

    tree: tb.Tree
    position: Array
    torque: Array
    wrench: Array
    weight: float


def tree_of(name: str) -> tb.Tree:
    """One of `ROBOTS`."""
    path, held = ROBOTS[name]
    return tb.load_tree(path, lock=dict.fromkeys(held))


def truth(
    name: str, seed: int, *, late: float = 0.0, seconds: float = SECONDS,
    moving: Sequence[int] | None = None,
) -> Truth:  # fmt: skip
    """A recording of a robot that is somewhat heavier or lighter than its file.

    Args:
        name: One of `ROBOTS`.
        seed: Of the robot, its motion and the noise.
        late: The plate shows what was so long ago [s].
        seconds: Duration.
        moving: Joints that move; all if that is not said.
    """
    rng = np.random.default_rng(seed)
    tree = tree_of(name)
    model = on_a_free_base(real_robot(*ROBOTS[name], rng, ROUGH, OFF))
    motion = _motion(tree, rng)
    if moving is not None:
        motion[1][[k for k in range(tree.n) if k not in moving]] = 0
    t = np.arange(round(RATE * seconds)) / RATE
    q, qd, qdd = states(*motion, t)
    torque, exact = inverse(model, tree.names, q, qd, qdd)
    if late:
        exact = inverse(model, tree.names, *states(*motion, t - late))[1]
    size = np.abs(torque).max(axis=0)
    weight = float(np.abs(exact[:, 2]).mean())
    friction = 0.1 * size * np.tanh(qd / 0.01) + 0.1 * size * qd
    noise = weight * np.repeat([2e-3, 5e-4], 3)
    return Truth(
        tree,
        np.round((q + rng.normal(size=q.shape) * 2e-5) / ENCODER) * ENCODER,
        torque + friction + 0.01 * size * rng.normal(size=torque.shape),
        exact + noise * rng.normal(size=exact.shape),
        weight,
    )


def real_robot(
    path: Path, held: Sequence[str], rng: np.random.Generator, rough: float, off: float
) -> ElementTree.Element:
    """A robot's URDF, its masses and centres changed: bodies without shapes, a base without mass.

    What is welded to the base weighs nothing: it is the pedestal's. About the centre, inertias
    keep their shape.

    Args:
        path: The URDF.
        held: Joints that are held at zero.
        rng: Of the changes.
        rough: Standard deviation of masses, relative.
        off: Of centres, along each axis [m].
    """
    robot = ElementTree.parse(path).getroot()
    links = {str(link.get("name")): link for link in robot.findall("link")}
    joints = robot.findall("joint")
    ends = {j: (_link(j, "parent"), _link(j, "child")) for j in joints}
    for joint in joints:
        if joint.get("name") in held:
            joint.set("type", "fixed")
    base = {_root(robot)}
    for _ in joints:
        fixed = (ends[joint] for joint in joints if joint.get("type") == "fixed")
        base |= {child for parent, child in fixed if parent in base}
    for link in links.values():
        for shown in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shown)
        _change(link, link.get("name") in base, rng, rough, off)
    for other in [each for each in robot if each.tag not in ("link", "joint")]:
        robot.remove(other)
    return robot


def on_a_free_base(robot: ElementTree.Element) -> pin.Model:
    """Pinocchio's model of `real_robot` on a free joint.

    Args:
        robot: The URDF.
    """
    text = ElementTree.tostring(robot, encoding="unicode")
    return pin.buildModelFromXML(text, pin.JointModelFreeFlyer())


def _root(robot: ElementTree.Element) -> str:
    """The link that no joint carries."""
    carried = {_link(joint, "child") for joint in robot.iterfind("joint")}
    (root,) = {str(link.get("name")) for link in robot.iterfind("link")} - carried
    return root


def _link(joint: ElementTree.Element, end: str) -> str:
    return str(joint.findall(end)[0].get("link"))


def _change(
    link: ElementTree.Element, still: bool, rng: np.random.Generator, rough: float, off: float
) -> None:
    """Another mass and centre of a link; none of one that stands still."""
    inertial = link.find("inertial")
    if inertial is None:
        return
    mass, inertia = inertial.find("mass"), inertial.find("inertia")
    if still or mass is None or inertia is None or not float(mass.get("value", 0)):
        link.remove(inertial)
        return
    factor = max(0.3, 1 + rough * rng.normal())
    mass.set("value", repr(factor * float(mass.get("value", 0))))
    inertia.attrib |= {key: repr(factor * float(value)) for key, value in inertia.attrib.items()}
    origin = inertial.find("origin")
    if origin is None:
        origin = ElementTree.SubElement(inertial, "origin", xyz="0 0 0")
    centre = np.array((origin.get("xyz") or "0 0 0").split(), float) + off * rng.normal(size=3)
    origin.set("xyz", " ".join(map(repr, centre.tolist())))


def _motion(tree: tb.Tree, rng: np.random.Generator) -> tuple[Array, Array, Array, Array]:
    """Middles (n,), sizes (n, 4), phases (n, 4) and waves (4,) of sines within the ranges."""
    low, high = np.clip([joint.position_range for joint in tree.joints], -2.5, 2.5).T
    wave = 2 * np.pi * 0.1 * np.array([1, 2, 3, 5])
    size = rng.uniform(0.3, 1, (tree.n, 4)) / [1, 1.5, 2, 3]
    size *= (1.2 * np.minimum(0.35 * (high - low), 0.8) / size.sum(axis=1))[:, None]
    return (low + high) / 2, size, rng.uniform(0, 2 * np.pi, (tree.n, 4)), wave


def states(
    middle: Array, size: Array, phase: Array, wave: Array, t: Array
) -> tuple[Array, Array, Array]:
    """Positions, velocities, accelerations, (M, n) each, of sums of sines.

    Args:
        middle: (n,) [rad or m].
        size: (n, k) [rad or m].
        phase: (n, k).
        wave: (k,) or (n, k) [rad/s].
        t: (M,) [s].
    """
    angle = wave * t[:, None, None] + phase
    return (
        middle + (size * np.sin(angle)).sum(axis=2),
        (size * wave * np.cos(angle)).sum(axis=2),
        (-size * wave**2 * np.sin(angle)).sum(axis=2),
    )


def inverse(
    model: pin.Model, names: Sequence[str], q: Array, qd: Array, qdd: Array,
    law: Callable[..., Array] = pin.rnea,
) -> tuple[Array, Array]:  # fmt: skip
    """Torques (M, n), and what holds a free base at rest, (M, 6): Pinocchio's inverse dynamics.

    Args:
        model: Of `on_a_free_base`.
        names: Of the joints, in the order of the columns.
        q: Positions, (M, n).
        qd: Velocities, (M, n).
        qdd: Accelerations, (M, n).
        law: Forces (nv,) of model, data, configuration, velocity and acceleration.
    """
    data, found = model.createData(), []
    joints = [model.joints[model.getJointId(name)] for name in names]
    where, fast, faster = pin.neutral(model), np.zeros(model.nv), np.zeros(model.nv)
    columns = [joint.idx_v for joint in joints]
    for position, fast[columns], faster[columns] in zip(q, qd, qdd, strict=True):
        for joint, angle in zip(joints, position, strict=True):
            turned = angle if joint.nq == 1 else (np.cos(angle), np.sin(angle))  # without limits
            where[joint.idx_q : joint.idx_q + joint.nq] = turned
        found.append(np.array(law(model, data, where, fast, faster)))
    forces = np.array(found)
    return forces[:, columns], forces[:, :6]
