"""How the viewer arranges a run at first sight."""

from __future__ import annotations

from collections.abc import Sequence

import rerun.blueprint as rrb

from testbed.recordings.columns import AXES
from testbed.viewer.story import Story, extent, root, safe, span

UNITS = dict(zip(AXES, ("N",) * 3 + ("N m",) * 3, strict=True))


def blueprint(stories: Sequence[Story], tab: str = "wrench") -> rrb.Blueprint:
    """Robots on their plates to the left, everything over time to the right, in tabs.

    Args:
        stories: One run, or several side by side.
        tab: Which tab is in front: "wrench", "joints", "residuals", "friction", "estimates".
    """
    count = len(stories)
    roots = [root(k, count) for k in range(count)]
    robots = [_robot(story, at) for story, at in zip(stories, roots, strict=True)]
    sides = [_tabs(story, at, tab) for story, at in zip(stories, roots, strict=True)]
    names = [story.name for story in stories]
    left = robots[0] if count == 1 else rrb.Vertical(*robots)
    right = sides[0] if count == 1 else rrb.Tabs(*sides)
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[2, 3], name=" | ".join(names)),
        rrb.TimePanel(state="collapsed"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
    )


def _robot(story: Story, at: str) -> rrb.Spatial3DView:
    size = span(story)
    eye = rrb.EyeControls3D(
        position=(1.3 * size, -1.3 * size, 1.0 * size),
        look_target=(0, 0, 0.35 * size),
        eye_up=(0, 0, 1),
    )
    return rrb.Spatial3DView(
        origin=f"{at}/world", name=f"{story.name}: robot and reaction", eye_controls=eye,
        background=rrb.Background(color=(250, 250, 252)),
    )  # fmt: skip


def _tabs(story: Story, at: str, tab: str) -> rrb.Tabs:
    names = story.tree.names
    unit = ["N m" if joint.revolute else "N" for joint in story.tree.joints]
    wrench = [_plot(f"{at}/wrench/{c}", f"{c} [{UNITS[c]}]", c == "Fx") for c in AXES]
    torque = [
        _plot(f"{at}/torque/{safe(name)}", f"torque of {name} [{u}]")
        for name, u in zip(names, unit, strict=True)
    ]
    views = [
        rrb.Grid(*wrench, grid_columns=2, name="wrench"),
        rrb.Grid(
            _plot(f"{at}/position", "joint positions [rad or m]"), *torque,
            grid_columns=1 if len(names) < 4 else 2, name="joints",
        ),
    ]  # fmt: skip
    if story.wrench:
        rest = [
            _plot(f"{at}/residual/wrench/{c}", f"residual {c} [{UNITS[c]}]", c == "Fx")
            for c in AXES
        ]
        views.append(rrb.Grid(*rest, grid_columns=2, name="residuals"))
    if "external" in story.estimates:
        bounds = rrb.VisualBounds2D(x_range=[-1.2, 1.2], y_range=[-1.2, 1.2])
        curves = [
            rrb.Spatial2DView(
                origin=f"{at}/friction/{safe(name)}",
                name=_friction(story, j),
                visual_bounds=bounds,
                background=rrb.Background(color=(250, 250, 252)),
            )
            for j, name in enumerate(names)
        ]
        views.append(rrb.Grid(*curves, name="friction"))
    if story.growth:
        method = next(iter(story.growth))
        base = story.estimates[method].base
        units = zip(base.names, base.units, strict=True)
        plots = [
            _plot(f"{at}/estimate/{safe(name)}", f"{name} [{u}]", legend=k == 0)
            for k, (name, u) in enumerate(units)
        ]
        views.append(rrb.Grid(*plots, name="estimates"))
    front = next((k for k, view in enumerate(views) if view.name == tab), 0)
    return rrb.Tabs(*views, name=story.name, active_tab=front)


def _friction(story: Story, j: int) -> str:
    """Title of a friction curve: its axes end at these values."""
    speed, torque = extent(story, j)
    units = ("rad/s", "N m") if story.tree.joints[j].revolute else ("m/s", "N")
    return (
        f"{story.tree.names[j]}: friction to {torque:.2g} {units[1]} "
        f"over velocity to {speed:.2g} {units[0]}"
    )


def _plot(origin: str, name: str, legend: bool = True) -> rrb.TimeSeriesView:
    shown = rrb.PlotLegend(corner=rrb.Corner2D.RightTop, visible=legend)
    return rrb.TimeSeriesView(origin=origin, name=name, plot_legend=shown)
