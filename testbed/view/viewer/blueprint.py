"""How the viewer arranges a run at first sight."""

from __future__ import annotations

from collections.abc import Sequence

import rerun as rr
import rerun.blueprint as rrb

from testbed.core.estimation.estimate import channel_units
from testbed.core.recordings.columns import AXES, PLATE_UNITS
from testbed.core.robot.tree import Tree
from testbed.lab.experiment.predict import Channel
from testbed.view.viewer.robot_drawing import CLOCK
from testbed.view.viewer.scene import Scene, entity, root, safe

MOST_ROWS = 8
"""Plots one below the other that can still be read."""

RATES = ("position", "velocity", "acceleration")
"""What is plotted of a motion's joints."""

Range = tuple[float, float]


def blueprint(scenes: Sequence[Scene]) -> rrb.Blueprint:
    """Robots on their plates to the left, everything over time to the right, in tabs.

    Args:
        scenes: One run, or several side by side.
    """
    count = len(scenes)
    roots = [root(k, count) for k in range(count)]
    robots = [
        _robot(s.run.name, s.span, at) for s, at in zip(scenes, roots, strict=True)
    ]
    sides = [_tabs(scene, at) for scene, at in zip(scenes, roots, strict=True)]
    name = " | ".join(scene.run.name for scene in scenes)
    left = robots[0] if count == 1 else rrb.Vertical(*robots)
    right = sides[0] if count == 1 else rrb.Tabs(*sides)
    return _page(left, right, name, scenes[0].window)


def live_blueprint(name: str, tree: Tree, size: float) -> rrb.Blueprint:
    """What is there while a run is simulated: the robot, its wrench and torques.

    Args:
        name: Of the run.
        tree: The robot.
        size: A length that fits it [m].
    """
    wrench = [
        _plot(f"/wrench/{c}", f"{c} [{u}]")
        for c, u in zip(AXES, PLATE_UNITS, strict=True)
    ]
    torque = [
        _plot(f"/torque/{safe(joint)}", f"torque of {joint} [{unit}]")
        for joint, unit in zip(tree.names, channel_units(tree, "internal"), strict=True)
    ]
    tabs = rrb.Tabs(
        rrb.Grid(*wrench, grid_columns=2, name="wrench"), _joints("", torque), name=name
    )
    return _page(_robot(name, size, ""), tabs, name, None)


def motion_blueprint(
    name: str, tree: Tree, size: float, kinds: Sequence[str], period: float
) -> rrb.Blueprint:
    """A motion: the robot on its path, what is left of the limits, the joints, notes.

    Args:
        name: Of the motion.
        tree: The robot.
        size: A length that fits it [m].
        kinds: Of limits, as their plots are called.
        period: Of the motion [s].
    """
    seen = (0.0, period)
    left = [
        _plot(f"/left/{k}", f"margin to {kind}", seen, False)
        for k, kind in enumerate(kinds)
    ]
    joints = [
        rrb.Horizontal(
            *(
                _plot(f"/{s}/{safe(joint)}", f"{s} of {joint}", seen, False)
                for s in RATES
            )
        )
        for joint in tree.names
    ]
    tabs = rrb.Tabs(
        _stack(left, "limits"),
        _stack(joints, "joints"),
        rrb.TextDocumentView(origin="/notes", name="notes"),
        name=name,
    )
    return _page(
        _robot(name, size, "", "robot and the paths of its tips"), tabs, name, seen
    )


def _page(
    left: rrb.View | rrb.Container,
    right: rrb.Container,
    name: str,
    window: Range | None,
) -> rrb.Blueprint:
    """Both halves, the panels folded away."""
    selection = None
    if window is not None:
        selection = rrb.components.AbsoluteTimeRange(
            *(int(1e9 * seconds) for seconds in window)
        )
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[2, 3], name=name),
        rrb.TimePanel(
            state="collapsed",
            timeline=CLOCK,
            time_selection=selection,
            loop_mode=None if selection is None else "selection",
        ),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
    )


def _robot(
    name: str, size: float, at: str, shown: str = "robot and reaction"
) -> rrb.Spatial3DView:
    eye = rrb.EyeControls3D(
        position=(1.25 * size, -2.06 * size, 1.2 * size),
        look_target=(0, 0, 0.3 * size),
        eye_up=(0, 0, 1),
    )
    return rrb.Spatial3DView(
        origin=f"{at}/world", name=f"{name}: {shown}", eye_controls=eye
    )


def _tabs(scene: Scene, at: str) -> rrb.Tabs:
    rows: dict[str, list[rrb.View | rrb.Container]] = {"wrench": [], "torque": []}
    for channel in scene.predictions.channels:
        rows[channel.kind].append(_row(scene, channel, at))
    return rrb.Tabs(
        *([_stack(rows["wrench"], "wrench")] if rows["wrench"] else []),
        _joints(at, rows["torque"], scene.window),
        rrb.TextDocumentView(origin=f"{at}/notes", name="notes"),
        name=scene.run.name,
        active_tab=0,
    )


def _joints(
    at: str, torque: Sequence[rrb.View | rrb.Container], window: Range | None = None
) -> rrb.Vertical:
    positions = _plot(f"{at}/position", "joint positions [rad or m]", window)
    shares = [1, min(len(torque), MOST_ROWS)] if torque else [1]
    below = [_stack(torque, "torques")] if torque else []
    return rrb.Vertical(positions, *below, row_shares=shares, name="joints")


def _stack(rows: Sequence[rrb.View | rrb.Container], name: str) -> rrb.Container:
    """One below the other, in as many columns as it takes."""
    if len(rows) <= MOST_ROWS:
        return rrb.Vertical(*rows, name=name)
    return rrb.Grid(*rows, grid_columns=-(-len(rows) // MOST_ROWS), name=name)


def _row(scene: Scene, channel: Channel, at: str) -> rrb.Horizontal:
    """A channel measured and predicted, and beside it what is left over."""
    plots = {entity(at, channel): channel.name}
    if channel.residuals:
        plots[entity(f"{at}/residual", channel)] = f"{channel.name}: residual"
    legend = channel.index == 0
    return rrb.Horizontal(
        *(
            _plot(path, f"{title} [{channel.unit}]", scene.window, legend)
            for path, title in plots.items()
        )
    )


def _plot(
    origin: str, name: str, window: Range | None = None, legend: bool = True
) -> rrb.TimeSeriesView:
    """Curves over time, opened on a window of it."""
    axis = None
    if window is not None:
        seen = rr.TimeRange(
            start=rr.TimeRangeBoundary.absolute(seconds=window[0]),
            end=rr.TimeRangeBoundary.absolute(seconds=window[1]),
        )
        axis = rrb.TimeAxis(view_range=seen, link="Independent")
    shown = rrb.PlotLegend(corner=rrb.Corner2D.RightTop, visible=legend)
    return rrb.TimeSeriesView(origin=origin, name=name, plot_legend=shown, axis_x=axis)
