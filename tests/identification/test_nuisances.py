"""Numbers of the instrument are found beside the robot's, as far as any motion tells them.

If one fails, a fault of plate or encoder goes into the robot's parameters.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import testbed as tb
from testbed.core.base.arrays import Array
from testbed.core.estimation.regression import windows
from testbed.core.estimation.regression.windows import make_plan, row_weights
from testbed.core.estimation.sensor.correction import NUISANCES, TESTED
from testbed.core.estimation.sensor.plate import shifted
from testbed.core.estimation.sensor.predicted_wrench import row_filter
from testbed.core.estimation.sensor.unknowns import Columns, unknowns_of
from testbed.core.kernel.layout import layout
from testbed.core.recordings.recording import Recording
from testbed.lab.instruments.fault import Fault
from testbed.lab.instruments.faults import fault_of
from tests.helpers.ideal import ideal
from tests.helpers.measured import measured
from tests.helpers.runs import robot

SMALL = 1e-6
ALL = {each.kind: each for each in (*TESTED, *NUISANCES)}
TARE = np.array([3.0, -2.0, 200.0, 4.0, -5.0, 1.0])
FULL = np.array([500.0, 500.0, 1000.0, 200.0, 200.0, 100.0])


def shown(recording: Recording, kind: str, v: Array) -> Recording:
    """With a fault of the plate, of the nuisance's numbers."""
    matrix = np.zeros((6, 6))
    if kind in ("crosstalk", "matrix"):
        matrix[~np.eye(6, dtype=bool) if kind == "crosstalk" else np.ones((6, 6), dtype=bool)] = v
    tables: dict[str, dict[str, Any]] = {
        "bias": {"kind": "plate_bias", "force": v[:3], "moment": v[3:]},
        "slope": {"kind": "plate_drift", "force": v[:3], "moment": v[3:]},
        "pose": {"kind": "plate_pose", "rotation": v[:3], "translation": v[3:]},
        "height": {"kind": "plate_pose", "rotation": 0.0, "translation": [0.0, 0.0, v[0]]},
        "skew": {"kind": "plate_delay", "delay": v[0]},
        "gains": {"kind": "plate_gain", "error": v},
        "matrix": {"kind": "plate_crosstalk", "size": 0.0, "matrix": matrix * FULL / FULL[:, None]},
    }
    table = tables[{"tare": "bias", "crosstalk": "matrix"}.get(kind, kind)]
    listed = {k: x.tolist() if isinstance(x, np.ndarray) else x for k, x in table.items()}
    fault: Fault = fault_of(listed)
    rng = np.random.default_rng(0)
    wrench = fault.apply(recording.measured("wrench"), recording.time, rng)
    return replace(recording, wrench=wrench)


def on_pedestal(tree: tb.Tree, duration: float) -> Recording:
    """A perfect recording."""
    found = ideal(tree, duration=duration, seed=3)
    return replace(found, wrench=found.measured("wrench") + TARE, tare=TARE, truth=None)


def columns_of(recording: Recording, tree: tb.Tree, kind: str, estimated: bool = False) -> Array:
    """The nuisance's columns, (6, rows, k)."""
    minimal, settings = tb.minimal_set(tree, "reaction"), tb.Settings(position_cutoff="off")
    plan = make_plan(recording, layout(tree, minimal), TARE, settings)
    cutoff, unknowns = settings.row_low_pass, unknowns_of(tree, [ALL[kind]])
    assert cutoff is not None
    made = Columns(
        plan,
        row_filter(plan, cutoff),
        minimal.values(tb.barycentric(tree)),
        [unknowns],
        unknowns if estimated else None,
    )
    parts = (made(plan.signals(recording.part(w.first, w.last), w), w.row) for w in plan.windows())
    return np.concatenate(list(parts), axis=1)


