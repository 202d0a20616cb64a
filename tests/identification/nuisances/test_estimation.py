"""Nuisances are found with the parameters, exactly where nothing else is wrong."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.errors import SettingsError, UnknownName
from testbed.identification.nuisances.all_nuisances import NUISANCES
from testbed.identification.nuisances.clock import shifted
from testbed.identification.nuisances.structure import told_apart
from testbed.instruments.faults import fault_of
from testbed.kernel.layout import layout
from testbed.recordings.recording import Recording
from tests.helpers.ideal import ideal
from tests.helpers.measured import measured
from tests.helpers.robots import random_robot
from tests.helpers.runs import ROBOTS, robot

pytestmark = pytest.mark.slow

SETTINGS = {"position_cutoff": "off", "terms": ()}
TARE = np.array([3.0, -2.0, 200.0, 4.0, -5.0, 1.0])

PLATE: dict[str, dict[str, Any]] = {
    "bias": {"kind": "plate_bias", "force": [1.0, -2.0, 0.0], "moment": [0.3, -0.4, 0.5]},
    "slope": {"kind": "plate_drift", "force": [0.1, -0.2, 0.1], "moment": [0.01, 0.02, -0.03]},
    "pose": {
        "kind": "plate_pose",
        "rotation": [0.02, -0.01, 0.03],
        "translation": [2e-3, 4e-3, -3e-3],
    },
    "height": {"kind": "plate_origin_height", "height": 0.02},
    "skew": {"kind": "plate_delay", "delay": 7.3e-3},
    "tare": {"kind": "plate_bias", "force": [2.0, 1.0, 0.0], "moment": [0.5, -0.5, 0.1]},
}


MIXING = np.random.default_rng(5).uniform(-0.01, 0.01, (6, 6))
SCALE = np.array([500.0, 500.0, 1000.0, 200.0, 200.0, 100.0])
PLATE["matrix"] = {"kind": "plate_crosstalk", "size": 0.0, "matrix": MIXING.tolist()}


def faulty(tree: tb.Tree, kind: str) -> Recording:
    """A perfect recording of the robot on its pedestal but for one fault."""
    found = ideal(tree, duration=12.0, seed=3)
    found = replace(found, wrench=found.measured("wrench") + TARE, tare=TARE, truth=None)
    if kind == "joint_zeros":
        return replace(found, position=found.position + zeros(tree))
    fault, rng = fault_of(PLATE[kind]), np.random.default_rng(0)
    return replace(found, wrench=fault.apply(found.measured("wrench"), found.time, rng))


def zeros(tree: tb.Tree) -> Array:
    return np.linspace(-0.01, 0.01, tree.n) + 0.003


def expected(tree: tb.Tree, kind: str) -> Array:
    table = PLATE.get(kind, {})
    if kind == "joint_zeros":
        return zeros(tree)
    if kind == "matrix":
        return np.ravel(np.eye(6) + MIXING * SCALE[:, None] / SCALE)
    if kind == "slope":
        return np.array([*table["force"], *table["moment"]])
    by_kind = {
        "bias": ("force", "moment"),
        "tare": ("force", "moment"),
        "pose": ("rotation", "translation"),
        "height": ("height",),
        "skew": ("delay",),
    }
    return np.concatenate([np.atleast_1d(table[key]) for key in by_kind[kind]])


@pytest.mark.parametrize("kind", ["pose", "height", "skew"])
@pytest.mark.parametrize("name", ROBOTS)
def test_what_was_added_is_found(name: str, kind: str) -> None:
    """Large ones, far beyond first order."""
    tree = robot(name).without_friction()
    recording = faulty(tree, kind)
    found = tb.identify(tree, recording, settings=tb.Settings(nuisances=[kind], **SETTINGS))  # type: ignore[arg-type]
    values = np.array([each.value for each in found.nuisances])
    wanted = expected(tree, kind)
    np.testing.assert_allclose(values, wanted, atol=2e-6 * max(1.0, np.abs(wanted).max()))
    truth = found.minimal.values(tb.barycentric(tree))
    np.testing.assert_allclose(found.values, truth, atol=3e-5 * np.abs(truth).max())


@pytest.mark.parametrize("kind", ["bias", "tare", "slope", "joint_zeros"])
@pytest.mark.parametrize("name", ROBOTS)
def test_what_can_be_told_is_found_and_the_rest_is_named(name: str, kind: str) -> None:
    """Where a number is imitated, what imitates it is as wrong as the warning says, no more."""
    tree = robot(name).without_friction()
    recording = faulty(tree, kind)
    found = tb.identify(tree, recording, settings=tb.Settings(nuisances=[kind], **SETTINGS))  # type: ignore[arg-type]
    said = [w.split(" from ")[0] for w in found.warnings if w.startswith("no motion tells")]
    held = {word.strip(",") for line in said for word in line.split()}
    names = [part.name for n in NUISANCES if n.kind == kind for part in n.parts(tree)]
    wanted = dict(zip(names, expected(tree, kind), strict=True))
    told = {each.name: each.value for each in found.nuisances}
    for name_ in names:
        assert (name_ in told) != (name_ in held)
    if kind == "joint_zeros":  # imitated zeros bend what depends on them
        return
    size = max(map(abs, wanted.values()))
    hidden = set(found.noise.hidden) if found.noise else set()
    truth = found.minimal.values(tb.barycentric(tree))
    if not any(wanted[n] for n in names if n not in told):
        for name_, value in told.items():
            assert abs(value - wanted[name_]) < 1e-6 * size, name_
        seen = [k for k, n in enumerate(found.names) if n not in hidden]
        gap = np.abs(found.values - truth)[seen]
        assert gap.max() < 1e-6 * np.abs(truth).max()


def test_zeros_of_encoders_that_can_be_told_are_found() -> None:
    tree = robot("puma").without_friction()
    recording = faulty(tree, "joint_zeros")
    settings = tb.Settings(zeros=True, nuisances=["joint_zeros"], **SETTINGS)  # type: ignore[arg-type]
    found = tb.identify(tree, recording, settings=settings)
    values = np.array([each.value for each in found.nuisances])
    np.testing.assert_allclose(values, zeros(tree), atol=1e-6)


@pytest.mark.parametrize("seed", range(6))
def test_what_is_imitated_is_so_on_any_motion(seed: int) -> None:
    """Random trees: columns that are kept are independent on another motion, the others not."""
    rng = np.random.default_rng(seed)
    tree = random_robot(rng, 2 + seed % 4).tree()
    minimal = tb.minimal_set(tree, "reaction")
    rows = layout(tree, minimal)
    kept, imitated = told_apart(rows, minimal.names, NUISANCES, TARE)
    assert len(kept.kept) + len(imitated) == len(kept.parts)
    biases = {each.name for each in imitated if each.name.startswith("bias")}
    phi = tb.regressor(tree, still(tree, np.random.default_rng(seed + 100)), minimal)
    flat = phi.reshape(-1, minimal.count)
    for axis, name in enumerate(("Fx", "Fy", "Fz", "Mx", "My", "Mz")):
        constant = np.tile(np.eye(6)[axis], len(phi))
        left = constant - flat @ np.linalg.lstsq(flat, constant, rcond=None)[0]
        imitable = np.linalg.norm(left) < 1e-8 * np.linalg.norm(constant)
        assert (f"bias/{name}" in biases) or not imitable


def still(tree: tb.Tree, rng: np.random.Generator) -> tb.Motion:
    """Random states."""
    q, qd, qdd = rng.normal(size=(3, 80, tree.n))
    return tb.Motion(np.arange(80.0), q, qd, qdd)


def test_a_force_along_gravity_and_the_mass_are_not_both_known() -> None:
    tree = robot("puma")
    found = tb.identify(tree, measured(tree), settings=tb.Settings(nuisances=["bias"]))
    assert any("bias/Fz" in w and "mbar1" in w for w in found.warnings)
    assert "bias/Fz" not in [each.name for each in found.nuisances]
    assert found.noise is not None
    assert "mbar1" in found.noise.hidden


@pytest.mark.parametrize("kind", [n.kind for n in NUISANCES if n.kind != "joint_zeros"])
def test_what_the_fault_does_is_undone(kind: str) -> None:
    """Of the plate: the fault's own formula and its inverse share no code."""
    tree = robot("ur5")
    exact = ideal(tree, duration=2.0)
    exact = replace(exact, wrench=exact.measured("wrench") + TARE, tare=TARE, truth=None)
    fault = fault_of(PLATE[kind])
    rng = np.random.default_rng(0)
    shown = replace(exact, wrench=fault.apply(exact.measured("wrench"), exact.time, rng))
    nuisance = next(n for n in NUISANCES if n.kind == kind)
    assert nuisance.undo is not None
    back = nuisance.undo(shown, expected(tree, kind), exact.time)  # a drift begins at zero
    inner = slice(10, -10)
    wanted = exact.measured("wrench")[inner]
    np.testing.assert_allclose(back.measured("wrench")[inner], wanted, atol=1e-6)


