"""The whole instrument: perfect unless told otherwise, faults in their places, noise kept."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import butter, freqs, welch
from scipy.spatial.transform import Rotation

import testbed as tb
from docs.instruments import catalogue
from testbed.core.base.arrays import Array
from testbed.core.base.errors import RecordingError, SettingsError, TestbedError
from testbed.core.recordings.metadata import NO_METADATA
from testbed.core.recordings.recording import Recording, Truth
from testbed.lab.instruments.chain import Instrument, measure, remeasured
from testbed.lab.instruments.error_chain import apply_chain, random_stream
from testbed.lab.instruments.plates import PLATE_MODELS
from testbed.sensors.catalogue import simulated_errors
from testbed.sensors.kind_reader import sensor_error_from_table
from testbed.sensors.kinds_in_words import describe_kind
from testbed.sensors.sensor_error import FULL_SCALE, SensorError, StageOrder
from tests.helpers.ideal import ideal
from tests.helpers.paths import ROOT
from tests.helpers.refusals import refuses
from tests.helpers.strategies import rngs, trees

NAMES, SAMPLES, SEED = ("a", "b", "c"), 500, 11
TIME = np.arange(SAMPLES) / 1000.0
TARE = np.array([1.0, -2.0, 245.0, 0.5, 0.25, -3.0])
NOISY = Instrument(encoder_noise=1e-3, torque_noise=0.5, force_noise=0.5, moment_noise=0.1)
SIGNALS = ("position", "torque", "wrench", "tare")
TABLE6 = ROOT / "experiments/table6.toml"


def truth(size: float = 1.0) -> Truth:
    """A swinging robot, or with size 0 nothing at all."""
    phase = np.outer(TIME, [3.0, 4.0, 5.0]) + np.arange(3.0)
    q, qd, qdd = size * np.sin(phase), 3 * size * np.cos(phase), -9 * size * np.sin(phase)
    return Truth(q, qd, qdd, 20 * qdd, qd, size * (TARE + np.hstack([40 * q, 30 * qd])))


def seen(*faults: SensorError, what: Truth | None = None, base: Instrument = NOISY) -> Recording:
    instrument = replace(base, fault=faults)
    return measure(instrument, NAMES, TIME, what or truth(), TARE, NO_METADATA, seed=SEED)


def wrench(recording: Recording) -> Array:
    return recording.measured("wrench")


def net(recording: Recording) -> Array:
    return np.asarray(wrench(recording) - np.asarray(recording.tare))


def same(one: Array | None, other: Array | None) -> None:
    np.testing.assert_array_equal(one, other)


def test_the_default_instrument_is_perfect_and_senses_no_kinematics() -> None:
    """Else noise that no file asks for is in a simulated recording, or speeds that no robot has."""
    what, blind = truth(), seen(base=Instrument())
    assert blind.signals == ("time", "position", "torque", "wrench")
    sensing = seen(base=Instrument(senses_kinematics=True))
    for recording in (blind, sensing):
        for signal in recording.signals[1:]:
            same(recording.measured(signal), getattr(what, signal))
    assert sensing.senses_kinematics
    same(blind.tare, TARE)


def test_noise_comes_from_the_streams_of_older_recordings() -> None:
    """Golden: a recording made again from its seed shows the same numbers in any version."""
    golden = {"encoder_noise": -0.2407279463145176, "torque_noise": -0.5346093661287762,
              "plate_noise": -2.0306006741711506, "encoder_resolution": -0.05591096996529509,
              "some_fault": -1.5672328128223696}  # fmt: skip
    assert {kind: random_stream(kind, 1996).normal() for kind in golden} == golden
    keys = [(kind, seed, n, use) for kind in golden for seed in (0, 1) for n in (0, 1)
            for use in ("", "tare")]  # fmt: skip
    assert len({random_stream(*key).normal() for key in keys}) == len(keys)
    errors = {"b": 0.08, "c": -0.02, "stranger": 9.0}
    shown = seen(base=replace(NOISY, encoder_resolution=0.25, torque_constant_error=errors))
    what = truth()
    q = what.position + 1e-3 * random_stream("encoder_noise", SEED).normal(size=(SAMPLES, 3))
    same(shown.position, 0.25 * np.round(q / 0.25))
    noise = 0.5 * random_stream("torque_noise", SEED).normal(size=(SAMPLES, 3))
    same(shown.torque, what.torque * [1.0, 1.08, 0.98] + noise)
    noise = np.repeat([0.5, 0.1], 3) * random_stream("plate_noise", SEED).normal(size=(SAMPLES, 6))
    same(shown.wrench, what.wrench + noise)


def test_a_fault_leaves_other_signals_and_the_noise_of_all_others_alone() -> None:
    without, silent = seen(), seen(what=truth(0))
    for kind, made in simulated_errors().items():
        fault = made()
        recording = seen(fault)
        for signal in SIGNALS:
            changed = getattr(recording, signal) != getattr(without, signal)
            assert changed.any() == (signal == fault.signal), (kind, signal)
        if fault.stage >= StageOrder.RANGE or kind in (
            "encoder_noise",
            "torque_noise",
            "plate_noise",
        ):
            continue  # acts on the noise of the others as on all that it is given
        bare = seen(fault, what=truth(0)).measured(fault.signal)
        alone = seen(fault, what=truth(0), base=Instrument()).measured(fault.signal)
        np.testing.assert_allclose(bare - alone, silent.measured(fault.signal), atol=1e-12)


def test_two_of_one_kind_have_streams_of_their_own() -> None:
    """Of noise, and of the signs that chance decides."""
    one, two = (
        wrench(seen(*[tb.PlateNoise()] * count, what=truth(0), base=Instrument()))
        for count in (1, 2)
    )
    assert abs(np.mean((two - one) * one)) < 0.1 * np.mean(one**2)
    assert np.mean(two**2) == pytest.approx(2 * np.mean(one**2), rel=0.1)
    every = Instrument(fault=(tb.PlateBias(),) * 8).sampled_stages(NAMES, 0)["wrench"]
    assert len({str(fault) for fault in every if isinstance(fault, tb.PlateBias)}) > 1


def test_places_decide_on_the_order_and_then_the_file() -> None:
    """Sensors, then noise, then counts, then the line; counts are whole whatever the noise."""
    faults = (
        tb.PlateDroppedSamples(0.3),
        tb.PlateConverter(),
        tb.PlateNoise(),
        tb.PlateCrosstalk(),
    )
    assert len({wrench(seen(*order)).tobytes() for order in permutations(faults)}) == 1
    gain, pose = (tb.PlateGain((0.5, 0.0, 0.0, 0.0, 0.0, 0.0)), tb.PlatePose((0.0, 0.0, 1.0), 0.0))
    for order in ((gain, pose), (pose, gain)):
        expected = apply_chain(order, truth().wrench, TIME, 0)
        np.testing.assert_allclose(wrench(seen(*order, base=Instrument())), expected, atol=1e-12)
    counts = seen(
        tb.EncoderResolution(0.25), tb.EncoderNoise(0.1), tb.EncoderEccentricity(0.1)
    ).position
    same(counts / 0.25, np.rint(counts / 0.25))
    wider = Instrument(full_scale=tuple(10 * v for v in FULL_SCALE))  # type: ignore[arg-type]
    scale = np.array(wider.full_scale)
    coarse = scale / 128 * np.round(truth().wrench / scale * 128)
    same(wrench(seen(tb.PlateConverter(8), base=wider)), coarse)


def test_a_measured_tare_has_the_plates_own_faults_and_noise_and_the_drift_since() -> None:
    """What is constant leaves with it: the wrench less the tare is as with a true zero."""
    quiet = Instrument()
    same(seen(tb.PlateBias(), tb.PlatePose(), tb.PlateCrosstalk()).tare, TARE)
    for faults in ((tb.PlateBias(),), (tb.PlateBias(), tb.PlateBias(1.0))):
        recording = seen(*faults, tb.MeasuredTare(), base=quiet)
        np.testing.assert_allclose(net(recording), truth().wrench - TARE, atol=1e-10)
    for fault in (tb.PlatePose(), tb.PlateCrosstalk(), tb.PlateGain()):
        bare = seen(fault, what=replace(truth(), wrench=truth().wrench - TARE), base=quiet)
        shown = net(seen(fault, tb.MeasuredTare(), base=quiet))
        np.testing.assert_allclose(shown, wrench(bare), atol=1e-10)
    drift = seen(tb.PlateDrift((0.05, 0.0, 0.0), 0.0), tb.MeasuredTare(5.0, 60.0), base=quiet)
    np.testing.assert_allclose(np.asarray(drift.tare), TARE - 0.05 * 62.5005 * np.eye(6)[0])
    noisy = seen(tb.MeasuredTare(1.0))
    same(noisy.wrench, seen().wrench)
    own = random_stream("plate_noise", SEED, 0, "tare").normal(size=(1000, 6)).mean(axis=0)
    np.testing.assert_allclose(
        np.asarray(noisy.tare), TARE + np.repeat([0.5, 0.1], 3) * own, atol=1e-12
    )


@given(tree=trees((1, 5)), kinds=st.sets(st.sampled_from(sorted(simulated_errors())), min_size=1))
def test_every_fault_suits_every_robot_and_needs_no_simulation(
    tree: tb.Tree, kinds: set[str]
) -> None:
    recording = ideal(tree, duration=3.0)
    faults = tuple(simulated_errors()[kind]() for kind in sorted(kinds))
    shown = remeasured(recording, Instrument(rate=200.0, fault=faults), 5)
    for signal in ("position", "torque", "wrench"):
        values = shown.measured(signal)
        assert np.isfinite(values).all()
        if all(fault.signal != signal for fault in faults):
            same(values, recording.measured(signal))
    with refuses(RecordingError, "truth"):
        remeasured(recording.blind(), NOISY, 1)
    with refuses(RecordingError, "200", "1000"):
        remeasured(recording, NOISY, 1)


def test_a_file_says_faults_as_python_does_and_every_kind_is_documented() -> None:
    """Read with defaults, written back, listed in the docs with its keys; sizes are sizes."""
    every = ",".join(entry.example for entry in map(describe_kind, simulated_errors().values()))
    experiment = tb.Experiment.from_toml(TABLE6, [f"measurement.fault=[{every}]"])
    assert [fault.kind for fault in experiment.measurement.fault] == list(simulated_errors())
    for kind, made in simulated_errors().items():
        fault = made()
        assert (
            sensor_error_from_table({"kind": kind})
            == sensor_error_from_table(fault.table())
            == fault
        )
        assert [name for name, _, _ in describe_kind(type(fault)).keys] == list(fault.known_keys())
        assert all(size > 0 for name, size in fault.table().items() if name != "kind")
    text = '[{kind="plate_bias",force=[1,2,3]},{kind="encoder_zero_error",error={elbow=1e-3}}]'
    found = tb.Experiment.from_toml(TABLE6, [f"measurement.fault={text}"]).measurement.fault
    assert found == (tb.PlateBias((1.0, 2.0, 3.0)), tb.EncoderZeroError({"elbow": 1e-3}))
    assert catalogue() in (ROOT / "docs/instruments.md").read_text()


WRONG = {
    '{kind="plate_crosstalk",full_scale=1}': "full_scale",
    '{kind="plate_bias",force=[1,2]}': "[1, 2]",
    '{kind="plate_bias",force={waist=1}}': "waist",
    '{kind="plate_bias",force=true}': "True",
    '{kind="plate_bias",force=nan}': "force",
    '{kind="plate_bias",force=[1,2,-inf]}': "force",
    '{kind="plate_bias",force="much"}': "much",
    '{kind="torque_offset",error=[]}': "error",
    '{kind="encoder_zero_error",error={elbow="far"}}': "far",
    '{kind="plate_gain",error=[1,2,3]}': "six",
    '{kind="plate_hum",frequency=0}': "frequency",
    '{kind="plate_converter",bits=33}': "32",
    '{kind="plate_dropped_samples",share=1.5}': "1.5",
    '{kind="plate_crosstalk",matrix=[[1,2]]}': "matrix",
    '{kind="plate_anti_alias_filter",cutoff=1e-3}': "0.01 Hz",
    '{kind="measured_tare",seconds=1e6}': "measured_tare",
    '{kind="measured_tare"},{kind="measured_tare"}': "measured_tare",
    '{kind="torque_offset",error={wrist=1}}': "'wrist'",
}
"""A table that means nothing, and the culprit."""


def test_what_no_instrument_can_be_is_refused_before_anything_is_simulated() -> None:
    for text, culprit in WRONG.items():
        words = [f"measurement.fault=[{text}]", "motion.duration=1e3"]
        with refuses(TestbedError, culprit):
            tb.record(tb.Experiment.from_toml(TABLE6, words))
    wrong: list[tuple[str, dict[str, Any]]] = [
        *((name, {name: value}) for value in (-1e-9, np.inf, np.nan)
          for name in ("encoder_resolution", "encoder_noise", "torque_noise", "moment_noise")),
        *(("rate", {"rate": value}) for value in (0.0, np.inf)),
        ("averaged", {"averaged": False, "fault": (tb.EncoderInstantSampling(),)}),
        ("torque_constant_error", {"torque_constant_error": {"a": 0.1, "b": np.nan}}),
        *(("full_scale", {"full_scale": (1.0,) * 5 + more}) for more in ((), (0.0,))),
    ]  # fmt: skip
    for culprit, keys in wrong:
        with refuses(SettingsError, culprit):
            Instrument(**keys)
    assert Instrument(rate=100.0, fault=(tb.PlateAntiAliasFilter(1e-3),)).fault


def test_a_plate_by_name_gives_what_is_not_said_beside_it() -> None:
    named = Instrument(plate="ati-axia80-m20", moment_noise=0.5)
    known = PLATE_MODELS["ati-axia80-m20"]
    assert named.force_noise == known.force_noise > 0
    assert (named.moment_noise, named.full_scale) == (0.5, known.full_scale)
    again = tb.Experiment(name="x", model="x.urdf", measurement=named).as_toml()
    assert f"force_noise = {known.force_noise}" in again
    with refuses(SettingsError, "ati-axia80-m20"):
        Instrument(plate="axia80")


RATE = 1000.0
CLOCK = np.arange(4000) / RATE
SIX = np.arange(1.0, 7.0)
INNER = slice(300, -300)


def waves(time: Array, channels: int = 6) -> Array:
    """Smooth signals of a robot's frequencies around loads of its size."""
    k = np.arange(channels)
    return 40.0 * (k + 1) + (10.0 + k) * np.sin(2 * np.pi * np.outer(time, 0.3 + 0.2 * k) + k)


