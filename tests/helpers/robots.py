"""Random robots, each in three forms that share no code: URDF text, MJCF text, Tree.

Trees are branched, revolute and prismatic joints mixed, with axes that are aligned,
inclined, parallel or coaxial on purpose: the places where rules break.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from testbed.core.base.arrays import Array
from testbed.core.robot.inertia import Inertia
from testbed.core.robot.tree import Joint, JointKind, Tree


@dataclass(frozen=True)
class Link:
    """One joint and the link it carries."""

    name: str
    parent: int
    kind: JointKind
    axis: Array
    xyz: Array
    quaternion: Array  # (w, x, y, z)
    mass: float
    com: Array
    central: Array

    @property
    def turn(self) -> Rotation:
        """From its frame to its parent's."""
        return Rotation.from_quat(np.roll(self.quaternion, -1))


@dataclass(frozen=True)
class Robot:
    """A random robot with a pedestal."""

    links: tuple[Link, ...]
    pedestal: Link
    gravity: Array

    def tree(self) -> Tree:
        """Made directly."""
        return Tree(
            name="random",
            joints=tuple(
                Joint(
                    name=link.name,
                    body=f"{link.name}_body",
                    kind=link.kind,
                    parent=link.parent,
                    axis=link.axis,
                    offset=link.xyz,
                    rotation=link.turn.as_matrix(),
                )
                for link in self.links
            ),
            inertias=tuple(_inertia(link) for link in self.links),
            pedestal=_inertia(self.pedestal),
            gravity=self.gravity,
        )

    def urdf(self) -> str:
        """As URDF."""
        parts = ['<robot name="random">', _urdf_link("pedestal_body", self.pedestal)]
        for link in self.links:
            parent = self.links[link.parent].name if link.parent >= 0 else "pedestal"
            parts.append(_urdf_link(f"{link.name}_body", link))
            parts.append(
                f'<joint name="{link.name}" type="{link.kind}">'
                f'<parent link="{parent}_body"/><child link="{link.name}_body"/>'
                f'<origin xyz="{_text(link.xyz)}" rpy="{_text(link.turn.as_euler("xyz"))}"/>'
                f'<axis xyz="{_text(link.axis)}"/>'
                '<limit lower="-3" upper="3" effort="500" velocity="5"/></joint>'
            )
        return "\n".join([*parts, "</robot>"])

    def mjcf(self) -> str:
        """As MJCF."""
        body = (
            f'<body name="pedestal_body">{_mjcf_inertial(self.pedestal)}{self._bodies(-1)}</body>'
        )
        return (
            '<mujoco model="random"><compiler angle="radian"/>'
            f'<option gravity="{_text(self.gravity)}"/><worldbody>{body}</worldbody></mujoco>'
        )

    def _bodies(self, parent: int) -> str:
        return "".join(
            f'<body name="{link.name}_body" pos="{_text(link.xyz)}" '
            f'quat="{_text(link.quaternion)}">'
            f'<joint name="{link.name}" type="{"hinge" if link.kind == "revolute" else "slide"}" '
            f'axis="{_text(link.axis)}" range="-3 3" actuatorfrcrange="-500 500"/>'
            f"{_mjcf_inertial(link)}{self._bodies(k)}</body>"
            for k, link in enumerate(self.links)
            if link.parent == parent
        )


def random_robot(
    rng: np.random.Generator, n: int, *, gravity: Sequence[float] | Array = (0.0, 0.0, -9.81)
) -> Robot:
    """A random tree of n joints, with the special directions that rules are about."""
    links: list[Link] = []
    for k in range(n):
        parent = k - 1 if rng.random() < 0.7 else int(rng.integers(-1, k))
        kind: JointKind = "revolute" if rng.random() < 0.65 else "prismatic"
        links.append(_random_link(rng, f"j{k + 1}", parent, kind))
    return Robot(tuple(links), _random_link(rng, "pedestal", -1, "revolute"), np.array(gravity))


def random_states(rng: np.random.Generator, samples: int, n: int) -> tuple[Array, Array, Array]:
    """Positions, velocities, accelerations of order one, (samples, n) each."""
    q, qd, qdd = (rng.uniform(-1.5, 1.5, (samples, n)) for _ in range(3))
    return q, qd, qdd


