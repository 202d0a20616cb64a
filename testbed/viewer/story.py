"""What there is to see of a run, computed: poses, arrows, predictions, friction, growth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import rerun as rr

from testbed.arrays import Array, apply
from testbed.dynamics.algebra import NUMBERS
from testbed.dynamics.kinematics import kinematics
from testbed.dynamics.motion import Motion
from testbed.errors import RecordingError
from testbed.identification.estimate import Estimate, Method
from testbed.identification.predict import (
    Growth,
    friction,
    motion_in,
    predictions,
)
from testbed.identification.settings import Settings
from testbed.recordings.recording import Recording
from testbed.robot.tree import Tree
from testbed.robot.visuals.shapes import Shape
from testbed.robot.visuals.sticks import sticks

PRESSED = 0.05
"""Part of the largest force that must press for there to be a centre of pressure."""
POSES = 50.0
"""Poses shown a second [Hz]; the eye sees no more."""


@dataclass(frozen=True, eq=False)
class Story:
    """One run, ready to be shown.

    Attributes:
        name: Of the run.
        tree: The robot.
        shapes: What it looks like.
        recording: What was measured.
        motion: What the recording shows, without the ends that filters take.
        inner: The samples of that motion.
        wrench: Predictions by method, (M, 6) [N, N m], pedestal included.
        torque: Predictions by method, (M, n) [N m or N].
        estimates: By method.
        truths: True values of parameters by name, where they are known.
        growth: Estimates from more and more of the recording, by method.
    """

    name: str
    tree: Tree
    shapes: tuple[Shape, ...]
    recording: Recording
    motion: Motion
    inner: slice
    wrench: Mapping[Method, Array] = field(default_factory=dict)
    torque: Mapping[Method, Array] = field(default_factory=dict)
    estimates: Mapping[Method, Estimate] = field(default_factory=dict)
    truths: Mapping[str, float] = field(default_factory=dict)
    growth: Mapping[Method, Growth] = field(default_factory=dict)

    @property
    def frames(self) -> slice:
        """Samples of the motion at which poses are shown."""
        return slice(0, self.motion.samples, max(1, round(self.recording.rate / POSES)))

    def measured(self, signal: Array) -> Array:
        """The samples of a measured signal that the motion covers."""
        return signal[self.inner]

    @cached_property
    def rubbing(self) -> Array | None:
        """Torque that the robot's own dynamics do not explain, (M, n) [N m or N]."""
        clean = self.torque.get("external")
        return None if clean is None else self.measured(self.recording.measured("torque")) - clean

    def rubbing_model(self, speed: Array) -> Array | None:
        """Friction at speeds, (k, n), that the internal estimate tells."""
        internal = self.estimates.get("internal")
        return None if internal is None else friction(speed, internal)


def tell(
    name: str,
    tree: Tree,
    recording: Recording,
    shapes: Sequence[Shape] = (),
    estimates: Mapping[Method, Estimate] | None = None,
    truths: Mapping[str, float] | None = None,
    growth: Mapping[Method, Growth] | None = None,
    settings: Settings | None = None,
) -> Story:
    """Compute what there is to see of a run.

    Args:
        name: Of the run.
        tree: The robot.
        recording: What was measured.
        shapes: What the robot looks like; default a figure of sticks.
        estimates: By method, "external" and "internal"; default none.
        truths: True values by parameter name.
        growth: Estimates from more and more of the recording, by method.
        settings: How the estimates treated the recording; default `Settings()`.
    """
    if recording.names != tree.names:
        recording = recording.ordered(tree)
    motion, inner = _motion(recording, settings)
    shapes = tuple(shapes) or tuple(sticks(tree))
    estimates = estimates or {}
    wrench, torque = predictions(tree, recording, motion, estimates)
    return Story(
        name, tree, with_bedplate(tree, shapes), recording, motion, inner,
        wrench, torque, estimates, truths or {}, growth or {},
    )  # fmt: skip


