"""Robot, tip paths and measured wrench in three dimensions, logged to Rerun."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr
from scipy.spatial.transform import Rotation

from testbed.bodies.consistency.consistent import robot_of
from testbed.bodies.shapes.appearance import Appearance
from testbed.bodies.shapes.shapes import Shape, equivalent_ellipsoids
from testbed.core.base.arrays import Array, multiply_vectors
from testbed.core.base.transform import Transform
from testbed.core.dynamics.newton_euler import poses, sensor_poses
from testbed.core.parameters.symbols import with_standard_parameters
from testbed.view.viewer.colours import COLOURS
from testbed.view.viewer.scene import Scene, block_means, pressure

TIMELINE = "time"
"""Name of the timeline, in seconds of the recording."""
MAX_ARROW_SHARE = 0.5
"""Length of the largest force and moment arrows, as a share of the robot's reach."""


def clock(time: Array) -> rr.TimeColumn:
    """Rerun column of times on the timeline `TIMELINE`.

    Args:
        time: Times, (M,) [s].
    """
    return rr.TimeColumn(TIMELINE, duration=np.asarray(time, dtype=np.float64))


def log_robot(stream: rr.RecordingStream, scene: Scene, parent: str) -> None:
    """Log shapes, joint axes and poses of a robot, and the paths of its tips.

    Args:
        stream: Stream of the recording.
        scene: The run.
        parent: Entity path of the world.
    """
    appearance = scene.appearance
    log_appearance(stream, appearance, parent)
    motion = scene.motion[scene.pose_samples]
    log_tip_paths(
        stream,
        appearance,
        send_poses(stream, appearance, motion.t, motion.q, parent),
        parent,
    )


def log_tip_paths(
    stream: rr.RecordingStream,
    appearance: Appearance,
    body_poses: list[Transform],
    parent: str,
) -> None:
    """Log the paths of the robot's tips, which are points on terminal bodies, as lines.

    Args:
        stream: Stream of the recording.
        appearance: Shapes of the robot, with the tip points.
        body_poses: Poses of all bodies in the world at M instants.
        parent: Entity path of the world.
    """
    for j, point in appearance.tip_points.items():
        line = rr.LineStrips3D(
            [body_poses[j].point(point)],
            colors=[COLOURS["path"]],
            radii=[appearance.reach / 720],
        )
        stream.log(f"{parent}/path/{j + 1}", line, static=True)


def log_ellipsoids(stream: rr.RecordingStream, scene: Scene, parent: str) -> None:
    """Log the links as ellipsoids of uniform density.

    An ellipsoid has the mass, centre of mass and inertia of its link, from the model file, from the
    estimate, and, if known, from the truth. Bodies that are physically impossible are left out.
    Nothing is logged for a run without consistent bodies.

    Args:
        stream: Stream of the recording.
        scene: The run.
        parent: Entity path of the world.
    """
    run = scene.run
    if run.consistent is None:
        return
    robots = {
        "prior": (
            with_standard_parameters(run.tree, run.consistent.prior),
            COLOURS["measured"],
        ),
        "estimate": (robot_of(run.consistent, run.tree), COLOURS["wrench"]),
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
                f"{parent}/robot/{shape.body + 1}/body/{name}", ellipsoids, static=True
            )


