"""Faults together: their order, their streams, a tare that is measured, another instrument."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest

from testbed.arrays import Array
from testbed.errors import RecordingError
from testbed.instruments.chain import Instrument, measure, measured_again
from testbed.instruments.encoders import EncoderEccentricity, EncoderNoise, EncoderResolution
from testbed.instruments.fault import FULL_SCALE, Fault, Place
from testbed.instruments.faults import KINDS
from testbed.instruments.plate import PlateConverter, PlateCrosstalk, PlateGain, PlatePose
from testbed.instruments.plate_clock import PlateDroppedSamples
from testbed.instruments.plate_noise import PlateBias, PlateDrift, PlateNoise
from testbed.instruments.stage import applied, stream
from testbed.instruments.tare import MeasuredTare
from testbed.recordings.recording import Recording, Truth
from tests.helpers.ideal import ideal
from tests.helpers.runs import ROBOTS, robot

NAMES = ("a", "b", "c")
SAMPLES = 500
TIME = np.arange(SAMPLES) / 1000.0
TARE = np.array([1.0, -2.0, 245.0, 0.5, 0.25, -3.0])
NOISY = Instrument(encoder_noise=1e-3, torque_noise=0.5, force_noise=0.5, moment_noise=0.1)


def truth() -> Truth:
    phase = np.outer(TIME, [3.0, 4.0, 5.0]) + np.arange(3.0)
    q, qd, qdd = np.sin(phase), 3 * np.cos(phase), -9 * np.sin(phase)
    wrench = TARE + np.hstack([40 * q, 30 * qd])
    return Truth(q, qd, qdd, 20 * qdd, qd, wrench)


def nothing() -> Truth:
    still = np.zeros((SAMPLES, 3))
    return Truth(still, still, still, still, still, np.zeros((SAMPLES, 6)))


def seen(*faults: Fault, what: Truth | None = None, base: Instrument = NOISY) -> Recording:
    instrument = replace(base, fault=faults)
    return measure(instrument, NAMES, TIME, what or truth(), TARE, {}, seed=11)


def wrench(recording: Recording) -> Array:
    return recording.measured("wrench")


def net_of(recording: Recording) -> Array:
    assert recording.tare is not None
    return wrench(recording) - recording.tare


def same(one: Array | None, other: Array | None) -> None:
    np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_leaves_other_signals_and_the_noise_of_all_others_alone(kind: str) -> None:
    fault, without = KINDS[kind](), seen()
    recording = seen(fault)
    for signal in ("position", "torque", "wrench", "tare"):
        if signal == fault.signal:
            assert (getattr(recording, signal) != getattr(without, signal)).any()
        else:
            same(getattr(recording, signal), getattr(without, signal))
    if fault.place >= Place.RANGE or fault.signal == "tare":
        return  # acts on the noise of the others as on all that it is given
    # where nothing happens, what is shown is noise alone
    silent, bare = seen(what=nothing()), seen(fault, what=nothing())
    alone = seen(fault, what=nothing(), base=Instrument())
    noise, both, own = (getattr(each, fault.signal) for each in (silent, bare, alone))
    if fault.place < Place.NOISE and not own.any():
        same(both, noise)
    elif kind not in ("encoder_noise", "torque_noise", "plate_noise"):
        np.testing.assert_allclose(both - own, noise, atol=1e-12)
    else:
        first = noise / noise.std(axis=0)
        second = (both - noise) / (both - noise).std(axis=0)
        assert np.abs(np.mean(first * second, axis=0)).max() < 0.2


def test_two_of_one_kind_have_streams_of_their_own() -> None:
    one = wrench(seen(PlateNoise(), what=nothing(), base=Instrument()))
    two = wrench(seen(PlateNoise(), PlateNoise(), what=nothing(), base=Instrument()))
    assert abs(np.mean((two - one) * one)) < 0.1 * np.mean(one**2)
    assert np.mean(two**2) == pytest.approx(2 * np.mean(one**2), rel=0.1)
    signs = [
        fault
        for fault in Instrument(fault=(PlateBias(),) * 8).installed(NAMES, truth().position, 0)[
            "wrench"
        ]
        if isinstance(fault, PlateBias)
    ]
    assert len({(fault.force, fault.moment) for fault in signs}) > 1


def test_places_decide_and_then_the_file() -> None:
    faults = (PlateDroppedSamples(0.3), PlateConverter(), PlateNoise(), PlateCrosstalk())
    results = {wrench(seen(*order)).tobytes() for order in permutations(faults)}
    assert len(results) == 1
    gain, pose = PlateGain((0.5, 0.0, 0.0, 0.0, 0.0, 0.0)), PlatePose((0.0, 0.0, 1.0), 0.0)
    shown = truth().wrench
    for order in ((gain, pose), (pose, gain)):
        expected = applied(order, shown, TIME, 0)
        found = wrench(seen(*order, base=Instrument()))
        # translation 0 may be drawn with either sign
        np.testing.assert_allclose(found, expected, atol=1e-12)
    assert (wrench(seen(gain, pose)) != wrench(seen(pose, gain))).any()


def test_counts_come_after_every_noise() -> None:
    recording = seen(EncoderResolution(0.25), EncoderNoise(0.1), EncoderEccentricity(0.1))
    counts = recording.position / 0.25
    same(counts, np.rint(counts))


def test_what_chance_decides_once_is_told() -> None:
    instrument = replace(NOISY, fault=(PlateBias(), PlateCrosstalk()))
    installed = instrument.installed(NAMES, truth().position, 11)["wrench"]
    assert [fault.kind for fault in installed] == ["plate_crosstalk", "plate_noise", "plate_bias"]
    same(applied(installed, truth().wrench, TIME, 11), seen(PlateBias(), PlateCrosstalk()).wrench)


def test_crosstalk_and_converter_go_by_the_instruments_full_scale() -> None:
    plate = Instrument(full_scale=tuple(10 * v for v in FULL_SCALE))  # type: ignore[arg-type]
    exact = truth().wrench
    coarse = wrench(seen(PlateConverter(8), base=plate))
    same(coarse, np.array(plate.full_scale) / 128 * np.round(exact / plate.full_scale * 128))


def test_the_tare_is_exact_unless_measured() -> None:
    same(seen(PlateBias(), PlatePose(), PlateCrosstalk()).tare, TARE)


def test_a_measured_tare_has_the_plates_bias_and_pose() -> None:
    """What is constant leaves with it: the wrench less the tare is as with a true zero."""
    quiet = Instrument()
    for faults in ((PlateBias(),), (PlateBias(), PlateBias(1.0))):
        recording = seen(*faults, MeasuredTare(), base=quiet)
        np.testing.assert_allclose(net_of(recording), truth().wrench - TARE, atol=1e-10)
    for fault in (PlatePose(), PlateCrosstalk(), PlateGain()):
        without = replace(truth(), wrench=truth().wrench - TARE)
        recording = seen(fault, MeasuredTare(), base=quiet)
        bare = wrench(seen(fault, what=without, base=quiet))
        np.testing.assert_allclose(net_of(recording), bare, atol=1e-10)


def test_a_measured_tare_has_noise_of_its_own_and_the_drift_since() -> None:
    exact, spread = [], []
    for seed in range(300):
        instrument = replace(NOISY, rate=100.0, fault=(MeasuredTare(1.0),))
        found = measure(instrument, NAMES, TIME, truth(), TARE, {}, seed)
        exact.append(np.asarray(found.tare) - TARE)
        spread.append((wrench(found) - truth().wrench)[:100].mean(axis=0))
    sigma = np.repeat([0.5, 0.1], 3) / 10
    np.testing.assert_allclose(np.std(exact, axis=0), sigma, rtol=0.15)
    z, other = np.array(exact) / sigma, np.array(spread) / sigma
    assert np.abs(np.mean(z * other, axis=0)).max() < 0.2
    drift = PlateDrift((0.05, 0.0, 0.0), 0.0)
    recording = seen(drift, MeasuredTare(5.0, 60.0), base=Instrument())
    assert recording.tare is not None
    np.testing.assert_allclose(recording.tare, TARE - 0.05 * 62.5005 * np.eye(6)[0])


def test_the_tares_noise_leaves_the_recordings_alone() -> None:
    same(seen(MeasuredTare()).wrench, seen().wrench)
    first = stream("plate_noise", 11, 0, "tare").normal(size=(5, 6))
    assert (first != stream("plate_noise", 11).normal(size=(5, 6))).all()


def test_a_run_is_measured_again_without_simulation() -> None:
    first, faulty = seen(), seen(PlateBias(), MeasuredTare())
    again = measured_again(first, replace(NOISY, fault=(PlateBias(), MeasuredTare())), 11)
    for signal in ("position", "torque", "wrench", "tare"):
        same(getattr(again, signal), getattr(faulty, signal))
    with pytest.raises(RecordingError, match="with truth and tare"):
        measured_again(first.blind(), NOISY, 11)
    with pytest.raises(RecordingError, match="simulate again"):
        measured_again(first, replace(NOISY, rate=500.0), 11)


@pytest.mark.parametrize("name", ROBOTS)
def test_every_fault_suits_every_robot(name: str) -> None:
    recording = ideal(robot(name), duration=20.0)
    every = tuple(fault() for fault in KINDS.values())
    for faults in (*((fault,) for fault in every), every):
        shown = measured_again(recording, Instrument(rate=200.0, fault=faults), 5)
        for signal in ("position", "torque", "wrench", "tare"):
            values, exact = getattr(shown, signal), getattr(recording, signal)
            assert np.isfinite(values).all()
            spoiled = any(fault.signal == signal for fault in faults)
            assert (values != exact).any() == (spoiled and not _keeps(signal, faults))


def _keeps(signal: str, faults: tuple[Fault, ...]) -> bool:
    """A measured tare of a plate without noise or drift is exact; here it is zero besides."""
    return signal == "tare" and len(faults) == 1
