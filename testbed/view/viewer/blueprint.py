"""Initial layouts of the Rerun viewer for runs, running simulations and motions."""

from __future__ import annotations

from collections.abc import Sequence

import rerun as rr
import rerun.blueprint as rrb

from testbed.core.estimation.estimate import channel_units
from testbed.core.recordings.columns import WRENCH_COMPONENTS, WRENCH_UNITS
from testbed.core.robot.tree import Tree
from testbed.lab.experiment.predict import Channel
from testbed.view.viewer.robot_drawing import TIMELINE
from testbed.view.viewer.scene import Scene, entity, escaped_path_part, run_entity_path

MAX_ROWS = 8
"""Largest number of readable plots in one column."""

MOTION_QUANTITIES = ("position", "velocity", "acceleration")
"""Plotted quantities of a motion's joints, in order of the time derivative."""

TimeWindow = tuple[float, float]
"""Start and end of a time window [s]."""


def runs_blueprint(scenes: Sequence[Scene]) -> rrb.Blueprint:
    """Layout for runs: robots on the left, plots over time in tabs on the right.

    Several robots are placed above each other. Each run has a tab that contains its own tabs. The
    initial time window is that of the first run.

    Args:
        scenes: Runs to display.
    """
    count = len(scenes)
    roots = [run_entity_path(k, count) for k in range(count)]
    robots = [
        _robot_view(scene.run.name, scene.max_distance, path)
        for scene, path in zip(scenes, roots, strict=True)
    ]
    sides = [_run_tabs(scene, path) for scene, path in zip(scenes, roots, strict=True)]
    name = " | ".join(scene.run.name for scene in scenes)
    left = robots[0] if count == 1 else rrb.Vertical(*robots)
    right = sides[0] if count == 1 else rrb.Tabs(*sides)
    return _layout(left, right, name, scenes[0].time_window)


def live_blueprint(name: str, tree: Tree, size: float) -> rrb.Blueprint:
    """Layout for a running simulation: robot, wrench, joint positions and torques.

    Args:
        name: Name of the run.
        tree: The robot.
        size: Length that sets the camera distance, such as the reach of the robot [m].
    """
    wrench = [
        _time_plot(f"/wrench/{c}", f"{c} [{u}]")
        for c, u in zip(WRENCH_COMPONENTS, WRENCH_UNITS, strict=True)
    ]
    torque = [
        _time_plot(f"/torque/{escaped_path_part(joint)}", f"torque of {joint} [{unit}]")
        for joint, unit in zip(tree.names, channel_units(tree, "torque"), strict=True)
    ]
    tabs = rrb.Tabs(
        rrb.Grid(*wrench, grid_columns=2, name="wrench"),
        _joint_tab("", torque),
        name=name,
    )
    return _layout(_robot_view(name, size, ""), tabs, name, None)


def motion_blueprint(
    name: str, tree: Tree, size: float, kinds: Sequence[str], period: float
) -> rrb.Blueprint:
    """Layout for a motion: robot and tip paths, margins to limits, joints, notes.

    There is one plot of margins per kind of limit.

    Args:
        name: Name of the motion.
        tree: The robot.
        size: Length that sets the camera distance, such as the reach of the robot [m].
        kinds: Labels of the kinds of limits, for the titles of the plots.
        period: Period of the motion [s].
    """
    window = (0.0, period)
    margins = [
        _time_plot(f"/left/{k}", f"margin to {kind}", window, False)
        for k, kind in enumerate(kinds)
    ]
    joints = [
        rrb.Horizontal(
            *(
                _time_plot(
                    f"/{quantity}/{escaped_path_part(joint)}",
                    f"{quantity} of {joint}",
                    window,
                    False,
                )
                for quantity in MOTION_QUANTITIES
            )
        )
        for joint in tree.names
    ]
    tabs = rrb.Tabs(
        _plot_stack(margins, "limits"),
        _plot_stack(joints, "joints"),
        rrb.TextDocumentView(origin="/notes", name="notes"),
        name=name,
    )
    return _layout(
        _robot_view(name, size, "", "robot and the paths of its tips"),
        tabs,
        name,
        window,
    )


