"""A run as Rerun's viewer takes it: everything in columns, nothing sample by sample."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from testbed.arrays import Array
from testbed.files import replacing
from testbed.recordings.columns import AXES
from testbed.robot.tree import Tree
from testbed.robot.visuals.shapes import Shape
from testbed.viewer.blueprint import blueprint
from testbed.viewer.colours import COLOURS, Colour, joint_colours
from testbed.viewer.story import Story, extent, means, poses, pressure, root, safe, tips

CLOCK = "time"
"""Name of the timeline: seconds of the recording."""
ARROW = 0.5
"""Length of the largest force's and moment's arrow, as part of the robot's reach."""


def write_rrd(stories: Sequence[Story], path: Path, tab: str = "wrench") -> None:
    """Write runs as one Rerun recording, with a blueprint for a first look.

    Args:
        stories: One run, or several to be shown side by side.
        path: The .rrd file; appears whole or not at all.
        tab: Which tab is in front.
    """
    with replacing(path) as fresh:
        stream = rr.RecordingStream("testbed", recording_id=path.stem, send_properties=False)
        stream.save(fresh, default_blueprint=blueprint(stories, tab))
        for k, story in enumerate(stories):
            log_story(stream, story, root(k, len(stories)))
        stream.flush()
        stream.disconnect()


def log_story(stream: rr.RecordingStream, story: Story, at: str = "") -> None:
    """Log everything there is to see of a run.

    Args:
        stream: Where to.
        story: The run.
        at: Its root among the entities.
    """
    stream.log(f"{at}/world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    _robot(stream, story, f"{at}/world")
    _plate(stream, story, f"{at}/world/bedplate")
    _signals(stream, story, at)
    _friction(stream, story, f"{at}/friction")
    _estimates(stream, story, f"{at}/estimate")


def clock(time: Array) -> rr.TimeColumn:
    """The timeline's column."""
    return rr.TimeColumn(CLOCK, duration=np.asarray(time, dtype=np.float64))


def _robot(stream: rr.RecordingStream, story: Story, at: str) -> None:
    """Shapes on bodies, their poses, joint axes, the tips' paths."""
    draw_robot(stream, story, at)
    shown = story.motion[story.frames]
    placed = send_poses(stream, story.tree, shown.t, shown.q, at)
    size = reach(story) / 12
    for j, point in tips(story).items():
        rotation, position = placed[j]
        path = position + rotation @ point
        line = rr.LineStrips3D([path], colors=[COLOURS["path"]], radii=[size / 60])
        stream.log(f"{at}/path/{j + 1}", line, static=True)


def draw_robot(stream: rr.RecordingStream, story: Story, at: str) -> None:
    """What does not move in the bodies' frames: shapes and joint axes."""
    size = reach(story) / 12
    for k, shape in enumerate(story.shapes):
        home = f"{at}/robot/{shape.body + 1}" if shape.body >= 0 else f"{at}/bedplate"
        stream.log(f"{home}/shape{k}", _archetype(shape), static=True)
    for j, joint in enumerate(story.tree.joints):
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
    stream: rr.RecordingStream, tree: Tree, time: Array, q: Array, at: str
) -> list[tuple[Array, Array]]:
    """The bodies' poses over time, logged and returned."""
    placed = poses(tree, q)
    for j, (rotation, position) in enumerate(placed):
        turned = quaternions(rotation)
        columns = rr.Transform3D.columns(translation=position, quaternion=turned)
        stream.send_columns(f"{at}/robot/{j + 1}", indexes=[clock(time)], columns=columns)
    return placed


def _archetype(shape: Shape) -> Any:
    """The shape as Rerun draws it."""
    colour = [(np.clip(shape.colour, 0, 1) * 255).astype(np.uint8)]
    turn = [rr.Quaternion(xyzw=quaternions(shape.rotation))]
    solid: dict[str, Any] = {
        "colors": colour,
        "quaternions": turn,
        "fill_mode": rr.components.FillMode.Solid,
    }
    if shape.kind == "box":
        return rr.Boxes3D(half_sizes=[shape.size], centers=[shape.position], **solid)
    if shape.kind == "ellipsoid":
        return rr.Ellipsoids3D(half_sizes=[shape.size], centers=[shape.position], **solid)
    if shape.kind == "cylinder":
        radius, half = shape.size
        return rr.Cylinders3D(lengths=[2 * half], radii=[radius], centers=[shape.position], **solid)
    if shape.kind == "capsule":
        radius, half = shape.size
        start = shape.position - shape.rotation[:, 2] * half
        return rr.Capsules3D(lengths=[2 * half], radii=[radius], translations=[start], **solid)
    vertices = shape.vertices @ shape.rotation.T + shape.position
    corners = vertices[shape.faces.astype(int)]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    return rr.Mesh3D(  # corners of its own for every face: edges stay sharp
        vertex_positions=corners.reshape(-1, 3),
        vertex_normals=np.repeat(normals, 3, axis=0),
        albedo_factor=colour[0],
    )