Q, W = waves(CLOCK, 3), waves(CLOCK)


def through(fault: SensorError, signal: Array, time: Array = CLOCK, seed: int = 0) -> Array:
    return fault.apply(signal, time, np.random.default_rng(seed))


def close(one: Array, other: Array, size: float = 1e-12) -> None:
    np.testing.assert_allclose(one, other, rtol=size, atol=size)


def test_zeros_and_scales_are_wrong_joint_by_joint_and_channel_by_channel() -> None:
    close(through(tb.EncoderZeroError((1.0, 0.0, -2.0)), Q), np.add(Q, [1, 0, -2]))
    close(through(tb.TorqueOffset(0.5), Q), Q + 0.5)
    close(through(tb.PlateBias(2.0, (0.0, 0.5, -0.5)), W), np.add(W, [2, 2, 2, 0, 0.5, -0.5]))
    close(through(tb.EncoderGain(0.01), Q), 1.01 * Q)
    close(through(tb.TorqueConstantError((0.08, -0.06, 0.0)), Q), Q @ np.diag([1.08, 0.94, 1.0]))
    close(through(tb.PlateGain(tuple(SIX / 100)), W), W @ np.diag(1 + SIX / 100))
    for time in (CLOCK, CLOCK - 60.0):  # a drift begins at time 0
        slope = through(tb.PlateDrift((1.0, 2.0, 3.0), 0.5), W, time) - W
        close(slope, np.outer(time, [1, 2, 3, 0.5, 0.5, 0.5]), 1e-10)


