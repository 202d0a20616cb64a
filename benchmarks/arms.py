"""Robots of 3, 6 and 30 joints, as URDF: PUMA-like arms, and a humanoid-like tree."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

import testbed as tb

# Modified Denavit-Hartenberg parameters of the PUMA 560: turn and offset along x, offset along z
_PUMA = [
    (0.0, 0.0, 0.0),
    (-np.pi / 2, 0.0, 0.2435),
    (0.0, 0.4318, -0.0934),
    (np.pi / 2, -0.0203, 0.4331),
    (-np.pi / 2, 0.0, 0.0),
    (np.pi / 2, 0.0, 0.0),
]
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
    parts = [_link(0, rng)]
    for k, (turn, a, d) in enumerate(_PUMA[:joints]):
        origin = (a, -np.sin(turn) * d, np.cos(turn) * d)
        parts += [_link(k + 1, rng), _joint(k + 1, k, origin, (turn, 0.0, 0.0), (0, 0, 1))]
    return _robot(parts)


def _tree() -> str:
    """Torso of 3, head of 2, arms of 7 with sliding grippers, legs of 6 and 5; oblique axes."""
    rng = np.random.default_rng(3)
    parents = [0, 1, 2, 3, 4]
    for root, length in ((3, 7), (3, 7), (0, 6), (0, 5)):
        start = len(parents)
        parents += [root, *range(start + 1, start + length)]
    parts = [_link(0, rng)]
    for k, parent in enumerate(parents, start=1):
        axis = _AXES[rng.choice(4, p=[0.3, 0.3, 0.3, 0.1])]
        rpy = (0.0, 0.0, 0.0) if rng.random() < 0.5 else tuple(rng.uniform(-1.5, 1.5, 3))
        origin = tuple(rng.uniform(-0.3, 0.3, 3))
        parts += [_link(k, rng), _joint(k, parent, origin, rpy, axis, slides=k in (12, 19))]
    return _robot(parts)


def _robot(parts: list[str]) -> str:
    return f'<robot name="benchmark">{"".join(parts)}</robot>'


def _link(k: int, rng: np.random.Generator) -> str:
    mass, centre = rng.uniform(0.5, 8), rng.uniform(-0.15, 0.15, 3)
    root = rng.normal(size=(3, 3)) * 0.1 * np.sqrt(mass)
    spread = root @ root.T + np.eye(3) * 0.01 * mass
    tensor = np.trace(spread) * np.eye(3) - spread
    names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    values = tensor[np.triu_indices(3)]
    inertia = " ".join(f'{n}="{v:.8f}"' for n, v in zip(names, values, strict=True))
    return (
        f'<link name="l{k}"><inertial><origin xyz="{_row(centre)}"/><mass value="{mass:.6f}"/>'
        f"<inertia {inertia}/></inertial></link>"
    )


def _joint(
    k: int,
    parent: int,
    origin: tuple[float, ...],
    rpy: tuple[float, ...],
    axis: tuple[float, ...],
    slides: bool = False,
) -> str:
    kind = "prismatic" if slides else "revolute"
    return (
        f'<joint name="j{k}" type="{kind}"><parent link="l{parent}"/><child link="l{k}"/>'
        f'<origin xyz="{_row(origin)}" rpy="{_row(rpy)}"/><axis xyz="{_row(axis)}"/>'
        '<limit lower="-6.3" upper="6.3" effort="100" velocity="10"/></joint>'
    )


def _row(values: tuple[float, ...] | np.ndarray) -> str:
    return " ".join(repr(float(value)) for value in values)
