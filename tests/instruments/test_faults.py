"""Every fault does what its formula says, on exact signals, told by another way of computing it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.signal import butter, freqs, welch
from scipy.spatial.transform import Rotation

from testbed.arrays import Array
from testbed.instruments.drives import TorqueConstantError, TorqueNoise, TorqueOffset, TorqueRipple
from testbed.instruments.encoders import (
    EncoderEccentricity,
    EncoderGain,
    EncoderInstantSampling,
    EncoderNoise,
    EncoderResolution,
    EncoderZeroError,
)
from testbed.instruments.fault import FULL_SCALE, Fault, Rig
from testbed.instruments.plate import (
    PlateConverter,
    PlateCrosstalk,
    PlateGain,
    PlateOriginHeight,
    PlatePose,
    PlateSaturation,
)
from testbed.instruments.plate_clock import (
    PlateAntiAliasFilter,
    PlateClockRate,
    PlateDelay,
    PlateDroppedSamples,
    PlateJitter,
)
from testbed.instruments.plate_noise import (
    PlateBias,
    PlateColouredNoise,
    PlateDrift,
    PlateHum,
    PlateNoise,
    PlatePinkNoise,
    PlateRandomWalk,
)
from testbed.instruments.tare import MeasuredTare

RATE = 1000.0
TIME = np.arange(4000) / RATE
NAMES = ("a", "b", "c")
SIX = np.arange(1.0, 7.0)


def waves(time: Array, channels: int = 6) -> Array:
    """Smooth signals of a robot's frequencies around loads of its size."""
    k = np.arange(channels)
    return 40.0 * (k + 1) + (10.0 + k) * np.sin(2 * np.pi * np.outer(time, 0.3 + 0.2 * k) + k)


def through(fault: Fault, signal: Array, time: Array = TIME, seed: int = 0) -> Array:
    return fault.apply(signal, time, np.random.default_rng(seed))


def added(fault: Fault, seed: int = 0, samples: int = 4000) -> Array:
    """What a fault adds to zero."""
    return through(fault, np.zeros((samples, 6)), np.arange(samples) / RATE, seed)


# what shows values wrongly, joint by joint and channel by channel


def test_errors_of_zero_are_added() -> None:
    q, w = waves(TIME, 3), waves(TIME)
    np.testing.assert_array_equal(
        through(EncoderZeroError((1.0, 0.0, -2.0)), q), np.add(q, [1, 0, -2])
    )
    np.testing.assert_array_equal(through(TorqueOffset(0.5), q), q + 0.5)
    biased = through(PlateBias(2.0, (0.0, 0.5, -0.5)), w)
    np.testing.assert_array_equal(biased, np.add(w, [2, 2, 2, 0, 0.5, -0.5]))


def test_errors_of_scale_multiply() -> None:
    q, w = waves(TIME, 3), waves(TIME)
    np.testing.assert_allclose(through(EncoderGain(0.01), q) / q, 1.01, rtol=1e-14)
    seen = through(TorqueConstantError((0.08, -0.06, 0.0)), q)
    np.testing.assert_allclose(seen, q @ np.diag([1.08, 0.94, 1.0]), rtol=1e-14)
    np.testing.assert_allclose(through(PlateGain(tuple(SIX / 100)), w) / w - 1, [SIX / 100] * 4000)


def test_eccentricity_and_ripple_are_waves_of_the_position() -> None:
    q = np.linspace(-4.0, 4.0, 4000)[:, None] * [1.0, 0.5, 2.0]
    error = through(EncoderEccentricity(4e-4, phase=(0.0, 0.5, 1.0)), q) - q
    np.testing.assert_allclose(
        error, 4e-4 * np.imag(np.exp(1j * np.add(q, [0, 0.5, 1]))), atol=1e-15
    )
    lead = through(EncoderEccentricity(1e-3, period=0.01), q) - q
    np.testing.assert_allclose(lead, 1e-3 * np.sin(q * 200 * np.pi), atol=1e-14)
    fault = TorqueRipple(0.02, period=0.1).on(Rig(NAMES, position=q))
    ripple = through(fault, np.full((4000, 3), 30.0)) / 30 - 1
    np.testing.assert_allclose(ripple, 0.02 * np.sin(20 * np.pi * q), atol=1e-14)
    with pytest.raises(ValueError, match="put it on a Rig"):
        through(TorqueRipple(), q)