def test_eccentricity_and_hum_are_waves() -> None:
    q = np.linspace(-4.0, 4.0, 4000)[:, None] * [1.0, 0.5, 2.0]
    error = through(tb.EncoderEccentricity(4e-4, phase=(0.0, 0.5, 1.0)), q) - q
    close(error, 4e-4 * np.imag(np.exp(1j * np.add(q, [0, 0.5, 1]))))
    lead = through(tb.EncoderEccentricity(1e-3, period=0.01), q) - q
    close(lead, 1e-3 * np.sin(q * 200 * np.pi))
    lines = np.fft.rfft(through(tb.PlateHum(2.0, 0.5, 50.0, tuple(SIX)), 0 * W), axis=0) / 2000
    close(lines[200], np.repeat([2.0, 0.5], 3) * np.exp(1j * (SIX - np.pi / 2)), 1e-9)
    lines[200] = 0
    assert np.abs(lines).max() < 1e-9


def test_counts_are_whole_and_the_nearest_and_signals_end_where_ranges_do() -> None:
    """Of encoders, of a plate's converter and of a plate that saturates."""
    seen = through(tb.EncoderResolution((0.1, 0.0, 0.25)), Q)
    close(seen[:, 1], Q[:, 1])
    close(seen[:, 2], 0.25 * np.floor(Q[:, 2] / 0.25 + 0.5))
    wrench = np.outer(np.linspace(-1.5, 1.5, 4000), FULL_SCALE)
    counts = through(tb.PlateConverter(8), wrench) / FULL_SCALE * 128
    close(counts, np.clip(np.rint(wrench / FULL_SCALE * 128), -128, 127))
    share = through(tb.PlateSaturation(0.9), W)
    close(np.ptp(share, axis=0), 0.9 * np.ptp(W, axis=0))
    close(share.max(0) + share.min(0), W.max(0) + W.min(0))