def send_arrows(
    stream: rr.RecordingStream, story: Story, time: Array, wrench: Array, scales: Array, at: str
) -> None:
    """Force and moment over time, drawn at the plate's edge.

    Args:
        stream: Where to.
        story: Whose robot and plate.
        time: (M,) [s].
        wrench: (M, 6) [N, N m].
        scales: What a newton and a newton metre are drawn as, (2,) [m].
        at: The bedplate's place among the entities.
    """
    edge, radius = plate_edge(story), ARROW * reach(story) / 40
    for name, vectors, scale in zip(
        ("force", "moment"), (wrench[:, :3], wrench[:, 3:]), scales, strict=True
    ):
        columns = rr.Arrows3D.columns(
            vectors=vectors * scale,
            origins=np.tile(edge, (len(time), 1)),
            colors=np.tile(np.array([COLOURS[name]], dtype=np.uint8), (len(time), 1)),
            radii=np.full(len(time), radius),
        )
        stream.send_columns(f"{at}/{name}", indexes=[clock(time)], columns=columns)


def _plate(stream: rr.RecordingStream, story: Story, at: str) -> None:
    """Force and moment, drawn at the plate's edge; centre of pressure and its trace."""
    size = story.frames.step
    wrench = means(story.measured(story.recording.measured("wrench")), size)
    times = story.motion.t[::size]
    length = ARROW * reach(story)
    largest = [
        max(float(np.linalg.norm(part, axis=1).max(initial=0.0)), 1e-9)
        for part in (wrench[:, :3], wrench[:, 3:])
    ]
    send_arrows(stream, story, times, wrench, length / np.array(largest), at)
    points = pressure(wrench)
    far = 3 * max(float(np.abs(plate_edge(story)).max()), reach(story) / 3)
    there = (np.abs(points) < far).all(axis=1)  # false for what is not a number, too
    if there.any():
        flat = np.column_stack([points[there], np.full(there.sum(), 0.002)])
        columns = rr.Points3D.columns(
            positions=flat,
            colors=np.tile(np.array([COLOURS["pressure"]], dtype=np.uint8), (len(flat), 1)),
            radii=np.full(len(flat), length / 25),
        )
        stream.send_columns(f"{at}/pressure", indexes=[clock(times[there])], columns=columns)
        runs = np.split(flat, np.flatnonzero(np.diff(np.flatnonzero(there)) > 1) + 1)
        trace = rr.LineStrips3D(runs, colors=[COLOURS["pressure"]], radii=[length / 150])
        stream.log(f"{at}/trace", trace, static=True)


def _signals(stream: rr.RecordingStream, story: Story, at: str) -> None:
    """Positions; torques and wrench, measured and predicted; residuals. Every sample."""
    recording, inner = story.recording, clock(story.motion.t)
    names = story.tree.names
    _series(
        stream, f"{at}/position", clock(recording.time), recording.position, names,
        joint_colours(len(names)),
    )  # fmt: skip
    groups = (
        ("wrench", AXES, recording.measured("wrench"), story.wrench),
        ("torque", names, recording.measured("torque"), story.torque),
    )
    for group, channels, measured, predicted in groups:
        for c, channel in enumerate(channels):
            there = story.measured(measured)[:, c]
            columns = [there, *(values[:, c] for values in predicted.values())]
            labels = ["measured", *predicted]
            colours = [COLOURS[label] for label in labels]
            path = f"{at}/{group}/{safe(channel)}"
            _series(stream, path, inner, np.column_stack(columns), labels, colours)
            if predicted:
                rest = np.column_stack([there - values[:, c] for values in predicted.values()])
                path = f"{at}/residual/{group}/{safe(channel)}"
                _series(stream, path, inner, rest, labels[1:], colours[1:])


