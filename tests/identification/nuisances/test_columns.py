"""What a nuisance adds to the wrench is what the instruments' own fault of that kind does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.dynamics.motion import Motion
from testbed.identification.filters import row_weights
from testbed.identification.nuisances.all_nuisances import NUISANCES, TESTED
from testbed.identification.nuisances.foretold import row_filter
from testbed.identification.nuisances.nuisance import Nuisance
from testbed.identification.nuisances.unknowns import Columns, unknowns_of
from testbed.identification.windows import make_plan
from testbed.instruments.fault import Fault
from testbed.instruments.faults import fault_of
from testbed.kernel.layout import layout
from testbed.recordings.recording import Recording
from tests.helpers.ideal import ideal
from tests.helpers.runs import ROBOTS, robot

SMALL = 1e-6
ALL = {n.kind: n for n in (*NUISANCES, *TESTED)}
TARE = np.array([3.0, -2.0, 200.0, 4.0, -5.0, 1.0])
SETTINGS = tb.Settings(position_cutoff="off")


def on_plate(table: dict[str, object]) -> Callable[[tb.Tree, Recording], Array]:
    """Change of the wrench by a fault of the plate, (M, 6)."""

    def changed(tree: tb.Tree, recording: Recording) -> Array:
        del tree
        fault: Fault = fault_of(table)
        wrench = recording.measured("wrench")
        rng = np.random.default_rng(0)
        return (fault.apply(wrench, recording.time, rng) - wrench) / SMALL

    return changed


def of_encoder(joint: int, table: dict[str, object]) -> Callable[[tb.Tree, Recording], Array]:
    """Change of what the model leaves of the wrench by a fault of an encoder, (M, 6)."""

    def changed(tree: tb.Tree, recording: Recording) -> Array:
        size = [0.0] * tree.n
        size[joint] = SMALL
        key = {"encoder_zero_error": "error", "encoder_gain": "error"}.get(str(table["kind"]), "")
        q = recording.position
        shown = fault_of(table | {key: size}).apply(q, recording.time, np.random.default_rng(0))
        grown = 1 + np.array(size) if table["kind"] == "encoder_gain" else 1.0
        assert recording.velocity is not None
        assert recording.acceleration is not None
        rates = recording.velocity, recording.acceleration
        true = Motion(recording.time, q, *rates)
        seen = Motion(recording.time, shown, *(rate * grown for rate in rates))
        return -(tb.base_wrench(tree, seen) - tb.base_wrench(tree, true)) / SMALL

    return changed


def of_time(joint: int | None) -> Callable[[tb.Tree, Recording], Array]:
    """The same of one encoder that is late, or of stamps that are too close together."""

    def changed(tree: tb.Tree, recording: Recording) -> Array:
        q, qd, qdd = recording.position, recording.velocity, recording.acceleration
        assert qd is not None
        assert qdd is not None
        if joint is None:
            seen = Motion(recording.time, q, (1 + SMALL) * qd, (1 + 2 * SMALL) * qdd)
        else:
            late = np.where(np.arange(tree.n) == joint, SMALL, 0.0)
            jerk = np.gradient(qdd, recording.time, axis=0, edge_order=2)
            seen = Motion(recording.time, q - late * qd, qd - late * qdd, qdd - late * jerk)
        true = Motion(recording.time, q, qd, qdd)
        return -(tb.base_wrench(tree, seen) - tb.base_wrench(tree, true)) / SMALL

    return changed


def unit(k: int, length: int = 6) -> list[float]:
    return [SMALL if j == k else 0.0 for j in range(length)]


def pairs(k: int) -> list[list[float]]:
    return felt([6 * a + b for a in range(6) for b in range(6) if a != b][k])


def felt(k: int) -> list[list[float]]:
    matrix = np.zeros((6, 6))
    scale = [500.0, 500.0, 1000.0, 200.0, 200.0, 100.0]
    matrix[k // 6, k % 6] = SMALL * scale[k % 6] / scale[k // 6]
    return matrix.tolist()


WITNESSES: dict[str, Callable[[int], Callable[[tb.Tree, Recording], Array]]] = {
    "bias": lambda k: on_plate({"kind": "plate_bias", "force": unit(k)[:3], "moment": unit(k)[3:]}),
    "pose": lambda k: on_plate(
        {"kind": "plate_pose", "rotation": unit(k)[:3], "translation": unit(k)[3:]}
    ),
    "height": lambda k: on_plate({"kind": "plate_origin_height", "height": SMALL}),
    "skew": lambda k: on_plate({"kind": "plate_delay", "delay": SMALL}),
    "gains": lambda k: on_plate({"kind": "plate_gain", "error": unit(k)}),
    "crosstalk": lambda k: on_plate({"kind": "plate_crosstalk", "size": 0.0, "matrix": pairs(k)}),
    "matrix": lambda k: on_plate({"kind": "plate_crosstalk", "size": 0.0, "matrix": felt(k)}),
    "joint_zeros": lambda k: of_encoder(k, {"kind": "encoder_zero_error"}),
    "encoder_gains": lambda k: of_encoder(k, {"kind": "encoder_gain"}),
    "encoder_delays": of_time,
    "sampling": lambda k: of_time(None),
}


def recorded(tree: tb.Tree) -> Recording:
    """A perfect recording of the robot on its pedestal."""
    found = ideal(tree, duration=8.0, seed=3)
    return replace(found, wrench=found.measured("wrench") + TARE, tare=TARE, truth=None)


def columns_of(
    tree: tb.Tree, recording: Recording, nuisance: Nuisance, *, estimated: bool = False
) -> Array:
    """The nuisance's columns, (6, rows, k)."""
    minimal = tb.minimal_set(tree, "reaction")
    plan = make_plan(recording, layout(tree, minimal), TARE, SETTINGS)
    cutoff = SETTINGS.row_low_pass
    assert cutoff is not None
    unknowns = unknowns_of(tree, [nuisance])
    made = Columns(
        plan,
        row_filter(plan, cutoff),
        minimal.values(tb.barycentric(tree)),
        [unknowns],
        unknowns if estimated else None,
    )
    parts = []
    for window in plan.windows():
        signals = plan.signals(recording.part(window.first, window.last), window)
        parts.append(made(signals, window.row))
    return np.concatenate(parts, axis=1)