def test_crosstalk_is_in_proportion_to_full_scale() -> None:
    """Each channel alone at its full scale shows one column of the matrix in all others."""
    x = np.zeros((6, 6))
    x[3, 2], x[0, 5], x[1, 1] = 0.01, -0.02, 0.005
    fault = tb.PlateCrosstalk(matrix=tuple(map(tuple, x.tolist())))
    for scale in (FULL_SCALE, (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)):
        loads = np.diag(scale)
        seen = through(fault.for_robot(NAMES, scale), loads, CLOCK[:6])
        close(((seen - loads) / scale).T, x)
    mixing = np.array(
        tb.PlateCrosstalk(0.01).with_random_values(3, np.random.default_rng(1)).matrix
    )
    assert not np.diagonal(mixing).any()
    assert 0.005 < np.abs(mixing).max() <= 0.01


@given(rng=rngs)
def test_a_plate_elsewhere_shows_forces_at_points_about_its_own_origin(
    rng: np.random.Generator,
) -> None:
    """Witness: a force at a point, its lever and components taken in the plate's frame."""
    force, point, couple = rng.normal(size=(3, 20, 3))
    origin, vector = rng.normal(size=(2, 3))
    axes = Rotation.from_rotvec(vector).inv()
    wrench = np.hstack([force, np.cross(point, force) + couple])
    seen = through(tb.PlatePose(tuple(vector), tuple(origin)), wrench, CLOCK[:20])
    inside = axes.apply(force)
    moment = np.cross(axes.apply(point - origin), inside) + axes.apply(couple)
    close(seen, np.hstack([inside, moment]))