@pytest.mark.parametrize("samples", [0.0, 3.0, -2.0, 0.5, 7.25, -1.75])
def test_shifts_are_exact_for_polynomials(samples: float) -> None:
    t = np.arange(60.0) / 10
    signal = np.stack([t**k for k in range(8)], axis=1)
    wanted = np.stack([(t + samples / 10) ** k for k in range(8)], axis=1)
    inner = slice(12, -12)
    np.testing.assert_allclose(shifted(signal, samples)[inner], wanted[inner], rtol=1e-9)


def test_bits_do_not_depend_on_threads_nor_on_where_samples_come_from(tmp_path: Path) -> None:
    tree = robot("puma")
    recording = measured(tree, rate=1000.0, duration=40.0)
    recording.save(tmp_path / "recording.parquet")
    settings = tb.Settings(nuisances=["pose", "skew"])
    first, *others = (
        tb.identify(tree, source, settings=settings, threads=threads)
        for source, threads in (
            (recording, 1),
            (recording, 3),
            (str(tmp_path / "recording.parquet"), 2),
        )
    )
    for other in others:
        np.testing.assert_array_equal(first.values, other.values)
        np.testing.assert_array_equal(first.covariance, other.covariance)
        assert first.nuisances == other.nuisances
        assert first.trace_tests == other.trace_tests


def test_the_internal_method_has_none_of_the_plates_unknowns() -> None:
    tree = robot("puma")
    recording = measured(tree)
    asked, plain = (
        tb.identify(tree, recording, "internal", settings=settings)
        for settings in (tb.Settings(nuisances=["pose"]), tb.Settings())
    )
    assert asked.nuisances == ()
    np.testing.assert_array_equal(asked.values, plain.values)


@pytest.mark.parametrize(
    ("words", "error"),
    [
        ({"nuisances": ["poses"]}, UnknownName),
        ({"nuisances": ["pose", "pose"]}, SettingsError),
        ({"nuisances": 3}, SettingsError),
        ({"nuisances": ["pose"], "noise": "white"}, SettingsError),
        ({"nuisances": ["pose"], "cutoff": "off"}, SettingsError),
    ],
)
def test_what_cannot_be_asked_for_is_refused(words: dict[str, object], error: type) -> None:
    with pytest.raises(error):
        tb.Settings(**words)  # type: ignore[arg-type]
