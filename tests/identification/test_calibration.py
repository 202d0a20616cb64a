"""Numbers of the instrument beside the robot's: a plate calibrated, payloads, mass centres.

If one fails, a fault of plate or encoder goes into the robot's parameters.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import testbed as tb
from testbed.applications.calibration import Calibration, calibrate, corrected
from testbed.applications.payload.payload import payload, payload_influence
from testbed.applications.payload.torque_scales import torque_scales
from testbed.core.base.arrays import Array
from testbed.core.base.errors import SettingsError, TestbedError, UnknownName
from testbed.core.estimation.regression import windows
from testbed.core.estimation.regression.constraints import centre_of_mass, total_mass
from testbed.core.estimation.regression.windows import make_plan, row_weights
from testbed.core.estimation.sensor.predicted_wrench import row_filter, window_prediction
from testbed.core.estimation.sensor.unknowns import SensorErrorColumns, sensor_unknowns
from testbed.core.kernel.layout import make_layout
from testbed.lab.experiment.plate_file import read_calibration, write_calibration
from testbed.sensors.catalogue import estimable_errors, systematic_errors
from testbed.sensors.shifted_signals import shifted_signal
from tests.helpers.ideal import EXACT, ideal, plus
from tests.helpers.measured import measured
from tests.helpers.plates import BIAS, LOAD, SCALE, loaded, mass_of, mixing, on_plate
from tests.helpers.refusals import refuses
from tests.helpers.runs import robot
from tests.helpers.strategies import Rng, rngs, trees
from tests.scenarios.scenarios import result

MATRIX = tb.Settings(nuisances=("matrix", "bias"))
MASS = {"payload/mass": LOAD.mass}


def known_of(tree: tb.Tree, seed: int) -> dict[str, float]:
    """What no motion tells of a plate, and its scale."""
    return {"mass": mass_of(tree), "gain/Fz": float(mixing(seed)[2, 2])}


@pytest.mark.slow
def test_matrix_zero_and_robot_are_found_at_once() -> None:
    """Next to no noise, a plate far from first order; with the usual noise, to their sigmas."""
    tree, matrix = robot("puma"), mixing(3)
    gaps: list[float] = []
    for noise in (1e-3, 1.0):
        recording = on_plate(measured(tree, 3, noise=noise, duration=10.0), matrix)
        found = calibrate(tree, recording, known_of(tree, 3))
        assert found.estimate is not None
        off = found.matrix - matrix
        error = found.estimate.values - found.estimate.minimal.values(tb.barycentric(tree))
        if noise < 1:
            assert (np.abs(off) / SCALE[:, None] * SCALE).max() < 5e-4
            assert np.abs(error).max() < 1e-3 * np.abs(found.estimate.values).max()
            continue
        for gap, sigma in ((off, found.matrix_sigma), (error, found.estimate.sigma)):
            gaps += (gap[sigma > 0] / sigma[sigma > 0]).tolist()
    assert 0.6 < np.sqrt(np.mean(np.square(gaps))) < 1.5


@pytest.mark.slow
def test_doubt_about_the_plate_counts_as_drawn_plates_say() -> None:
    """Plates drawn from what calibration leaves open: estimates scatter as sigma grows."""
    tree, rng, matrix = robot("puma"), np.random.default_rng(4), mixing(2)
    first, second = (on_plate(measured(tree, k, duration=10.0), matrix) for k in (1, 2))
    plate = calibrate(tree, first, known_of(tree, 2), settings=MATRIX)
    plain = tb.identify(tree, corrected(second, tree, plate))
    counted = tb.identify(tree, corrected(second, tree, plate), doubt=plate.doubt)
    np.testing.assert_allclose(counted.values, plain.values, rtol=1e-6, atol=1e-9)
    assert counted.nuisances == ()
    drawn = []
    for _ in range(8):
        off = plate.doubt.root @ rng.normal(size=plate.doubt.root.shape[1])
        moved = dict(zip(plate.doubt.names, off, strict=True))
        numbers = (replace(n, value=n.value + moved.get(n.name, 0.0)) for n in plate.numbers)
        other = replace(plate, numbers=tuple(numbers))
        drawn.append(tb.identify(tree, corrected(second, tree, other)).values - plain.values)
    identifiable = np.isfinite(plain.sigma) & np.isfinite(counted.sigma)
    scatter = np.sqrt(np.mean(np.square(drawn), axis=0))[identifiable]
    added = np.sqrt(
        np.maximum(counted.sigma[identifiable] ** 2 - plain.sigma[identifiable] ** 2, 0.0)
    )
    matters = scatter > 0.3 * plain.sigma[identifiable]
    assert matters.any()
    assert 0.6 < np.sqrt(np.mean((added / scatter)[matters] ** 2)) < 1.6


@pytest.mark.slow
def test_a_calibrated_plate_makes_other_recordings_right(tmp_path: Path) -> None:
    """As it is, and read again from its file to the last bit."""
    tree, path = robot("puma"), tmp_path / "plate.toml"
    plate = replace(result("plate"), robot='a "robot"')
    write_calibration(plate, path)
    again: Calibration = read_calibration(path, tree)
    assert (again.robot, again.numbers) == (plate.robot, plate.numbers)
    right = measured(tree, 5, duration=5.0)
    alone = replace(again, numbers=tuple(each for each in again.numbers if each.kind == "matrix"))
    back = corrected(on_plate(right, plate.matrix), tree, alone)
    zero = BIAS @ np.linalg.inv(plate.matrix).T  # of this recording, and it stays
    whole = back.part(0, back.samples)
    np.testing.assert_allclose(whole.measured("wrench"), right.measured("wrench") + zero)
    for text, culprit in (
        ("numbers = 3", "numbers"),
        ("[numbers]\n'gain/Fx' = {value = inf}", "value"),
        ("[numbers]\n'gain/Fq' = {value = 1.0}", "gain/Fq"),
        ("nothing", "TOML"),
    ):
        path.write_text(text)
        with pytest.raises(TestbedError, match=culprit):  # all names of numbers are told
            corrected(right, tree, read_calibration(path, tree))


def test_what_does_not_suffice_is_refused_before_the_data_are_read() -> None:
    """A scale that nothing tells; a place without a mass."""
    for name, known in (("puma", {}), ("ur5", {"mass": 20.0}), ("gantry", {"centre/x": 0.1})):
        recording = measured(robot(name), duration=2.0)
        spoilt = replace(recording, wrench=np.zeros_like(recording.measured("wrench")))
        with pytest.raises(SettingsError, match="gain/Mz"):
            calibrate(robot(name), spoilt, known, settings=MATRIX)


def ten() -> Array:
    """Parameters of the load."""
    tree = robot("puma")
    return np.array(tb.standard(replace(tree, inertias=(LOAD, *tree.inertias[1:])))[0])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["puma", "gantry"])
def test_a_payload_is_what_was_added(name: str) -> None:
    """Exactly of exact data, within sigmas of noisy ones; what is not told has no sigma."""
    tree, heavy = robot(name), loaded(robot(name))
    both = enumerate((tree, heavy))
    one, other = (tb.identify(each, ideal(each, seed=k), settings=EXACT) for k, each in both)
    exact = payload(tree, one, other)
    identifiable = np.array(exact.identifiable)
    assert identifiable[0]
    np.testing.assert_allclose(exact.values[identifiable], ten()[identifiable], atol=1e-8)
    assert np.isinf(exact.sigma[~identifiable]).all()
    one, other = (tb.identify(tree, measured(each, k)) for k, each in ((70, tree), (80, heavy)))
    noisy = payload(tree, one, other)
    assert np.abs((noisy.values - ten())[identifiable] / noisy.sigma[identifiable]).max() < 4.5
    assert noisy.p_value > 1e-4
    assert noisy.diagnostics == ()


def test_torques_weigh_a_payload_in_their_scale_and_a_known_one_gives_it() -> None:
    """Exactly of exact data; within sigmas of noisy ones; a doubt about the mass comes back."""
    rubs = {"coulomb": 3.0, "viscous": 3.0}
    tree = robot("ur5").with_joints(dict.fromkeys(robot("ur5").names, rubs))
    heavy, scales = loaded(tree), 0.91 + 0.01 * np.arange(6)
    whole = [ideal(each, seed=k) for k, each in enumerate((tree, heavy))]
    uniform = [plus(each, torque=-0.09 * each.measured("torque")) for each in whole]
    one, other = (tb.identify(tree, each, "torque", settings=EXACT) for each in uniform)
    weighed = payload(tree, one, other)
    np.testing.assert_allclose(weighed.values, 0.91 * ten(), atol=1e-7)
    assert [each.code for each in weighed.diagnostics] == ["payload.scale"]
    own = [plus(each, torque=(scales - 1) * each.measured("torque")) for each in whole]
    exact = torque_scales(tree, own[0], own[1], MASS, settings=EXACT)
    np.testing.assert_allclose(exact.values, scales, atol=1e-8)
    z, doubt = list[float](), 0.02
    doubtful = {"payload/mass": (LOAD.mass, doubt * LOAD.mass)}
    for seed in range(3):
        both = enumerate((tree, heavy), start=10 * seed)
        pair = [measured(each, k, duration=10.0) for k, each in both]
        noisy = [plus(each, torque=(scales - 1) * each.measured("torque")) for each in pair]
        found, doubted = (
            torque_scales(tree, noisy[0], noisy[1], known) for known in (MASS, doubtful)
        )
        z += ((found.values - scales) / found.sigma).tolist()
        wanted = np.hypot(found.sigma, doubt * found.values)
        np.testing.assert_allclose(doubted.sigma, wanted, rtol=0.02)
    assert 0.6 < np.sqrt(np.mean(np.square(z))) < 1.4
    for known in ({"payload/x": 0.1}, {"payload/mass": -1.0}, {}):
        with refuses(TestbedError, "payload/mass"):
            torque_scales(tree, own[0], own[1], known)
    with refuses(SettingsError, "payload"):  # on the first link only its inertia shows
        torque_scales(tree, own[0], own[1], MASS, tree.names[0], settings=EXACT)


@given(trees((2, 5)), st.integers(0, 4), rngs)
def test_what_a_load_adds_is_what_the_minimal_set_holds(tree: tb.Tree, link: int, rng: Rng) -> None:
    """On any link; and total mass and centres of mass, against the wrench at rest in any pose."""
    link %= tree.n
    minimal = tb.minimal_set(tree, "wrench")
    values = minimal.values(tb.barycentric(tree))
    more = minimal.values(tb.barycentric(loaded(tree, link)))
    adds = payload_influence(tree, minimal, tree.names[link])
    np.testing.assert_allclose(adds @ ten(), more - values, atol=1e-12)
    if not tree.gravity.any():
        return  # nothing has a weight
    assert total_mass(tree, minimal) @ values == pytest.approx(mass_of(tree))
    q, still = rng.uniform(-1, 1, (1, tree.n)), np.zeros((1, tree.n))
    where = ",".join(f"{n}={x!r}" for n, x in zip(tree.names, q[0].tolist(), strict=True))
    along_z = tb.base_wrench(tree.with_gravity([0, 0, -1]), tb.Motion(np.zeros(1), q, still, still))
    along_x = tb.base_wrench(tree.with_gravity([-1, 0, 0]), tb.Motion(np.zeros(1), q, still, still))
    mass = mass_of(tree)
    centre = {"x": -along_z[0, 4] / mass, "y": along_z[0, 3] / mass, "z": along_x[0, 4] / mass}
    for axis, place in centre.items():
        try:
            row = centre_of_mass(tree, minimal, f"centre/{axis}@{where}", float(place))
        except SettingsError:  # one that the plate never sees
            continue
        assert row @ values == pytest.approx(0, abs=1e-9)


@pytest.mark.slow
def test_what_is_no_payload_is_noticed() -> None:
    """Two loads on two links are no load on one; a load that was taken off is none either."""
    tree = robot("ur5")
    heavy = loaded(loaded(tree), 1)
    one, other = (tb.identify(t, measured(t, k)) for k, t in enumerate((tree, heavy)))
    found, swapped = payload(tree, one, other), payload(tree, other, one)
    assert found.p_value < 1e-6
    assert len(swapped.diagnostics) > len(found.diagnostics) > 0


def test_what_tells_no_payload_is_refused() -> None:
    """Estimates of two kinds or by two methods, links that are none."""
    tree = robot("puma")
    one, symmetric = (
        tb.identify(tree, ideal(tree), settings=replace(EXACT, zeros=zeros))
        for zeros in (False, True)
    )
    inner = tb.identify(tree, ideal(tree), "torque", settings=EXACT)
    for pair in ((one, symmetric), (one, inner)):
        with refuses(SettingsError):
            payload(tree, *pair)
    with refuses(UnknownName, "wrist"):
        payload(tree, one, one, "wrist")


# errors of the instrument, found beside the robot

SMALL = 1e-6
ALL = systematic_errors()
TARE = np.array([3.0, -2.0, 200.0, 4.0, -5.0, 1.0])
FULL = np.array([500.0, 500.0, 1000.0, 200.0, 200.0, 100.0])


def shown(recording: tb.Recording, kind: str, v: Array) -> tb.Recording:
    """With a fault of the plate, of the nuisance's numbers."""
    neutral = ALL[kind].neutral(robot("puma")) if kind == "matrix" else 0.0
    wrench = ALL[kind].effect(recording.measured("wrench"), recording.time, neutral + v)
    return replace(recording, wrench=wrench)