def encoder_errors(kind: str, recording: Recording, tree: tb.Tree) -> list[list[Array]]:
    """Errors of positions, velocities and accelerations, number by number."""
    q, qd, qdd = (recording.measured(s) for s in ("position", "velocity", "acceleration"))
    jerk, one = np.gradient(qdd, recording.time, axis=0, edge_order=2), np.eye(tree.n)
    if kind == "sampling":
        return [[0 * q, qd, 2 * qdd]]
    waves = [[np.sin(q), np.cos(q) * qd, np.cos(q) * qdd - np.sin(q) * qd**2]]
    waves += [[np.cos(q), -np.sin(q) * qd, -np.sin(q) * qdd - np.cos(q) * qd**2]]
    of_all = {
        "joint_zeros": [[q**0, 0 * q, 0 * q]],
        "encoder_gains": [[q, qd, qdd]],
        "encoder_delays": [[-qd, -qdd, -jerk]],
        "eccentricity": waves,
    }[kind]
    places = [k for k in range(tree.n) if kind != "eccentricity" or tree.joints[k].revolute]
    return [[one[k] * part for part in parts] for k in places for parts in of_all]


def effects(kind: str, recording: Recording, tree: tb.Tree) -> list[Array]:
    """Change of what the model leaves of the wrench, number by number, (M, 6)."""
    if kind in ("joint_zeros", "encoder_gains", "encoder_delays", "eccentricity", "sampling"):
        states = [recording.measured(s) for s in ("position", "velocity", "acceleration")]
        before = tb.base_wrench(tree, tb.Motion(recording.time, *states))
        moved = [
            [x + SMALL * dx for x, dx in zip(states, each, strict=True)]
            for each in encoder_errors(kind, recording, tree)
        ]
        after = (tb.base_wrench(tree, tb.Motion(recording.time, *each)) for each in moved)
        return [(before - each) / SMALL for each in after]
    count = len(ALL[kind].parts(tree))
    rows = (shown(recording, kind, SMALL * unit).measured("wrench") for unit in np.eye(count))
    return [(each - recording.measured("wrench")) / SMALL for each in rows]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["puma", "random"])
def test_columns_are_what_the_fault_does(name: str) -> None:
    """Of every kind: by the instrument's own model of it, or by the wrench of another motion."""
    tree = robot(name)
    recording, settings = on_pedestal(tree, 8.0), tb.Settings(position_cutoff="off")
    weights, step = row_weights(recording.rate, settings.row_low_pass), int(recording.rate / 10)
    columns = {kind: columns_of(recording, tree, kind) for kind in ALL}
    for kind in set(ALL) - {"slope", "clock_rate", "tare", "next_bias"}:
        found = columns[kind]
        wanted = [
            np.stack([np.convolve(c, weights, "valid")[::step] for c in each.T])
            for each in effects(kind, recording, tree)
        ]
        assert found.shape[2] == len(wanted), kind
        rows = min(found.shape[1], wanted[0].shape[1])
        assert rows > 60
        together = np.stack(wanted, axis=2)[:, :rows]
        size = np.abs(together).max(axis=(0, 1)) + 1e-9 * np.abs(together).max()
        gap = np.abs(found[:, :rows] - together) / size
        assert gap.max() < 1e-3, kind
    time = columns["slope"][0, :, 0]
    assert abs(time.mean()) < 0.1
    np.testing.assert_allclose(np.diff(time), 0.1, atol=1e-9)
    np.testing.assert_allclose(columns["slope"], time[:, None] * columns["bias"])
    np.testing.assert_allclose(columns["clock_rate"], time[:, None] * columns["skew"])
    np.testing.assert_array_equal(columns["tare"], columns["bias"])
    for kind in [each.kind for each in NUISANCES if each.by_measured]:
        own = columns_of(recording, tree, kind, estimated=True)
        np.testing.assert_allclose(own, columns[kind], atol=1e-3 * np.abs(columns[kind]).max())


