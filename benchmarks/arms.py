"""Robots of 3, 6 and 30 joints, as URDF: PUMA-like arms, and a humanoid-like tree."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import testbed as tb
from tests.helpers.robots import Link, Robot

# Modified Denavit-Hartenberg parameters of the PUMA 560: turn and offset along x, offset along z
_PUMA = (
    (0.0, 0.0, 0.0), (-np.pi / 2, 0.0, 0.2435), (0.0, 0.4318, -0.0934),
    (np.pi / 2, -0.0203, 0.4331), (-np.pi / 2, 0.0, 0.0), (np.pi / 2, 0.0, 0.0),
)  # fmt: skip
_AXES = ((1, 0, 0), (0, 1, 0), (0, 0, 1), (0.6, 0, 0.8))


def robots() -> dict[str, str]:
    """URDF texts by name."""
    return {"arm3": _arm(3), "puma6": _arm(6), "tree30": _tree()}


def load(urdf: str) -> tb.Tree:
    """The tree of a URDF text."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.urdf"
        path.write_text(urdf)
        return tb.load_tree(path)


def _arm(joints: int) -> str:
    rng = np.random.default_rng(1)
    links = [_link(rng, "pedestal", -1)]
    for k, (turn, a, d) in enumerate(_PUMA[:joints]):
        origin = (a, -np.sin(turn) * d, np.cos(turn) * d)
        links.append(_link(rng, f"j{k + 1}", k - 1, origin, (turn, 0.0, 0.0)))
    return Robot(tuple(links[1:]), links[0], np.zeros(3)).urdf()


def _tree() -> str:
    """Torso of 3, head of 2, arms of 7 with sliding grippers, legs of 6 and 5; oblique axes."""
    rng = np.random.default_rng(3)
    parents = [0, 1, 2, 3, 4]
    for root, length in ((3, 7), (3, 7), (0, 6), (0, 5)):
        start = len(parents)
        parents += [root, *range(start + 1, start + length)]
    links = [_link(rng, "pedestal", -1)]
    for k, parent in enumerate(parents, start=1):
        axis = _AXES[rng.choice(4, p=[0.3, 0.3, 0.3, 0.1])]
        turns = (0.0, 0.0, 0.0) if rng.random() < 0.5 else rng.uniform(-1.5, 1.5, 3)
        origin = rng.uniform(-0.3, 0.3, 3)
        links.append(_link(rng, f"j{k}", parent - 1, origin, turns, axis, slides=k in (12, 19)))
    return Robot(tuple(links[1:]), links[0], np.zeros(3)).urdf()


def _link(
    rng: np.random.Generator,
    name: str,
    parent: int,
    origin: Sequence[float] | np.ndarray = (0.0, 0.0, 0.0),
    turns: Sequence[float] | np.ndarray = (0.0, 0.0, 0.0),
    axis: Sequence[float] = (0, 0, 1),
    slides: bool = False,
) -> Link:
    """A link of random mass, centre and inertia."""
    mass, centre = rng.uniform(0.5, 8), rng.uniform(-0.15, 0.15, 3)
    root = rng.normal(size=(3, 3)) * 0.1 * np.sqrt(mass)
    spread = root @ root.T + np.eye(3) * 0.01 * mass
    turn = np.roll(Rotation.from_euler("xyz", turns).as_quat(), 1)
    return Link(
        name, parent, "prismatic" if slides else "revolute", np.array(axis, float),
        np.array(origin), turn, mass, centre, np.trace(spread) * np.eye(3) - spread,
    )  # fmt: skip