def on_pedestal(tree: tb.Tree, duration: float) -> tb.Recording:
    """A perfect recording."""
    found = ideal(tree, duration=duration, seed=3)
    return replace(found, wrench=found.measured("wrench") + TARE, tare=TARE, truth=None)


def columns_of(recording: tb.Recording, tree: tb.Tree, kind: str, estimated: bool = False) -> Array:
    """The nuisance's columns, (6, rows, k)."""
    minimal, settings = tb.minimal_set(tree, "wrench"), tb.Settings(position_cutoff="off")
    plan = make_plan(recording, make_layout(tree, minimal), TARE, settings)
    cutoff, unknowns = settings.row_low_pass, sensor_unknowns(tree, [ALL[kind]])
    assert cutoff is not None
    filtered, values = row_filter(plan, cutoff), minimal.values(tb.barycentric(tree))
    made = SensorErrorColumns(plan, filtered, values, unknowns)
    theta, parts = plan.layout.theta @ (plan.layout.basis @ values), []
    for window in plan.windows():
        signals = plan.signals(recording.part(window.first, window.last), window)
        if estimated:
            parts.append(made(signals, window.row))
        else:
            predicted = window_prediction(plan, filtered, theta, signals, window.row)
            parts.append(ALL[kind].regressor_columns(predicted).transpose(1, 0, 2))
    return np.concatenate(parts, axis=1)