def with_bedplate(tree: Tree, shapes: tuple[Shape, ...]) -> tuple[Shape, ...]:
    """The shapes, and a plate under the robot where the model file draws none that wide."""
    span = sum(float(np.linalg.norm(joint.offset)) for joint in tree.joints)
    half = max(0.3 * span / max(1, len(tree.children(-1))), 0.1)
    for shape in shapes:
        if shape.body < 0 and shape.kind == "box" and min(shape.size[:2]) > 0.5 * half:
            return shapes
    size = np.array([half, half, 0.04 * half])
    steel = np.array([0.62, 0.64, 0.68, 1.0])
    below = np.array([0.0, 0.0, -0.04 * half])
    return (*shapes, Shape(-1, "box", size, below, np.eye(3), steel))


def poses(tree: Tree, q: Array) -> list[tuple[Array, Array]]:
    """Rotation to the bedplate's axes (M, 3, 3) and position (M, 3) of every body.

    Args:
        tree: The robot.
        q: Joint positions, (M, n) [rad or m].
    """
    still = np.zeros_like(q)
    moving = kinematics(tree, q, still, still, np.zeros(3), NUMBERS)
    found: list[tuple[Array, Array]] = []
    for joint, body in zip(tree.joints, moving, strict=True):
        base = np.broadcast_to(np.eye(3), (len(q), 3, 3)), np.zeros((len(q), 3))
        rotation, position = base if joint.parent < 0 else found[joint.parent]
        turned = rotation @ body.turn
        found.append((turned, position + rotation @ joint.offset + apply(turned, body.z)))
    return found


def tips(story: Story) -> dict[int, Array]:
    """A point on each last body, in its frame: the centre of its farthest shape."""
    found = {}
    for j in range(story.tree.n):
        if story.tree.children(j):
            continue
        own = [shape.position for shape in story.shapes if shape.body == j]
        own.append(story.tree.inertias[j].com)
        found[j] = max(own, key=lambda point: float(np.linalg.norm(point)))
    return found


def span(story: Story) -> float:
    """How far from the bedplate's origin the robot reached [m]; at least 0.3."""
    shown = story.motion[story.frames]
    placed = poses(story.tree, shown.q)
    far = [position for _, position in placed]
    far += [placed[j][1] + placed[j][0] @ point for j, point in tips(story).items()]
    return max(0.3, *(float(np.linalg.norm(points, axis=1).max()) for points in far))


def extent(story: Story, j: int) -> tuple[float, float]:
    """Largest speed and largest unexplained torque of a joint, where its curve's axes end."""
    rest = story.rubbing
    torque = 1e-9 if rest is None else max(float(np.abs(rest[:, j]).max()), 1e-9)
    return max(float(np.abs(story.motion.qd[:, j]).max()), 1e-9), torque


def root(k: int, count: int) -> str:
    """Where the k-th of several runs stands among the entities."""
    return "" if count == 1 else f"/run{k + 1}"


def safe(name: str) -> str:
    """A joint's or parameter's name as one part of an entity's path."""
    return str(rr.escape_entity_path_part(name))


def pressure(wrench: Array) -> Array:
    """Centre of pressure on the bedplate's plane z = 0, (M, 2) [m]; nan where it is hardly pressed.

    Args:
        wrench: Of the bedplate on the robot, (M, 6) [N, N m].
    """
    fz = wrench[:, 2]
    pressed = fz > PRESSED * np.abs(wrench[:, :3]).max(initial=1e-9)
    safe = np.where(pressed, fz, np.nan)
    return np.column_stack([-wrench[:, 4] / safe, wrench[:, 3] / safe])


def means(signal: Array, size: int) -> Array:
    """Means of consecutive blocks of `size` samples, (blocks, k)."""
    blocks = -(-len(signal) // size)
    starts = np.arange(blocks) * size
    counts = np.diff([*starts, len(signal)])
    return np.asarray(np.add.reduceat(signal, starts, axis=0) / counts[:, None])


def _motion(recording: Recording, settings: Settings | None) -> tuple[Motion, slice]:
    """The recording's motion; unfiltered where it is too short for filters."""
    try:
        return motion_in(recording, settings)
    except RecordingError:
        step = 1 / recording.rate
        speed = np.gradient(recording.position, step, axis=0)
        rates = speed, np.gradient(speed, step, axis=0)
        return Motion(recording.time, recording.position, *rates), slice(0, recording.samples)
