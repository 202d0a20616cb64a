"""What stands where at first sight."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import testbed as tb
from testbed.experiment.growth import growth
from testbed.recordings.columns import AXES, PLATE_UNITS
from testbed.viewer.blueprint import blueprint, live_blueprint
from testbed.viewer.log import write_rrd
from testbed.viewer.overview import learned
from testbed.viewer.scene import Scene, scene_of
from tests.helpers.ideal import ideal
from tests.helpers.robots import random_robot
from tests.helpers.runs import ROBOTS, noisy, robot, run_of
from tests.helpers.viewer import entities

pytestmark = pytest.mark.slow


def views(part: Any) -> Iterator[Any]:
    """All views of a blueprint's part."""
    inner = getattr(part, "contents", None)
    if isinstance(inner, list | tuple):
        for each in inner:
            yield from views(each)
    else:
        yield part


def tabs_of(page: Any) -> Any:
    return page.root_container.contents[1]


def names(parts: Any) -> list[str]:
    return [part.name for part in parts]


def test_the_first_tab_shows_what_is_learned_beside_what_is_left_over(scene: Scene) -> None:
    tabs = tabs_of(blueprint([scene]))
    assert names(tabs.contents) == [
        "overview", "wrench", "joints", "friction", "estimates", "notes"
    ]  # fmt: skip
    assert tabs.active_tab in (0, "overview")
    values, rest = (column.contents for column in tabs.contents[0].contents)
    shown = learned(scene)
    assert [name.partition(":")[0] for name in names(values)] == [each.name for each in shown]
    assert [view.origin for view in rest] == [f"/residual/wrench/{axis}" for axis in AXES]


def test_signals_and_what_is_left_over_stand_side_by_side(scene: Scene) -> None:
    rows = tabs_of(blueprint([scene])).contents[1].contents
    assert len(rows) == 6
    for row, axis, unit in zip(rows, AXES, PLATE_UNITS, strict=True):
        signal, rest = row.contents
        assert signal.name == f"{axis} [{unit}]"
        assert rest.name.startswith(f"{axis}: residual [{unit}], ±")
        assert (signal.origin, rest.origin) == (f"/wrench/{axis}", f"/residual/wrench/{axis}")


def test_plots_below_each_other_have_one_scale_which_their_titles_say(scene: Scene) -> None:
    """Then their time axes begin at one place, too: labels of the scale are as wide in each."""
    tabs = tabs_of(blueprint([scene]))
    values, rest = (column.contents for column in tabs.contents[0].contents)
    smooth = {signal.kind: signal for signal in scene.smooth.signals}["wrench"]
    late = [
        np.abs(errors[each.time >= each.time[0] + np.ptp(each.time) / 3])
        for each in learned(scene)
        for errors in each.errors.values()
    ]
    widest = [np.max(late)] * len(values)
    for unit in ("N", "N m"):
        place = [k for k, other in enumerate(smooth.units) if other == unit]
        left = [np.abs(smooth.residual(method)[:, place]).max() for method in smooth.predicted]
        widest += [np.max(left)] * len(place)
    for view, largest in zip((*values, *rest), widest, strict=True):
        low, high = view.properties["ScalarAxis"].range.pa_array.to_pylist()[0]
        said = float(view.name.rpartition("±")[2])
        assert low == -high
        assert largest <= said < min(high, 2 * largest)
    for part in (values, rest):
        axes = [view.properties["TimeAxis"].view_range.pa_array.to_pylist() for view in part]
        assert all(axis == axes[0] for axis in axes)


@pytest.mark.parametrize("tab", ["wrench", "friction", "estimates", "notes"])
def test_the_tab_that_was_asked_for_is_in_front(scene: Scene, tab: str) -> None:
    tabs = tabs_of(blueprint([scene], tab))
    assert tabs.active_tab == names(tabs.contents).index(tab)


def test_plots_over_time_open_on_the_window(scene: Scene) -> None:
    tabs = tabs_of(blueprint([scene]))
    for tab in tabs.contents[1:3]:
        for view in views(tab):
            shown = view.properties["TimeAxis"].view_range.pa_array.to_pylist()[0]
            ends = [shown[side] for side in ("start", "end")]
            assert [round(end["value"] if isinstance(end, dict) else end, -3) for end in ends] == [
                round(1e9 * t, -3) for t in scene.window
            ]


@pytest.mark.parametrize("name", ROBOTS)
def test_every_view_looks_at_something(name: str, tmp_path: Path) -> None:
    run = run_of(robot(name))
    scene = scene_of(run, growth(run, [5.0]))
    write_rrd([scene], tmp_path / "r.rrd")
    there = entities(tmp_path / "r.rrd")
    seen = list(views(blueprint([scene]).root_container))
    assert len(seen) > 20
    for view in seen:
        assert any(f"{entity}/".startswith(f"{view.origin}/") for entity in there), view.origin


@pytest.mark.parametrize("name", ROBOTS)
def test_every_plot_has_its_unit(name: str) -> None:
    run = run_of(robot(name))
    scene = scene_of(run, growth(run, [5.0]))
    tabs = tabs_of(blueprint([scene]))
    kinds = {joint.name: joint.revolute for joint in run.tree.joints}
    for view in views(tabs):
        if view.origin == "/notes":
            continue
        assert "[" in view.name
        joint = view.origin.removeprefix("/friction/")
        if joint in kinds:
            units = ("N m", "rad/s") if kinds[joint] else ("N", "m/s")
            for unit in units:
                assert f"[{unit}]" in view.name


def test_growing_errors_are_scaled_by_the_late_ones(scene: Scene) -> None:
    """What the first seconds say does not matter."""
    wild = dict(scene.growth)
    for method, grown in scene.growth.items():
        values = grown.values.copy()
        values[0] *= 1e6
        wild[method] = replace(grown, values=values)
    tame, mad = (
        [view.properties["ScalarAxis"].range.pa_array.to_pylist() for view in views(each)]
        for each in (
            tabs_of(blueprint([one])).contents[4] for one in (scene, replace(scene, growth=wild))
        )
    )
    assert tame == mad


def test_a_robot_of_many_joints_stays_readable() -> None:
    """No more than eight plots one below the other."""
    tree = random_robot(np.random.default_rng(1), 20).tree()
    run = run_of(tree, noisy(ideal(tree, duration=5.0)))
    tabs = tabs_of(blueprint([scene_of(run, growth(run, [4.0]))]))

    def depth(part: Any) -> int:
        inner = getattr(part, "contents", None)
        if not isinstance(inner, list | tuple):
            return 1
        deep = [depth(each) for each in inner]
        kind = type(part).__name__
        if kind == "Vertical":
            return sum(deep)
        if kind == "Grid":
            columns = part.grid_columns or round(len(inner) ** 0.5)
            return -(-len(inner) // int(columns)) * max(deep)
        return max(deep)

    assert depth(tabs) <= 9


def test_without_estimates_there_are_signals_alone() -> None:
    tree = robot("puma")
    run = run_of(tree, ideal(tree).part(0, 5))
    tabs = tabs_of(blueprint([scene_of(run)]))
    assert names(tabs.contents)[-1] == "notes"
    assert "estimates" not in names(tabs.contents)


def test_while_it_is_simulated_there_are_robot_wrench_and_torques(puma: tb.Tree) -> None:
    page = live_blueprint("table6", puma, 1.5)
    origins = [view.origin for view in views(page.root_container)]
    assert origins[0] == "/world"
    assert origins[1:7] == [f"/wrench/{axis}" for axis in AXES]
    assert origins[7:] == ["/position", *(f"/torque/{name}" for name in puma.names)]