def encoder_errors(kind: str, recording: tb.Recording, tree: tb.Tree) -> list[list[Array]]:
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


def effects(kind: str, recording: tb.Recording, tree: tb.Tree) -> list[Array]:
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
    count = len(ALL[kind].coefficients(tree))
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
    for kind in set(ALL) - {"slope", "clock_rate", "tare"}:
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
    for kind in [error.term for error in estimable_errors() if error.signal == "wrench"]:
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
}


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "hidden"), [("tare", {"tare/Fz"}), ("pose", set[str]())])
def test_what_was_added_is_found_or_named(kind: str, hidden: set[str]) -> None:
    """Far beyond first order; what no motion tells is among the warnings, by its name."""
    tree, values = robot("puma").without_friction(), VALUES[kind]
    recording = shown(on_pedestal(tree, 12.0), kind, values)
    settings = tb.Settings(position_cutoff="off", zeros=True, nuisances=[kind])
    found = tb.identify(tree, recording, settings=settings)
    wanted = {part.name: x for part, x in zip(ALL[kind].coefficients(tree), values, strict=True)}
    told = {each.name: each.value for each in found.nuisances}
    assert wanted.keys() - told.keys() == hidden
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
    """By the inverse; shifts in time are exact."""
    tree = robot("ur5")
    exact = on_pedestal(tree, 2.0)
    for kind, values in VALUES.items():
        scaled = np.ravel(np.eye(6)) + values if kind == "matrix" else values
        back = ALL[kind].corrected_recording(shown(exact, kind, values), scaled, exact.time, tree)
        gap = back.measured("wrench")[10:-10] - exact.measured("wrench")[10:-10]
        assert np.abs(gap).max() < 1e-6, kind
    t, powers = np.arange(60.0)[:, None] / 10, np.arange(8)
    for samples in (0.0, 3.0, -2.0, 0.5, 7.25, -1.75):
        wanted = ((t + samples / 10) ** powers)[12:-12]
        np.testing.assert_allclose(shifted_signal(t**powers, samples)[12:-12], wanted, rtol=1e-9)


def test_a_long_recording_is_looked_at_evenly(monkeypatch: pytest.MonkeyPatch) -> None:
    """From its first window to its last: a fault of one part would pass for none."""
    monkeypatch.setattr(windows, "WINDOW_SAMPLES", 1000)
    tree = robot("puma")
    rows = make_layout(tree.without_inertias(), tb.minimal_set(tree, "wrench"))
    plan = make_plan(measured(tree, 1, duration=260.0, rate=100.0), rows, TARE, tb.Settings())
    every = [window.row for window in plan.windows()]
    for most in (10_000, 4, 3):
        monkeypatch.setattr(windows, "ANALYSED_WINDOWS", most)
        at = [every.index(row) for row in sorted(replace(plan).analysed_windows)]
        assert (len(at), at[0], at[-1]) == (min(most, len(every)), 0, len(every) - 1)
        assert np.ptp(np.diff(at)) <= 1