def _series(
    stream: rr.RecordingStream,
    path: str,
    index: rr.TimeColumn,
    values: Array,
    labels: Sequence[str],
    colours: Sequence[Colour],
) -> None:
    stream.log(path, rr.SeriesLines(names=list(labels), colors=list(colours)), static=True)
    columns = rr.Scalars.columns(scalars=np.ascontiguousarray(values))
    stream.send_columns(path, indexes=[index], columns=columns)


def _friction(stream: rr.RecordingStream, story: Story, at: str) -> None:
    """Unexplained torque against velocity, and the friction curve; a picture a joint."""
    rest = story.rubbing
    if rest is None:
        return
    step = max(1, len(rest) // 2000)
    for j, name in enumerate(story.tree.names):
        speed, torque = story.motion.qd[::step, j], rest[::step, j]
        width, height = extent(story, j)
        points = np.column_stack([speed / width, -torque / height])
        path = f"{at}/{safe(name)}"
        stream.log(
            f"{path}/points",
            rr.Points2D(points, colors=[COLOURS["measured"]], radii=[0.006]),
            static=True,
        )
        stream.log(
            f"{path}/axes",
            rr.LineStrips2D(
                [[[-1.05, 0], [1.05, 0]], [[0, 1.05], [0, -1.05]]],
                colors=[COLOURS["axis"]], radii=[0.003],
            ),
            static=True,
        )  # fmt: skip
        grid = np.zeros((201, story.tree.n))
        grid[:, j] = np.linspace(-width, width, 201)
        curve = story.rubbing_model(grid)
        if curve is not None:
            line = np.column_stack([grid[:, j] / width, -curve[:, j] / height])
            stream.log(
                f"{path}/curve",
                rr.LineStrips2D([line], colors=[COLOURS["internal"]], radii=[0.008]),
                static=True,
            )


def _estimates(stream: rr.RecordingStream, story: Story, at: str) -> None:
    """Every parameter over the time recorded: value, two sigmas to either side, truth."""
    for method, grown in story.growth.items():
        for k, name in enumerate(story.estimates[method].base.names):
            there = np.isfinite(grown.values[:, k])
            value, sigma = grown.values[there, k], grown.sigma[there, k]
            if not there.any():
                continue
            colour, pale = COLOURS[method], COLOURS[f"{method} band"]
            columns = [value, value - 2 * sigma, value + 2 * sigma]
            labels = [method, f"{method} - 2 sigma", f"{method} + 2 sigma"]
            index = clock(grown.time[there])
            path = f"{at}/{safe(name)}/{method}"
            _series(stream, path, index, np.column_stack(columns), labels, [colour, pale, pale])
            if name in story.truths:
                ends = np.array([[story.truths[name]], [story.truths[name]]])
                span = clock(grown.time[there][[0, -1]])
                path = f"{at}/{safe(name)}/truth"
                _series(stream, path, span, ends, ["truth"], [COLOURS["truth"]])


def plate_edge(story: Story) -> Array:
    """Where the arrows are drawn: the plate's corner towards the viewer, clear of the robot."""
    sizes = [
        float(np.abs(shape.position[:2]).max() + shape.size[:2].max(initial=0.0))
        for shape in story.shapes
        if shape.body < 0
    ]
    size = max(sizes, default=0.15 * reach(story))
    return np.array([0.9 * size, -0.9 * size, 0.0])


def reach(story: Story) -> float:
    """A length that fits the robot: the sum of its offsets [m]."""
    lengths = [float(np.linalg.norm(joint.offset)) for joint in story.tree.joints]
    tips_ = [float(np.linalg.norm(point)) for point in tips(story).values()]
    return max(sum(lengths) / max(1, len(story.tree.children(-1))) + max(tips_), 0.1)


def quaternions(rotation: Array) -> Array:
    """(x, y, z, w) of rotations, (..., 4), w positive; (..., 3, 3) given."""
    m = np.empty((*rotation.shape[:-2], 4, 4))
    trace = np.trace(rotation, axis1=-2, axis2=-1)[..., None, None]
    m[..., :3, :3] = rotation + rotation.swapaxes(-1, -2) - trace * np.eye(3)
    for k, (i, j) in enumerate(((2, 1), (0, 2), (1, 0))):
        m[..., k, 3] = m[..., 3, k] = rotation[..., i, j] - rotation[..., j, i]
    m[..., 3, 3] = trace[..., 0, 0]
    found = np.linalg.eigh(m)[1][..., -1]
    return np.asarray(np.where(found[..., 3:] < 0, -found, found))