def test_counts_are_whole_and_the_nearest() -> None:
    q = waves(TIME, 3)
    seen = through(EncoderResolution((0.1, 0.0, 0.25)), q)
    np.testing.assert_array_equal(seen[:, 1], q[:, 1])
    assert np.abs(seen - q)[:, [0, 2]].max(axis=0) == pytest.approx([0.05, 0.125], rel=0.05)
    assert np.abs(seen[:, 2] / 0.25 - np.rint(seen[:, 2] / 0.25)).max() == 0


def test_a_converter_counts_within_its_range() -> None:
    wrench = np.outer(np.linspace(-1.5, 1.5, 4000), FULL_SCALE)
    seen = through(PlateConverter(8), wrench) / FULL_SCALE * 128
    assert np.abs(seen - np.rint(seen)).max() < 1e-12
    assert (seen.min(), seen.max()) == (-128, 127)
    inside = np.abs(wrench[:, 0]) < 0.99 * FULL_SCALE[0]
    assert np.abs(seen - wrench / FULL_SCALE * 128)[inside].max() <= 0.5 + 1e-12
    finer = np.abs(through(PlateConverter(16), waves(TIME) / 4) - waves(TIME) / 4).max(axis=0)
    assert (finer <= np.array(FULL_SCALE) / 2**16 * 1.001).all()


def test_saturation_covers_a_share_of_the_swing_or_has_limits() -> None:
    w = waves(TIME)
    seen = through(PlateSaturation(0.9), w)
    np.testing.assert_allclose(np.ptp(seen, axis=0), 0.9 * np.ptp(w, axis=0))
    np.testing.assert_allclose(seen.max(0) + seen.min(0), w.max(0) + w.min(0))
    hurt = seen != w
    assert 0.1 < hurt.mean() < 0.5
    limited = through(PlateSaturation(limit=(1.0, 90.0, 1e3, 1e3, 1e3, 1e3)), w)
    np.testing.assert_array_equal(limited[:, 0], 1.0)
    np.testing.assert_array_equal(limited[:, 1], [min(v, 90.0) for v in w[:, 1]])
    np.testing.assert_array_equal(limited[:, 2:], w[:, 2:])


def test_crosstalk_is_in_proportion_to_full_scale() -> None:
    x = np.zeros((6, 6))
    x[3, 2], x[0, 5], x[1, 1] = 0.01, -0.02, 0.005
    rows = tuple(map(tuple, x.tolist()))
    loads = np.diag(FULL_SCALE)  # each channel alone at its full scale
    seen = PlateCrosstalk(matrix=rows).apply(loads, TIME[:6], np.random.default_rng(0))
    np.testing.assert_allclose(((seen - loads) / FULL_SCALE).T, x, atol=1e-15)
    drawn = PlateCrosstalk(0.01).drawn(Rig(NAMES), np.random.default_rng(1))
    mixing = np.array(drawn.matrix)
    assert np.diagonal(mixing).tolist() == [0] * 6
    assert 0.005 < np.abs(mixing).max() <= 0.01
    other = PlateCrosstalk(matrix=rows).on(Rig(NAMES, (1.0,) * 6))
    np.testing.assert_allclose(
        other.apply(np.eye(6), TIME[:6], np.random.default_rng(0)).T, np.eye(6) + x
    )


