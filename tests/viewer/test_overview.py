"""What the viewer shows first: parameters as the data grow."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from testbed.experiment.growth import growth
from testbed.experiment.run import Run
from testbed.identification.estimate import METHODS
from testbed.identification.influence import influence
from testbed.viewer import overview
from testbed.viewer.log import write_rrd
from testbed.viewer.overview import MOST, Learned, learned, scale_of
from testbed.viewer.scene import scene_of
from tests.helpers.viewer import columns, entities


@pytest.mark.slow
def test_what_both_tell_and_adds_most_is_shown(puma_run: Run) -> None:
    shown = learned(scene_of(puma_run, growth(puma_run)))
    assert len(shown) == MOST
    adds = dict.fromkeys(puma_run.estimates["internal"].base.names, 0.0)
    for estimate in puma_run.estimates.values():
        shares = dict(zip(estimate.names, influence(estimate, puma_run.truths), strict=True))
        adds = {name: max(share, shares[name]) for name, share in adds.items()}
    order = sorted(adds, key=lambda name: -adds[name])
    assert [each.name for each in shown] == order[:MOST]
    for each in shown:
        truth = puma_run.truths[each.name]
        for method in METHODS:
            base = puma_run.estimates[method].base
            off = base.values[base.names.index(each.name)] - truth
            assert each.errors[method][-1] == pytest.approx(100 * off / abs(truth))
            assert abs(each.errors[method][-1]) <= scale_of(shown)


@pytest.mark.slow
def test_one_method_and_no_truth_are_enough(puma_run: Run, tmp_path: Path) -> None:
    for method in METHODS:
        alone = replace(puma_run, estimates={method: puma_run.estimates[method]}, score=None)
        scene = scene_of(alone, growth(alone))
        shown = learned(scene)
        assert [set(each.errors) for each in shown] == [{method}] * MOST
        assert [each.errors[method][-1] for each in shown] == [0.0] * MOST
        write_rrd([scene], tmp_path / "run.rrd")
        there = entities(tmp_path / "run.rrd")
        assert {f"/overview/{k}" for k in range(MOST)} <= there
        drawn = columns(tmp_path / "run.rrd", "/overview/0", "Scalars:scalars")
        told = shown[0].errors[method]
        np.testing.assert_allclose(drawn.ravel(), told[np.isfinite(told)])
    assert learned(scene_of(puma_run, {})) == ()


def test_the_plots_scale_does_not_depend_on_when_the_clock_was_set() -> None:
    """The first third of a recording, of which little is known, sets no scale."""
    time, errors = np.linspace(0.0, 10.0, 21), np.append(np.full(6, 1e6), np.linspace(11, 0, 15))
    scales = [
        scale_of([Learned("m", time + shift, {"external": errors})]) for shift in (0, -3, 1e4)
    ]
    assert scales == [15.0] * 3


def test_methods_that_share_no_name_are_shown_by_the_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """As of sets by other zeros: the second has nothing to stand beside it."""

    def base(*names: str) -> SimpleNamespace:
        sigma = np.ones(len(names))
        base = SimpleNamespace(names=names, units=("kg",) * len(names), values=sigma, sigma=sigma)
        return SimpleNamespace(base=base)

    estimates = {"external": base("m1", "m2"), "internal": base("K1", "K2", "K3")}
    time = np.arange(3.0)
    grown = {
        method: SimpleNamespace(time=time, values=np.ones((3, len(each.base.names))))
        for method, each in estimates.items()
    }
    scene: Any = SimpleNamespace(
        growth=grown, run=SimpleNamespace(estimates=estimates, truths={"m2": 3.0})
    )
    monkeypatch.setattr(overview, "by_influence", lambda *_: ["K1", "m1", "K2", "m2", "K3"])
    found = learned(scene)
    first = METHODS[0]
    assert tuple(each.name for each in found) == estimates[first].base.names
    assert all(set(each.errors) == {first} for each in found)
