"""Every fault does what its formula says, on exact signals, told by another way of computing it.

If one fails, studies and warnings of a fault are of another one.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import butter, freqs, welch
from scipy.spatial.transform import Rotation

from testbed.core.base.arrays import Array
from testbed.lab.instruments import joints, plate, plate_clock
from testbed.lab.instruments.fault import FULL_SCALE, Fault
from tests.helpers.strategies import rngs

RATE = 1000.0
TIME = np.arange(4000) / RATE
NAMES = ("a", "b", "c")
SIX = np.arange(1.0, 7.0)
INNER = slice(300, -300)


def waves(time: Array, channels: int = 6) -> Array:
    """Smooth signals of a robot's frequencies around loads of its size."""
    k = np.arange(channels)
    return 40.0 * (k + 1) + (10.0 + k) * np.sin(2 * np.pi * np.outer(time, 0.3 + 0.2 * k) + k)


Q, W = waves(TIME, 3), waves(TIME)


def through(fault: Fault, signal: Array, time: Array = TIME, seed: int = 0) -> Array:
    return fault.apply(signal, time, np.random.default_rng(seed))


def same(one: Array, other: Array, size: float = 1e-12) -> None:
    np.testing.assert_allclose(one, other, rtol=size, atol=size)


def test_zeros_and_scales_are_wrong_joint_by_joint_and_channel_by_channel() -> None:
    same(through(joints.EncoderZeroError((1.0, 0.0, -2.0)), Q), np.add(Q, [1, 0, -2]))
    same(through(joints.TorqueOffset(0.5), Q), Q + 0.5)
    same(through(plate.PlateBias(2.0, (0.0, 0.5, -0.5)), W), np.add(W, [2, 2, 2, 0, 0.5, -0.5]))
    same(through(joints.EncoderGain(0.01), Q), 1.01 * Q)
    same(through(joints.TorqueConstantError((0.08, -0.06, 0.0)), Q), Q @ np.diag([1.08, 0.94, 1.0]))
    same(through(plate.PlateGain(tuple(SIX / 100)), W), W @ np.diag(1 + SIX / 100))
    for time in (TIME, TIME - 60.0):  # a drift begins at time 0
        slope = through(plate.PlateDrift((1.0, 2.0, 3.0), 0.5), W, time) - W
        same(slope, np.outer(time, [1, 2, 3, 0.5, 0.5, 0.5]), 1e-10)


def test_eccentricity_and_hum_are_waves() -> None:
    q = np.linspace(-4.0, 4.0, 4000)[:, None] * [1.0, 0.5, 2.0]
    error = through(joints.EncoderEccentricity(4e-4, phase=(0.0, 0.5, 1.0)), q) - q
    same(error, 4e-4 * np.imag(np.exp(1j * np.add(q, [0, 0.5, 1]))))
    lead = through(joints.EncoderEccentricity(1e-3, period=0.01), q) - q
    same(lead, 1e-3 * np.sin(q * 200 * np.pi))
    lines = np.fft.rfft(through(plate.PlateHum(2.0, 0.5, 50.0, tuple(SIX)), 0 * W), axis=0) / 2000
    same(lines[200], np.repeat([2.0, 0.5], 3) * np.exp(1j * (SIX - np.pi / 2)), 1e-9)
    lines[200] = 0
    assert np.abs(lines).max() < 1e-9


def test_counts_are_whole_and_the_nearest_and_signals_end_where_ranges_do() -> None:
    """Of encoders, of a plate's converter and of a plate that saturates."""
    seen = through(joints.EncoderResolution((0.1, 0.0, 0.25)), Q)
    same(seen[:, 1], Q[:, 1])
    same(seen[:, 2], 0.25 * np.floor(Q[:, 2] / 0.25 + 0.5))
    wrench = np.outer(np.linspace(-1.5, 1.5, 4000), FULL_SCALE)
    counts = through(plate.PlateConverter(8), wrench) / FULL_SCALE * 128
    same(counts, np.clip(np.rint(wrench / FULL_SCALE * 128), -128, 127))
    share = through(plate.PlateSaturation(0.9), W)
    same(np.ptp(share, axis=0), 0.9 * np.ptp(W, axis=0))
    same(share.max(0) + share.min(0), W.max(0) + W.min(0))


def test_crosstalk_is_in_proportion_to_full_scale() -> None:
    """Each channel alone at its full scale shows one column of the matrix in all others."""
    x = np.zeros((6, 6))
    x[3, 2], x[0, 5], x[1, 1] = 0.01, -0.02, 0.005
    fault = plate.PlateCrosstalk(matrix=tuple(map(tuple, x.tolist())))
    for scale in (FULL_SCALE, (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)):
        loads = np.diag(scale)
        seen = through(fault.on(NAMES, scale), loads, TIME[:6])
        same(((seen - loads) / scale).T, x)
    mixing = np.array(plate.PlateCrosstalk(0.01).sample(3, np.random.default_rng(1)).matrix)
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
    seen = through(plate.PlatePose(tuple(vector), tuple(origin)), wrench, TIME[:20])
    inside = axes.apply(force)
    moment = np.cross(axes.apply(point - origin), inside) + axes.apply(couple)
    same(seen, np.hstack([inside, moment]))