VALUES = {
    "bias": np.array([1.0, -2.0, 0.0, 0.3, -0.4, 0.5]),
    "tare": np.array([2.0, 1.0, 0.0, 0.5, -0.5, 0.1]),
    "slope": np.array([0.1, -0.2, 0.1, 0.01, 0.02, -0.03]),
    "pose": np.array([0.02, -0.01, 0.03, 2e-3, 4e-3, -3e-3]),
    "height": np.array([0.02]),
    "skew": np.array([7.3e-3]),
    "matrix": np.random.default_rng(5).uniform(-0.01, 0.01, 36),
    "joint_zeros": np.array([-0.007, 0.003, 0.013]),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["tare", "pose", "joint_zeros"])
def test_what_was_added_is_found_or_named(kind: str) -> None:
    """Far beyond first order; what no motion tells is among the warnings, by its name."""
    tree = robot("puma").without_friction()
    right, values = on_pedestal(tree, 12.0), VALUES[kind]
    if kind == "joint_zeros":
        recording = replace(right, position=right.position + values)
    else:
        recording = shown(right, kind, values)
    settings = tb.Settings(position_cutoff="off", zeros=True, nuisances=[kind])
    found = tb.identify(tree, recording, settings=settings)
    wanted = {part.name: x for part, x in zip(ALL[kind].parts(tree), values, strict=True)}
    told = {each.name: each.value for each in found.nuisances}
    hidden = wanted.keys() - told.keys()
    assert hidden == ({"tare/Fz"} if kind == "tare" else set())
    said = " ".join(d.subject for d in found.diagnostics if d.code == "plate.collinear")
    assert {name for name in wanted if name in said} == hidden
    size = np.abs(values).max(initial=1.0)
    assert max(abs(told[name] - wanted[name]) for name in told) < 3e-6 * size
    truth = found.minimal.values(tb.barycentric(tree))
    assert found.noise is not None
    assert not hidden or "mbar1" in found.noise.hidden
    seen = [k for k, n in enumerate(found.names) if n not in found.noise.hidden]
    np.testing.assert_allclose(found.values[seen], truth[seen], atol=3e-5 * np.abs(truth).max())


def test_what_the_fault_does_is_undone() -> None:
    """By the nuisance's inverse, which shares no code with the fault; shifts in time are exact."""
    tree = robot("ur5")
    exact = on_pedestal(tree, 2.0)
    for kind in set(VALUES) - {"joint_zeros"}:
        undo, values = ALL[kind].undo, VALUES[kind]
        assert undo is not None
        scaled = np.ravel(np.eye(6)) + values if kind == "matrix" else values
        back = undo(shown(exact, kind, values), scaled, exact.time, tree)
        gap = back.measured("wrench")[10:-10] - exact.measured("wrench")[10:-10]
        assert np.abs(gap).max() < 1e-6, kind
    t, powers = np.arange(60.0)[:, None] / 10, np.arange(8)
    for samples in (0.0, 3.0, -2.0, 0.5, 7.25, -1.75):
        wanted = ((t + samples / 10) ** powers)[12:-12]
        np.testing.assert_allclose(shifted(t**powers, samples)[12:-12], wanted, rtol=1e-9)


def test_a_long_recording_is_looked_at_evenly(monkeypatch: pytest.MonkeyPatch) -> None:
    """From its first window to its last: a fault of one part would pass for none."""
    monkeypatch.setattr(windows, "WINDOW", 1000)
    tree = robot("puma")
    rows = layout(tree.without_inertias(), tb.minimal_set(tree, "reaction"))
    plan = make_plan(measured(tree, 1, duration=260.0, rate=100.0), rows, TARE, tb.Settings())
    every = [window.row for window in plan.windows()]
    for most in (10_000, 4, 3):
        monkeypatch.setattr(windows, "LOOKED_AT", most)
        at = [every.index(row) for row in sorted(replace(plan).looked_at)]
        assert (len(at), at[0], at[-1]) == (min(most, len(every)), 0, len(every) - 1)
        assert np.ptp(np.diff(at)) <= 1