def assert_same_tree(one: Tree, two: Tree, tolerance: float = 1e-12) -> None:
    """All that two trees hold, in whatever order their joints stand, each by its size."""
    order = [one.index(name) for name in two.names]
    for j, joint in zip(order, two.joints, strict=True):
        assert (*one.names, "")[one.parents[j]] == (*two.names, "")[joint.parent]
        for key, value in vars(joint).items():
            if isinstance(value, str):
                assert getattr(one.joints[j], key) == value
            elif key != "parent":
                found = getattr(one.joints[j], key)
                np.testing.assert_allclose(found, value, rtol=0, atol=tolerance)
    bodies = [(one.inertias[j], body) for j, body in zip(order, two.inertias, strict=True)]
    for left, right in (*bodies, (one.pedestal, two.pedestal)):
        size = np.abs(right.pseudo).max()
        np.testing.assert_allclose(left.pseudo, right.pseudo, rtol=0, atol=tolerance * (1 + size))
    np.testing.assert_allclose(one.gravity, two.gravity, rtol=0, atol=tolerance)


def with_zeros(rng: np.random.Generator, robot: Robot) -> Robot:
    """The same robot with bodies of which much is exactly zero.

    Centres of mass on axes and in planes, symmetric and plane bodies, rods, point masses
    and bodies without mass.
    """
    return replace(robot, links=tuple(_bared(rng, link) for link in robot.links))


def _bared(rng: np.random.Generator, link: Link) -> Link:
    shape = rng.choice(["any", "symmetric", "plane", "rod", "point", "massless"])
    if shape == "any":
        return link
    if shape == "massless":
        return replace(link, mass=0.0, com=np.zeros(3), central=np.zeros((3, 3)))
    com = link.com * (rng.random(3) < 0.4)
    a, b, c = rng.uniform(0.01, 0.1, 3) * link.mass
    central = {
        "symmetric": np.diag([a, a, b]),
        "plane": np.diag([a + b, a + c, b + c]),
        "rod": np.diag([a, a, 0.0]),
        "point": np.zeros((3, 3)),
    }[str(shape)]
    order = rng.permutation(3)
    return replace(link, com=com, central=central[np.ix_(order, order)])


def _random_link(rng: np.random.Generator, name: str, parent: int, kind: JointKind) -> Link:
    axis = np.eye(3)[rng.integers(3)] * rng.choice([-1.0, 1.0])
    if rng.random() < 0.15:
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
    quaternion = np.array([1.0, 0, 0, 0])
    if rng.random() < 0.3:
        quaternion = rng.normal(size=4)
        quaternion /= np.linalg.norm(quaternion)
    xyz = rng.uniform(-0.5, 0.5, 3) * (rng.random(3) < 0.6)
    if rng.random() < 0.15:
        xyz = axis * rng.uniform(-0.5, 0.5)
    mass = rng.uniform(0.5, 5.0)
    spread = rng.normal(size=(3, 3)) * 0.15
    second = mass * (spread @ spread.T + 0.01 * np.eye(3))  # positive second moments
    central = np.trace(second) * np.eye(3) - second
    return Link(name, parent, kind, axis, xyz, quaternion, mass, rng.uniform(-0.2, 0.2, 3), central)


def _inertia(link: Link) -> Inertia:
    return Inertia.about_centre(link.mass, link.com, link.central)


def _urdf_link(name: str, link: Link) -> str:
    i = link.central
    return (
        f'<link name="{name}"><inertial><origin xyz="{_text(link.com)}"/>'
        f'<mass value="{_text([link.mass])}"/><inertia ixx="{i[0, 0]}" ixy="{i[0, 1]}" '
        f'ixz="{i[0, 2]}" iyy="{i[1, 1]}" iyz="{i[1, 2]}" izz="{i[2, 2]}"/></inertial></link>'
    )


def _mjcf_inertial(link: Link) -> str:
    full = link.central[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    return (
        f'<inertial mass="{_text([link.mass])}" pos="{_text(link.com)}" '
        f'fullinertia="{_text(full)}"/>'
    )


def _text(values: Sequence[float] | Array) -> str:
    return " ".join(repr(float(value)) for value in values)