def test_what_comes_late_is_the_signal_of_another_time() -> None:
    """Exact for smooth signals; held before the first sample and after the last."""
    for delay in (1e-3, 2.34e-4, -7e-4, 0.0123):
        same(through(plate_clock.PlateDelay(delay), W)[INNER], waves(TIME - delay)[INNER], 1e-9)
    same(through(plate_clock.PlateClockRate(0.01), W)[INNER], waves(TIME / 1.01)[INNER], 1e-9)
    same(through(plate_clock.PlateDelay(0.01), W)[:10], np.tile(W[0], (10, 1)), 1e-10)
    same(through(plate_clock.PlateDelay(-0.01), W)[-10:], np.tile(W[-1], (10, 1)), 1e-10)
    seen = through(plate_clock.PlateDroppedSamples(0.2), W)
    lost = np.flatnonzero((seen != W).any(axis=1))
    assert 0.17 < len(lost) / 4000 < 0.23
    same(seen[lost], seen[lost - 1])
    # means over samples, in closed form, tell the instants at which they begin
    f, k = 0.3 + 0.2 * np.arange(3), np.arange(3)
    phase, turn = 2 * np.pi * np.outer(TIME, f) + k, 2 * np.pi * f / RATE
    means = 40.0 * (k + 1) + (10.0 + k) * (np.cos(phase) - np.cos(phase + turn)) / turn
    same(through(joints.EncoderInstantSampling(), means), Q, 2e-9)


@given(order=st.integers(1, 8), frequency=st.sampled_from([0.5, 5.0, 40.0]))
def test_the_anti_alias_filter_is_butterworths(order: int, frequency: float) -> None:
    """Witness: gain and phase of the analog filter, from SciPy; a signal at rest stays."""
    time = np.arange(20_000) / 10_000.0
    gain = freqs(*butter(order, 2 * np.pi * 50, analog=True), worN=[2 * np.pi * frequency])[1][0]
    signal = np.tile(np.sin(2 * np.pi * frequency * time)[:, None], 6)
    seen = through(plate_clock.PlateAntiAliasFilter(50.0, order), signal, time)[:, 0]
    expected = np.imag(gain * np.exp(2j * np.pi * frequency * time))
    straight = (2 * np.pi * frequency * 1e-4) ** 2 / 12  # error of a sine of straight pieces
    assert np.abs(seen - expected)[5000:].max() < 1.1 * straight * (order + 1) / 2 + 1e-8
    still = np.tile(SIX, (500, 1))
    same(through(plate_clock.PlateAntiAliasFilter(100.0, order), still, TIME[:500]), still, 1e-9)


def test_noise_has_its_size_and_memory() -> None:
    """White, walking and coloured noise are recursions of one stream; pink is told by Welch."""
    white = np.random.default_rng(0).normal(size=(4000, 6))
    size = np.array([0.5, 0.5, 0.5, 0.1, 0.2, 0.3])
    moment = (0.1, 0.2, 0.3)
    same(through(plate.PlateNoise(0.5, moment), 0 * W), size * white)
    three = np.random.default_rng(0).normal(size=(4000, 3)) * [0.1, 0.0, 0.3]
    for kind in (joints.EncoderNoise, joints.TorqueNoise):
        same(through(kind((0.1, 0.0, 0.3)), Q) - Q, three)
    coloured, walk = np.array(white), 0.0 * white
    for k in range(1, 4000):
        kept = np.exp(-1 / RATE / 0.05)
        coloured[k] = kept * coloured[k - 1] + np.sqrt(1 - kept**2) * white[k]
        walk[k] = walk[k - 1] + np.sqrt(1 / RATE) * white[k]
    same(through(plate.PlateColouredNoise(0.5, moment, 0.05), 0 * W), size * coloured, 1e-9)
    same(through(plate.PlateRandomWalk(0.5, moment), 0 * W), size * walk, 1e-9)
    long_ago = through(plate.PlateRandomWalk(1.0), 0 * white, TIME - 9.0)
    same(long_ago[0], 3.0 * white[0] * [1, 1, 1, 0.01, 0.01, 0.01])
    fault = plate.PlatePinkNoise(2.0, 2.0, 0.5)
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
        fault = plate.PlateBias(0.3, (1.0, -2.0, 3.0)).sample(3, rng)
        assert np.abs(fault.force).tolist() == [0.3] * 3
        assert fault.moment == (1.0, -2.0, 3.0)
        signs.add(tuple(np.sign(fault.force)))
        phases += list(np.atleast_1d(plate.PlateHum().sample(3, rng).phase or 0.0))
    assert len(signs) == 8
    every = np.sort(phases)
    assert np.diff(every, append=every[0] + 2 * np.pi).max() < 0.3  # all around, six at a time
    assert plate.PlateHum(phase=1.0).sample(3, rng).phase == 1.0
    by_name = joints.EncoderEccentricity({"a": 1e-3}, period={"c": 0.01}).on(NAMES)
    assert by_name.amplitude == (1e-3, 0.0, 0.0)
    assert by_name.period == (2 * np.pi, 2 * np.pi, 0.01)