def log_appearance(
    stream: rr.RecordingStream, appearance: Appearance, parent: str
) -> None:
    """Log the shapes and joint axes of a robot, which are fixed in body frames.

    Args:
        stream: Stream of the recording.
        appearance: Shapes of the robot.
        parent: Entity path of the world.
    """
    stream.log(parent, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    size = appearance.reach / 12
    for k, shape in enumerate(appearance.shapes):
        entity_path = (
            f"{parent}/robot/{shape.body + 1}"
            if shape.body >= 0
            else f"{parent}/bedplate"
        )
        stream.log(f"{entity_path}/shape{k}", _rerun_archetype(shape), static=True)
    for j, joint in enumerate(appearance.tree.joints):
        axis = joint.axis * size
        arrow = rr.Arrows3D(
            vectors=[2 * axis],
            origins=[-axis],
            colors=[COLOURS["axis"]],
            radii=[size / 25],
            labels=[joint.name],
            show_labels=False,
        )
        stream.log(f"{parent}/robot/{j + 1}/axis", arrow, static=True)


def send_poses(
    stream: rr.RecordingStream,
    appearance: Appearance,
    time: Array,
    q: Array,
    parent: str,
) -> list[Transform]:
    """Send the poses of all bodies in the world over time, and return these poses.

    Args:
        stream: Stream of the recording.
        appearance: Shapes of the robot.
        time: Times, (M,) [s].
        q: Joint positions, (M, n) [rad or m].
        parent: Entity path of the world.

    Returns:
        Poses of the n bodies, each with M instants.
    """
    body_poses = poses(appearance.tree, q)
    for j, X_WB in enumerate(body_poses):
        orientations = quaternions(X_WB.R_AB)
        columns = rr.Transform3D.columns(
            translation=X_WB.p_AB_A, quaternion=orientations
        )
        stream.send_columns(
            f"{parent}/robot/{j + 1}", indexes=[clock(time)], columns=columns
        )
    return body_poses


def send_arrows(
    stream: rr.RecordingStream,
    appearance: Appearance,
    time: Array,
    wrench: Array,
    scales: Array,
    parent: str,
    places: Array | None = None,
) -> None:
    """Send arrows of force and moment over time, at a sensor or beside the plate.

    Args:
        stream: Stream of the recording.
        appearance: Shapes of the robot and its plate.
        time: Times, (M,) [s].
        wrench: Measured wrench, force first, along world axes, (M, 6) [N, N m].
        scales: Arrow lengths per newton and per newton metre, (2,) [m].
        parent: Entity path of the bedplate.
        places: Origins of the arrows, (M, 3) [m]; default a point beside the plate.
    """
    if places is None:
        places = np.tile(appearance.clear_corner, (len(time), 1))
    for k, name in enumerate(("force", "moment")):
        style = rr.Arrows3D.from_fields(
            colors=[COLOURS[name]], radii=[MAX_ARROW_SHARE * appearance.reach / 40]
        )
        stream.log(f"{parent}/{name}", style, static=True)
        vectors = scales[k] * wrench[:, 3 * k : 3 * k + 3]
        columns = rr.Arrows3D.columns(vectors=vectors, origins=places)
        stream.send_columns(f"{parent}/{name}", indexes=[clock(time)], columns=columns)


def log_wrench(stream: rr.RecordingStream, scene: Scene, parent: str) -> None:
    """Log the measured wrench as arrows, and the centre of pressure on a plate.

    The arrows start at the sensor, or beside the plate. They show averages over blocks of samples,
    at the rate of the poses. The largest force and the largest moment have an arrow length of
    `MAX_ARROW_SHARE` times the reach. Nothing is logged if no wrench was measured.

    Args:
        stream: Stream of the recording.
        scene: The run.
        parent: Entity path of the bedplate.
    """
    if scene.wrench is None:
        return
    appearance, tree, step = scene.appearance, scene.run.tree, scene.pose_samples.step
    wrench, time = block_means(scene.wrench, step), scene.motion.t[::step]
    largest = np.linalg.norm(wrench.reshape(-1, 2, 3), axis=2).max(axis=0, initial=1e-9)
    scales = MAX_ARROW_SHARE * appearance.reach / largest
    if tree.sensor is None:
        send_arrows(stream, appearance, time, wrench, scales, parent)
        _log_pressure(stream, appearance, time, pressure(wrench), parent)
        return
    X_WS = sensor_poses(tree, scene.motion.q[::step])
    world_wrench = np.hstack(
        [multiply_vectors(X_WS.R_AB, part) for part in np.split(wrench, 2, axis=1)]
    )
    send_arrows(stream, appearance, time, world_wrench, scales, parent, X_WS.p_AB_A)


def _log_pressure(
    stream: rr.RecordingStream,
    appearance: Appearance,
    time: Array,
    points: Array,
    parent: str,
) -> None:
    """Log the centre of pressure and its path on the top of the plate.

    Points are omitted, and the path is interrupted, where a coordinate exceeds three times the
    plate's clear corner or the robot's reach, whichever is larger.

    Args:
        stream: Stream of the recording.
        appearance: Shapes of the robot and its plate.
        time: Times, (M,) [s].
        points: Centre of pressure in the plane z = 0, (M, 2) [m]; nan where undefined.
        parent: Entity path of the bedplate.
    """
    max_distance = 3 * max(
        float(np.abs(appearance.clear_corner).max()), appearance.reach / 3
    )
    is_near = (np.abs(points) < max_distance).all(axis=1)  # false for nan
    if not is_near.any():
        return
    positions = np.column_stack(
        [points[is_near], np.full(is_near.sum(), appearance.plate_height + 0.002)]
    )
    colour, size = COLOURS["pressure"], MAX_ARROW_SHARE * appearance.reach
    style = rr.Points3D.from_fields(colors=[colour], radii=[size / 25])
    stream.log(f"{parent}/pressure", style, static=True)
    columns = rr.Points3D.columns(positions=positions)
    stream.send_columns(
        f"{parent}/pressure", indexes=[clock(time[is_near])], columns=columns
    )
    gaps = np.flatnonzero(np.diff(np.flatnonzero(is_near)) > 1) + 1
    trace = rr.LineStrips3D(
        np.split(positions, gaps), colors=[colour], radii=[size / 150]
    )
    stream.log(f"{parent}/trace", trace, static=True)


def _rerun_archetype(shape: Shape) -> Any:
    """Rerun archetype of a shape in its body frame: mesh, box, ellipsoid, cylinder or capsule."""
    colour = [(np.clip(shape.colour, 0, 1) * 255).astype(np.uint8)]
    if shape.kind == "mesh":
        vertices = shape.vertices @ shape.rotation.T + shape.position
        corners = vertices[shape.faces.astype(int)]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
        return rr.Mesh3D(  # separate corners for every face: edges stay sharp
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
    """Quaternions (x, y, z, w) with w >= 0 of rotation matrices, (M, 4) or (4,).

    Args:
        rotation: Rotation matrices, (M, 3, 3) or (3, 3).
    """
    return np.asarray(Rotation.from_matrix(rotation).as_quat(canonical=True))