def test_what_comes_late_is_the_signal_of_another_time() -> None:
    """Exact for smooth signals; held before the first sample and after the last."""
    for delay in (1e-3, 2.34e-4, -7e-4, 0.0123):
        close(through(tb.PlateDelay(delay), W)[INNER], waves(CLOCK - delay)[INNER], 1e-9)
    close(through(tb.PlateClockRate(0.01), W)[INNER], waves(CLOCK / 1.01)[INNER], 1e-9)
    close(through(tb.PlateDelay(0.01), W)[:10], np.tile(W[0], (10, 1)), 1e-10)
    close(through(tb.PlateDelay(-0.01), W)[-10:], np.tile(W[-1], (10, 1)), 1e-10)
    seen = through(tb.PlateDroppedSamples(0.2), W)
    lost = np.flatnonzero((seen != W).any(axis=1))
    assert 0.17 < len(lost) / 4000 < 0.23
    close(seen[lost], seen[lost - 1])
    # means over samples, in closed form, tell the instants at which they begin
    f, k = 0.3 + 0.2 * np.arange(3), np.arange(3)
    phase, turn = 2 * np.pi * np.outer(CLOCK, f) + k, 2 * np.pi * f / RATE
    means = 40.0 * (k + 1) + (10.0 + k) * (np.cos(phase) - np.cos(phase + turn)) / turn
    close(through(tb.EncoderInstantSampling(), means), Q, 2e-9)