def test_a_plate_elsewhere_shows_forces_at_points_about_its_own_origin() -> None:
    """Witness: a force at a point, its lever and components taken in the plate's frame."""
    rng = np.random.default_rng(3)
    force, point, couple = rng.normal(size=(3, 50, 3))
    origin, vector = np.array([0.1, -0.2, 0.3]), np.array([0.3, -0.2, 0.5])
    axes = Rotation.from_rotvec(vector)
    wrench = np.hstack([force, np.cross(point, force) + couple])
    seen = through(PlatePose(tuple(vector), tuple(origin)), wrench, TIME[:50])
    inside, lever = axes.inv().apply(force), axes.inv().apply(point - origin)
    np.testing.assert_allclose(seen[:, :3], inside, atol=1e-14)
    couples = axes.inv().apply(couple)
    np.testing.assert_allclose(seen[:, 3:], np.cross(lever, inside) + couples, atol=1e-14)
    high = through(PlateOriginHeight(0.3), wrench, TIME[:50])
    np.testing.assert_allclose(high[:, 3], wrench[:, 3] + 0.3 * force[:, 1])
    np.testing.assert_allclose(high[:, 4], wrench[:, 4] - 0.3 * force[:, 0])
    np.testing.assert_allclose(high[:, [0, 1, 2, 5]], wrench[:, [0, 1, 2, 5]])


# what comes late or not


def test_delays_are_exact_for_smooth_signals() -> None:
    inner = slice(300, -300)
    for delay in (1e-3, 2.34e-4, -7e-4, 0.0123):
        seen = through(PlateDelay(delay), waves(TIME))
        np.testing.assert_allclose(seen[inner], waves(TIME - delay)[inner], atol=1e-9)
    fast = through(PlateClockRate(0.01), waves(TIME))
    np.testing.assert_allclose(fast[inner], waves(TIME / 1.01)[inner], atol=1e-9)
    instants = TIME + 5e-5 * np.random.default_rng(4).normal(size=4000)
    jittered = through(PlateJitter(5e-5), waves(TIME), seed=4)
    np.testing.assert_allclose(jittered[inner], waves(instants)[inner], atol=1e-9)


def test_before_its_first_sample_a_late_plate_holds_it() -> None:
    seen = through(PlateDelay(0.01), waves(TIME))
    np.testing.assert_allclose(seen[:10], np.tile(waves(TIME)[0], (10, 1)), atol=1e-10)
    early = through(PlateDelay(-0.01), waves(TIME))
    np.testing.assert_allclose(early[-10:], np.tile(waves(TIME)[-1], (10, 1)), atol=1e-10)


@pytest.mark.parametrize("order", range(1, 9))
@pytest.mark.parametrize("frequency", [0.5, 5.0, 40.0])
def test_the_anti_alias_filter_is_butterworths(order: int, frequency: float) -> None:
    """Witness: gain and phase of the analog filter, from SciPy."""
    time = np.arange(20_000) / 10_000.0
    gain = freqs(*butter(order, 2 * np.pi * 50, analog=True), worN=[2 * np.pi * frequency])[1][0]
    signal = np.tile(np.sin(2 * np.pi * frequency * time)[:, None], 6)
    seen = through(PlateAntiAliasFilter(50.0, order), signal, time)[:, 0]
    expected = np.imag(gain * np.exp(2j * np.pi * frequency * time))
    straight = (2 * np.pi * frequency * 1e-4) ** 2 / 12  # error of a sine of straight pieces
    assert np.abs(seen - expected)[5000:].max() < 1.1 * straight * (order + 1) / 2 + 1e-8


def test_the_anti_alias_filter_delays_slow_signals() -> None:
    ramp = np.outer(TIME, SIX)
    seen = through(PlateAntiAliasFilter(100.0), ramp)
    late = np.sqrt(2) / (2 * np.pi * 100)
    np.testing.assert_allclose(seen[1000:], (TIME[1000:, None] - late) * SIX, rtol=1e-9)
    still = np.tile(SIX, (4000, 1))
    np.testing.assert_allclose(through(PlateAntiAliasFilter(100.0, 8), still), still, rtol=1e-9)


def test_lost_samples_are_repeated() -> None:
    w = waves(TIME)
    seen = through(PlateDroppedSamples(0.2), w)
    lost = np.flatnonzero((seen != w).any(axis=1))
    assert 0.17 < len(lost) / 4000 < 0.23
    for k in lost:
        np.testing.assert_array_equal(seen[k], seen[k - 1])
    assert (through(PlateDroppedSamples(1.0), w) == w[0]).all()