def _layout(
    left: rrb.View | rrb.Container,
    right: rrb.Container,
    name: str,
    window: TimeWindow | None,
) -> rrb.Blueprint:
    """Layout of two halves, with the viewer's panels collapsed.

    Args:
        left: Views in the left half.
        right: Views in the right half.
        name: Name of the layout.
        window: Initial time window [s]; None for the entire time.
    """
    selection = None
    if window is not None:
        selection = rrb.components.AbsoluteTimeRange(
            *(int(1e9 * seconds) for seconds in window)
        )
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[2, 3], name=name),
        rrb.TimePanel(
            state="collapsed",
            timeline=TIMELINE,
            time_selection=selection,
            loop_mode=None if selection is None else "selection",
        ),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
    )


def _robot_view(
    name: str, size: float, parent: str, content: str = "robot and reaction"
) -> rrb.Spatial3DView:
    """Three-dimensional view of a robot, with an initial camera position.

    Args:
        name: Name of the run or motion.
        size: Length that sets the camera distance, such as the reach of the robot [m].
        parent: Entity path of the run.
        content: Content of the view, for the title.
    """
    eye = rrb.EyeControls3D(
        position=(1.25 * size, -2.06 * size, 1.2 * size),
        look_target=(0, 0, 0.3 * size),
        eye_up=(0, 0, 1),
    )
    return rrb.Spatial3DView(
        origin=f"{parent}/world", name=f"{name}: {content}", eye_controls=eye
    )


def _run_tabs(scene: Scene, parent: str) -> rrb.Tabs:
    """Tabs of a run: wrench (if recorded), joint positions and torques, notes."""
    rows: dict[str, list[rrb.View | rrb.Container]] = {"wrench": [], "torque": []}
    for channel in scene.predictions.channels:
        rows[channel.kind].append(_channel_row(scene, channel, parent))
    return rrb.Tabs(
        *([_plot_stack(rows["wrench"], "wrench")] if rows["wrench"] else []),
        _joint_tab(parent, rows["torque"], scene.time_window),
        rrb.TextDocumentView(origin=f"{parent}/notes", name="notes"),
        name=scene.run.name,
        active_tab=0,
    )


def _joint_tab(
    parent: str,
    torque: Sequence[rrb.View | rrb.Container],
    window: TimeWindow | None = None,
) -> rrb.Vertical:
    """Tab with joint positions above plots of joint torques.

    Args:
        parent: Entity path of the run.
        torque: Plots of the joint torques.
        window: Initial time window [s].
    """
    positions = _time_plot(f"{parent}/position", "joint positions [rad or m]", window)
    shares = [1, min(len(torque), MAX_ROWS)] if torque else [1]
    torque_stack = [_plot_stack(torque, "torques")] if torque else []
    return rrb.Vertical(positions, *torque_stack, row_shares=shares, name="joints")


def _plot_stack(rows: Sequence[rrb.View | rrb.Container], name: str) -> rrb.Container:
    """Plots in one column, or in a grid with at most `MAX_ROWS` plots per column."""
    if len(rows) <= MAX_ROWS:
        return rrb.Vertical(*rows, name=name)
    return rrb.Grid(*rows, grid_columns=-(-len(rows) // MAX_ROWS), name=name)


def _channel_row(scene: Scene, channel: Channel, parent: str) -> rrb.Horizontal:
    """Row with a plot of a channel's signals and a plot of its residuals.

    The plot of residuals is left out without predictions. Only the first channel has a legend.
    """
    plots = {entity(parent, channel): channel.name}
    if channel.residuals:
        plots[entity(f"{parent}/residual", channel)] = f"{channel.name}: residual"
    legend = channel.index == 0
    return rrb.Horizontal(
        *(
            _time_plot(path, f"{title} [{channel.unit}]", scene.time_window, legend)
            for path, title in plots.items()
        )
    )


def _time_plot(
    origin: str, name: str, window: TimeWindow | None = None, legend: bool = True
) -> rrb.TimeSeriesView:
    """Plot of curves over time.

    Args:
        origin: Entity path of the curves.
        name: Title of the plot.
        window: Initial time window [s]; None for the entire time.
        legend: True to show the legend.
    """
    axis = None
    if window is not None:
        time_range = rr.TimeRange(
            start=rr.TimeRangeBoundary.absolute(seconds=window[0]),
            end=rr.TimeRangeBoundary.absolute(seconds=window[1]),
        )
        axis = rrb.TimeAxis(view_range=time_range, link="Independent")
    plot_legend = rrb.PlotLegend(corner=rrb.Corner2D.RightTop, visible=legend)
    return rrb.TimeSeriesView(
        origin=origin, name=name, plot_legend=plot_legend, axis_x=axis
    )
