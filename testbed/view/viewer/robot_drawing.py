"""The robot and its reaction in three dimensions, as Rerun takes them."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr
from scipy.spatial.transform import Rotation

from testbed.bodies.consistency.consistent import robot_of
from testbed.bodies.shapes.appearance import Appearance
from testbed.bodies.shapes.shapes import Shape, equivalent_ellipsoids
from testbed.core.base.arrays import Array, apply
from testbed.core.base.transform import Transform
from testbed.core.dynamics.newton_euler import poses, sensor_pose
from testbed.core.parameters.symbols import with_standard
from testbed.view.viewer.colours import COLOURS
from testbed.view.viewer.scene import Scene, means, pressure

CLOCK = "time"
"""Name of the timeline: seconds of the recording."""
ARROW = 0.5
"""Length of the largest force's and moment's arrow, as part of the robot's reach."""


def clock(time: Array) -> rr.TimeColumn:
    """The timeline's column."""
    return rr.TimeColumn(CLOCK, duration=np.asarray(time, dtype=np.float64))


def log_robot(stream: rr.RecordingStream, scene: Scene, at: str) -> None:
    """Shapes on bodies, their poses, joint axes, the tips' paths."""
    look = scene.appearance
    log_appearance(stream, look, at)
    shown = scene.motion[scene.frames]
    log_paths(stream, look, send_poses(stream, look, shown.t, shown.q, at), at)


def log_paths(
    stream: rr.RecordingStream, look: Appearance, placed: list[Transform], at: str
) -> None:
    """The paths of the robot's tips.

    Args:
        stream: Where to.
        look: The robot.
        placed: Its bodies' poses over time.
        at: The world's place among the entities.
    """
    for j, point in look.tips.items():
        line = rr.LineStrips3D(
            [placed[j].point(point)], colors=[COLOURS["path"]], radii=[look.reach / 720]
        )
        stream.log(f"{at}/path/{j + 1}", line, static=True)


def log_bodies(stream: rr.RecordingStream, scene: Scene, at: str) -> None:
    """Links as ellipsoids of even density: model file, truth and estimate, where there are any."""
    run = scene.run
    if run.consistent is None:
        return
    robots = {
        "prior": (with_standard(run.tree, run.consistent.prior), COLOURS["measured"]),
        "estimate": (robot_of(run.consistent, run.tree), COLOURS["external"]),
    }
    if run.score is not None:
        robots["truth"] = run.tree, COLOURS["path"]
    for name, (tree, colour) in robots.items():
        for shape in equivalent_ellipsoids(tree, (0, 0, 0, 1)):
            ellipsoids = rr.Ellipsoids3D(
                half_sizes=[shape.size],
                centers=[shape.position],
                quaternions=[rr.Quaternion(xyzw=quaternions(shape.rotation))],
                colors=[colour],
                fill_mode=rr.components.FillMode.MajorWireframe,
            )
            stream.log(
                f"{at}/robot/{shape.body + 1}/body/{name}", ellipsoids, static=True
            )