def test_latched_positions_are_those_of_the_samples_start() -> None:
    """Witness: the integral of the signal, in closed form."""
    step = 1 / RATE
    f, k = 0.3 + 0.2 * np.arange(3), np.arange(3)
    phase = 2 * np.pi * np.outer(TIME, f) + k
    sines = (np.cos(phase) - np.cos(phase + 2 * np.pi * f * step)) / (2 * np.pi * f * step)
    means = 40.0 * (k + 1) + (10.0 + k) * sines
    seen = through(EncoderInstantSampling(), means)
    exact = waves(TIME, 3)
    assert np.abs(means - exact).max() > 1e-2
    np.testing.assert_allclose(seen, exact, atol=2e-9)


# what is added


def test_white_noise_is_as_large_as_asked_for() -> None:
    sizes = added(PlateNoise(0.5, (0.1, 0.2, 0.3)), samples=100_000).std(axis=0)
    np.testing.assert_allclose(sizes, [0.5, 0.5, 0.5, 0.1, 0.2, 0.3], rtol=0.02)
    zero = np.zeros((100_000, 3))
    for kind in (EncoderNoise, TorqueNoise):
        noise = through(kind((0.1, 0.0, 0.3)), zero, np.arange(100_000) / RATE)
        np.testing.assert_allclose(noise.std(axis=0), [0.1, 0.0, 0.3], rtol=0.02)


def test_a_drift_is_a_slope_from_time_0() -> None:
    for time in (TIME, TIME - 60.0):
        seen = through(PlateDrift((1.0, 2.0, 3.0), 0.5), np.zeros((4000, 6)), time)
        np.testing.assert_allclose(seen, np.outer(time, [1, 2, 3, 0.5, 0.5, 0.5]))


def test_a_random_walk_spreads_as_the_root_of_time() -> None:
    walks = np.array([added(PlateRandomWalk(0.05, 0.01), seed, 1001) for seed in range(400)])
    assert (walks[:, 0] == 0).all()
    spread = walks.std(axis=0)
    for k in (100, 1000):
        expected = np.repeat([0.05, 0.01], 3) * np.sqrt(k / RATE)
        np.testing.assert_allclose(spread[k], expected, rtol=0.15)
    steps = np.diff(walks, axis=1)
    assert abs(np.mean(steps[:, 1:] * steps[:, :-1])) < 0.01 * np.mean(steps**2)
    zero, long_ago = np.zeros((100, 6)), TIME[:100] - 9.0
    before = [through(PlateRandomWalk(1.0), zero, long_ago, s)[0, 0] for s in range(400)]
    assert np.std(before) == pytest.approx(3.0, rel=0.15)


def test_coloured_noise_forgets_with_its_time_constant_and_is_stationary() -> None:
    tau = 0.05
    noise = np.concatenate([added(PlateColouredNoise(2.0, 2.0, tau), s) for s in range(40)], axis=1)
    assert noise.std() == pytest.approx(2.0, rel=0.02)
    assert noise[0].std() == pytest.approx(2.0, rel=0.15)
    for lag in (10, 50, 150):
        correlation = np.mean(noise[lag:] * noise[:-lag]) / 4.0
        assert correlation == pytest.approx(np.exp(-lag / RATE / tau), abs=0.02)


def test_pink_noise_falls_by_three_decibels_an_octave() -> None:
    noise = np.concatenate([added(PlatePinkNoise(2.0, 2.0, 0.5), s) for s in range(60)], axis=1)
    assert noise.std() == pytest.approx(2.0, rel=0.05)
    short = np.array([added(PlatePinkNoise(2.0, 2.0, 0.5), seed, 8) for seed in range(400)])
    assert short.std() == pytest.approx(2.0, rel=0.05)  # mostly of the lowest lines
    frequency, density = welch(noise, RATE, nperseg=4000, axis=0, detrend=False)
    level = density.mean(axis=1)
    for f in (2.0, 10.0, 50.0, 200.0):
        band = (frequency > f / 1.4) & (frequency < f * 1.4)
        constant = 4.0 / (1 + np.log(RATE / 2 / 0.5))
        assert np.mean(level[band] * frequency[band]) == pytest.approx(constant, rel=0.1), f