def filtered(signal: Array, rate: float) -> Array:
    """Rows of a signal as the identification takes them, (rows, 6)."""
    weights = row_weights(rate, SETTINGS.row_low_pass)
    step = int(rate / 10)
    return np.stack([np.convolve(c, weights, "valid")[::step] for c in signal.T], axis=1)


@pytest.mark.slow
@pytest.mark.parametrize("kind", WITNESSES)
@pytest.mark.parametrize("name", ROBOTS)
def test_columns_are_what_the_fault_does(name: str, kind: str) -> None:
    tree = robot(name)
    recording = recorded(tree)
    found = columns_of(tree, recording, ALL[kind])
    wanted = np.stack(
        [
            filtered(WITNESSES[kind](k)(tree, recording), recording.rate).T
            for k in range(found.shape[2])
        ],
        axis=2,
    )
    rows = min(found.shape[1], wanted.shape[1])
    assert rows > 60
    size = np.abs(wanted).max(axis=(0, 1)) + 1e-9 * np.abs(wanted).max()
    np.testing.assert_allclose(found[:, :rows] / size, wanted[:, :rows] / size, atol=1e-3)


@pytest.mark.parametrize("name", ROBOTS)
def test_drifts_and_clock_rates_grow_from_the_middle(name: str) -> None:
    tree = robot(name)
    recording = recorded(tree)
    slope, bias = (columns_of(tree, recording, ALL[kind]) for kind in ("slope", "bias"))
    rate, skew = (columns_of(tree, recording, ALL[kind]) for kind in ("clock_rate", "skew"))
    time = slope[0, :, 0]
    np.testing.assert_allclose(np.diff(time), 0.1, atol=1e-9)
    assert abs(time.mean()) < 0.1
    np.testing.assert_allclose(slope, time[:, None] * bias)
    np.testing.assert_allclose(rate, time[:, None] * skew)


@pytest.mark.parametrize("kind", [n.kind for n in NUISANCES if n.by_measured])
@pytest.mark.parametrize("name", ROBOTS)
def test_columns_of_the_measured_wrench_are_those_of_the_foretold_one(name: str, kind: str) -> None:
    """Where there is no noise."""
    tree = robot(name)
    recording = recorded(tree)
    foretold = columns_of(tree, recording, ALL[kind])
    measured = columns_of(tree, recording, ALL[kind], estimated=True)
    np.testing.assert_allclose(measured, foretold, atol=1e-3 * np.abs(foretold).max())


@pytest.mark.parametrize("name", ROBOTS)
def test_encoders_that_are_late_together_are_a_plate_that_is_early(name: str) -> None:
    tree = robot(name)
    recording = recorded(tree)
    each, skew = (columns_of(tree, recording, ALL[kind]) for kind in ("encoder_delays", "skew"))
    np.testing.assert_allclose(each.sum(axis=2), -skew[..., 0], atol=1e-3 * np.abs(skew).max())


def test_a_tare_shows_as_a_bias_does() -> None:
    tree = robot("puma")
    recording = recorded(tree)
    tare, bias = (columns_of(tree, recording, ALL[kind]) for kind in ("tare", "bias"))
    np.testing.assert_array_equal(tare, bias)
    other: dict[str, Any] = {"kind": "", "said": "", "parts": (), "passing": False}
    assert replace(ALL["tare"], **other) == replace(ALL["bias"], **other)


def test_eccentric_encoders_err_with_the_sine_of_their_angle() -> None:
    """A small one, against the equations of the motion that such encoders would show."""
    tree = robot("ur5")
    recording = recorded(tree)
    found = columns_of(tree, recording, ALL["eccentricity"])
    q, qd, qdd = recording.position, recording.velocity, recording.acceleration
    assert qd is not None
    assert qdd is not None
    for joint in range(tree.n):
        for k, lead in enumerate((0.0, np.pi / 2)):
            x = q[:, joint] + lead
            seen = [q.copy(), qd.copy(), qdd.copy()]
            seen[0][:, joint] += SMALL * np.sin(x)
            seen[1][:, joint] += SMALL * np.cos(x) * qd[:, joint]
            second = np.cos(x) * qdd[:, joint] - np.sin(x) * qd[:, joint] ** 2
            seen[2][:, joint] += SMALL * second
            gap = tb.base_wrench(tree, Motion(recording.time, *seen))
            gap = -(gap - tb.base_wrench(tree, Motion(recording.time, q, qd, qdd))) / SMALL
            wanted = filtered(gap, recording.rate).T
            own = found[:, : wanted.shape[1], 2 * joint + k]
            np.testing.assert_allclose(own, wanted, atol=1e-3 * np.abs(wanted).max() + 1e-6)