@given(order=st.integers(1, 8), frequency=st.sampled_from([0.5, 5.0, 40.0]))
def test_the_anti_alias_filter_is_butterworths(order: int, frequency: float) -> None:
    """Witness: gain and phase of the analog filter, from SciPy; a signal at rest stays."""
    time = np.arange(20_000) / 10_000.0
    gain = freqs(*butter(order, 2 * np.pi * 50, analog=True), worN=[2 * np.pi * frequency])[1][0]
    signal = np.tile(np.sin(2 * np.pi * frequency * time)[:, None], 6)
    seen = through(tb.PlateAntiAliasFilter(50.0, order), signal, time)[:, 0]
    expected = np.imag(gain * np.exp(2j * np.pi * frequency * time))
    straight = (2 * np.pi * frequency * 1e-4) ** 2 / 12  # error of a sine of straight pieces
    assert np.abs(seen - expected)[5000:].max() < 1.1 * straight * (order + 1) / 2 + 1e-8
    still = np.tile(SIX, (500, 1))
    close(through(tb.PlateAntiAliasFilter(100.0, order), still, CLOCK[:500]), still, 1e-9)


def test_noise_has_its_size_and_memory() -> None:
    """White, walking and coloured noise are recursions of one stream; pink is told by Welch."""
    white = np.random.default_rng(0).normal(size=(4000, 6))
    size = np.array([0.5, 0.5, 0.5, 0.1, 0.2, 0.3])
    moment = (0.1, 0.2, 0.3)
    close(through(tb.PlateNoise(0.5, moment), 0 * W), size * white)
    three = np.random.default_rng(0).normal(size=(4000, 3)) * [0.1, 0.0, 0.3]
    for kind in (tb.EncoderNoise, tb.TorqueNoise):
        close(through(kind((0.1, 0.0, 0.3)), Q) - Q, three)
    coloured, walk = np.array(white), 0.0 * white
    for k in range(1, 4000):
        kept = np.exp(-1 / RATE / 0.05)
        coloured[k] = kept * coloured[k - 1] + np.sqrt(1 - kept**2) * white[k]
        walk[k] = walk[k - 1] + np.sqrt(1 / RATE) * white[k]
    close(through(tb.PlateColouredNoise(0.5, moment, 0.05), 0 * W), size * coloured, 1e-9)
    close(through(tb.PlateRandomWalk(0.5, moment), 0 * W), size * walk, 1e-9)
    long_ago = through(tb.PlateRandomWalk(1.0), 0 * white, CLOCK - 9.0)
    close(long_ago[0], 3.0 * white[0] * [1, 1, 1, 0.01, 0.01, 0.01])
    fault = tb.PlatePinkNoise(2.0, 2.0, 0.5)
    pink = np.hstack([through(fault, 0 * W, seed=seed) for seed in range(20)])
    assert pink.std() == pytest.approx(2.0, rel=0.05)
    assert abs(np.corrcoef(pink[0], pink[-1])[0, 1]) < 0.4  # the end forgets the start
    frequency, density = welch(pink, RATE, nperseg=4000, axis=0, detrend=False)
    constant = 4.0 / (1 + np.log(RATE / 2 / 0.5))
    for f in (2.0, 10.0, 50.0, 200.0):  # three decibels an octave
        band = (frequency > f / 1.4) & (frequency < f * 1.4)
        level = np.mean(density.mean(axis=1)[band] * frequency[band])
        assert level == pytest.approx(constant, rel=0.15), f


def test_a_single_number_gets_signs_and_phases_by_chance_and_a_list_keeps_its_own() -> None:
    signs, phases = set(), []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        fault = tb.PlateBias(0.3, (1.0, -2.0, 3.0)).with_random_values(3, rng)
        assert np.abs(fault.force).tolist() == [0.3] * 3
        assert fault.moment == (1.0, -2.0, 3.0)
        signs.add(tuple(np.sign(fault.force)))
        phases += list(np.atleast_1d(tb.PlateHum().with_random_values(3, rng).phase or 0.0))
    assert len(signs) == 8
    every = np.sort(phases)
    assert np.diff(every, append=every[0] + 2 * np.pi).max() < 0.3  # all around, six at a time
    assert tb.PlateHum(phase=1.0).with_random_values(3, rng).phase == 1.0
    by_name = tb.EncoderEccentricity({"a": 1e-3}, period={"c": 0.01}).for_robot(NAMES)
    assert by_name.amplitude == (1e-3, 0.0, 0.0)
    assert by_name.period == (2 * np.pi, 2 * np.pi, 0.01)