def test_hum_is_one_line_of_the_spectrum() -> None:
    phase = tuple(SIX)
    hum = added(PlateHum(2.0, 0.5, 50.0, phase))
    lines = np.fft.rfft(hum, axis=0) / 2000
    amplitude = np.repeat([2.0, 0.5], 3)
    np.testing.assert_allclose(lines[200], amplitude * np.exp(1j * (SIX - np.pi / 2)), atol=1e-9)
    lines[200] = 0
    assert np.abs(lines).max() < 1e-9


def test_a_measured_tare_is_the_mean_before_the_recording() -> None:
    fault = MeasuredTare(2.0, 10.0)
    time = fault.instants(100.0)
    assert (len(time), time[0]) == (200, -12.0)
    assert time[-1] == pytest.approx(-10.01)
    seen = through(fault, np.outer(time, SIX), time)
    np.testing.assert_allclose(seen, np.tile(-11.005 * SIX, (200, 1)))


# what chance decides once


@pytest.mark.parametrize("size", [0.0, 0.3])
def test_a_single_number_gets_signs_and_a_list_keeps_its_own(size: float) -> None:
    rig = Rig(NAMES)
    signs = set()
    for seed in range(40):
        fault = PlateBias(size, (1.0, -2.0, 3.0)).drawn(rig, np.random.default_rng(seed))
        force = np.array(fault.force)
        assert np.abs(force).tolist() == [size] * 3
        assert fault.moment == (1.0, -2.0, 3.0)
        signs.add(tuple(np.signbit(force)))
    assert len(signs) == 8
    joints = EncoderZeroError(1e-3).drawn(rig, np.random.default_rng(0))
    assert isinstance(joints.error, tuple)
    assert [abs(error) for error in joints.error] == [1e-3] * 3


def test_phases_are_drawn_unless_said() -> None:
    rig, rng = Rig(NAMES), np.random.default_rng(0)
    drawn = PlateHum().drawn(rig, rng).phase
    assert isinstance(drawn, tuple)
    assert len(set(drawn)) == 6
    assert PlateHum(phase=1.0).drawn(rig, rng).phase == 1.0
    every = np.sort([PlateHum().drawn(rig, rng).phase for _ in range(50)], axis=None)
    assert every[0] >= 0
    assert every[-1] < 2 * np.pi
    assert np.diff(every, append=every[0] + 2 * np.pi).max() < 0.3  # all around
    joints = EncoderEccentricity().drawn(rig, rng).phase
    assert isinstance(joints, tuple)
    assert len(joints) == 3


NOTHING: tuple[Any, ...] = (
    EncoderZeroError(0.0),
    EncoderGain(0.0),
    EncoderEccentricity(0.0),
    EncoderNoise(0.0),
    EncoderResolution(0.0),
    TorqueConstantError(0.0),
    TorqueRipple(0.0),
    TorqueOffset(0.0),
    TorqueNoise(0.0),
    PlateGain(0.0),
    PlateCrosstalk(0.0),
    PlatePose(0.0, 0.0),
    PlateOriginHeight(0.0),
    PlateSaturation(1.0),
    PlateDelay(0.0),
    PlateClockRate(0.0),
    PlateJitter(0.0),
    PlateDroppedSamples(0.0),
    PlateBias(0.0, 0.0),
    PlateDrift(0.0, 0.0),
    PlateRandomWalk(0.0, 0.0),
    PlateNoise(0.0, 0.0),
    PlateColouredNoise(0.0, 0.0),
    PlatePinkNoise(0.0, 0.0),
    PlateHum(0.0, 0.0),
)


@pytest.mark.parametrize("fault", NOTHING, ids=lambda fault: fault.kind)
def test_a_fault_of_no_size_is_none_to_the_bit(fault: Fault) -> None:
    width = 6 if fault.signal == "wrench" else 3
    signal = np.random.default_rng(9).normal(size=(1000, width))
    rig = Rig(NAMES, position=waves(TIME[:1000], 3))
    fault = fault.on(rig).drawn(rig, np.random.default_rng(1))
    assert through(fault, signal, TIME[:1000]).tobytes() == signal.tobytes()