def log_appearance(stream: rr.RecordingStream, look: Appearance, at: str) -> None:
    """What does not move in the bodies' frames: shapes and joint axes."""
    stream.log(at, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    size = look.reach / 12
    for k, shape in enumerate(look.shapes):
        home = f"{at}/robot/{shape.body + 1}" if shape.body >= 0 else f"{at}/bedplate"
        stream.log(f"{home}/shape{k}", _archetype(shape), static=True)
    for j, joint in enumerate(look.tree.joints):
        axis = joint.axis * size
        arrow = rr.Arrows3D(
            vectors=[2 * axis],
            origins=[-axis],
            colors=[COLOURS["axis"]],
            radii=[size / 25],
            labels=[joint.name],
            show_labels=False,
        )
        stream.log(f"{at}/robot/{j + 1}/axis", arrow, static=True)


def send_poses(
    stream: rr.RecordingStream, look: Appearance, time: Array, q: Array, at: str
) -> list[Transform]:
    """The bodies' poses over time, logged and returned."""
    placed = poses(look.tree, q)
    for j, X_WB in enumerate(placed):
        turned = quaternions(X_WB.R_AB)
        columns = rr.Transform3D.columns(translation=X_WB.p_AB_A, quaternion=turned)
        stream.send_columns(
            f"{at}/robot/{j + 1}", indexes=[clock(time)], columns=columns
        )
    return placed


def send_arrows(
    stream: rr.RecordingStream,
    look: Appearance,
    time: Array,
    wrench: Array,
    scales: Array,
    at: str,
    places: Array | None = None,
) -> None:
    """Force and moment over time, drawn at a sensor, or beside the plate: nothing hides them.

    Args:
        stream: Where to.
        look: The robot and its plate.
        time: (M,) [s].
        wrench: (M, 6) [N, N m].
        scales: What a newton and a newton metre are drawn as, (2,) [m].
        at: The bedplate's place among the entities.
        places: Where they are drawn, (M, 3) [m]; default beside the plate.
    """
    if places is None:
        places = np.tile(look.corner, (len(time), 1))
    for k, name in enumerate(("force", "moment")):
        style = rr.Arrows3D.from_fields(
            colors=[COLOURS[name]], radii=[ARROW * look.reach / 40]
        )
        stream.log(f"{at}/{name}", style, static=True)
        vectors = scales[k] * wrench[:, 3 * k : 3 * k + 3]
        columns = rr.Arrows3D.columns(vectors=vectors, origins=places)
        stream.send_columns(f"{at}/{name}", indexes=[clock(time)], columns=columns)


def log_reaction(stream: rr.RecordingStream, scene: Scene, at: str) -> None:
    """Force and moment at the sensor, or beside the plate with the centre of pressure on it."""
    if scene.wrench is None:
        return
    look, tree, step = scene.appearance, scene.run.tree, scene.frames.step
    wrench, time = means(scene.wrench, step), scene.motion.t[::step]
    largest = np.linalg.norm(wrench.reshape(-1, 2, 3), axis=2).max(axis=0, initial=1e-9)
    scales = ARROW * look.reach / largest
    if tree.sensor is None:
        send_arrows(stream, look, time, wrench, scales, at)
        _log_pressure(stream, look, time, pressure(wrench), at)
        return
    X_WS = sensor_pose(tree, scene.motion.q[::step])
    turned = np.hstack([apply(X_WS.R_AB, part) for part in np.split(wrench, 2, axis=1)])
    send_arrows(stream, look, time, turned, scales, at, X_WS.p_AB_A)


def _log_pressure(
    stream: rr.RecordingStream, look: Appearance, time: Array, points: Array, at: str
) -> None:
    """Centre of pressure near the robot and its trace, on the plate's upper side.

    Args:
        stream: Where to.
        look: The robot and its plate.
        time: (M,) [s].
        points: On the plate's plane, (M, 2) [m]; not a number where there is none.
        at: The bedplate's place among the entities.
    """
    far = 3 * max(float(np.abs(look.corner).max()), look.reach / 3)
    there = (np.abs(points) < far).all(axis=1)  # false for what is not a number, too
    if not there.any():
        return
    flat = np.column_stack([points[there], np.full(there.sum(), look.deck + 0.002)])
    colour, size = COLOURS["pressure"], ARROW * look.reach
    style = rr.Points3D.from_fields(colors=[colour], radii=[size / 25])
    stream.log(f"{at}/pressure", style, static=True)
    columns = rr.Points3D.columns(positions=flat)
    stream.send_columns(f"{at}/pressure", indexes=[clock(time[there])], columns=columns)
    gaps = np.flatnonzero(np.diff(np.flatnonzero(there)) > 1) + 1
    trace = rr.LineStrips3D(np.split(flat, gaps), colors=[colour], radii=[size / 150])
    stream.log(f"{at}/trace", trace, static=True)


def _archetype(shape: Shape) -> Any:
    """The shape as Rerun draws it."""
    colour = [(np.clip(shape.colour, 0, 1) * 255).astype(np.uint8)]
    if shape.kind == "mesh":
        vertices = shape.vertices @ shape.rotation.T + shape.position
        corners = vertices[shape.faces.astype(int)]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
        return rr.Mesh3D(  # corners of its own for every face: edges stay sharp
            vertex_positions=corners.reshape(-1, 3),
            vertex_normals=np.repeat(normals, 3, axis=0),
            albedo_factor=colour[0],
        )
    solid: dict[str, Any] = {
        "colors": colour,
        "quaternions": [rr.Quaternion(xyzw=quaternions(shape.rotation))],
        "fill_mode": rr.components.FillMode.Solid,
    }
    if shape.kind in ("box", "ellipsoid"):
        archetype = rr.Boxes3D if shape.kind == "box" else rr.Ellipsoids3D
        return archetype(half_sizes=[shape.size], centers=[shape.position], **solid)
    radius, half = shape.size
    solid |= {"lengths": [2 * half], "radii": [radius]}
    if shape.kind == "cylinder":
        return rr.Cylinders3D(centers=[shape.position], **solid)
    start = shape.position - shape.rotation[:, 2] * half
    return rr.Capsules3D(translations=[start], **solid)


def quaternions(rotation: Array) -> Array:
    """Quaternions x, y, z, w of rotations, (M, 4) or (4,); w is not negative."""
    return np.asarray(Rotation.from_matrix(rotation).as_quat(canonical=True))
