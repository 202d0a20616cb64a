"""The whole instrument: perfect unless it is told otherwise, and the same noise for ever."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from testbed.arrays import Array
from testbed.errors import SettingsError
from testbed.instruments.chain import Instrument, measure
from testbed.instruments.stage import stream
from testbed.recordings.recording import Recording, Truth

NAMES = ("a", "b", "c")
SAMPLES = 40


def truth() -> Truth:
    rng = np.random.default_rng(0)
    q, qd, qdd, torque, friction = rng.normal(size=(5, SAMPLES, 3))
    return Truth(q, qd, qdd, torque, friction, rng.normal(size=(SAMPLES, 6)))


def seen(instrument: Instrument, seed: int = 7) -> Recording:
    time = np.arange(SAMPLES) / instrument.rate
    return measure(instrument, NAMES, time, truth(), np.arange(6.0), {"robot": "r"}, seed)


def same(one: Array | None, other: Array) -> None:
    np.testing.assert_array_equal(one, other)


def test_by_default_it_shows_what_happened() -> None:
    instrument, what = Instrument(), truth()
    recording = seen(instrument)
    assert (instrument.rate, instrument.averaged) == (1000.0, True)
    same(recording.position, what.position)
    same(recording.torque, what.torque)
    same(recording.wrench, what.wrench)
    same(recording.tare, np.arange(6.0))
    assert recording.velocity is None
    assert recording.acceleration is None
    assert (recording.names, recording.facts) == (NAMES, {"robot": "r"})
    assert recording.truth is not None
    same(recording.truth.friction, what.friction)


def test_velocities_and_accelerations_are_sensed_exactly_or_not_at_all() -> None:
    recording = seen(Instrument(senses_kinematics=True, encoder_noise=1.0))
    same(recording.velocity, truth().velocity)
    same(recording.acceleration, truth().acceleration)


NOISES: list[tuple[str, dict[str, float], str, Any]] = [
    ("position", {"encoder_noise": 0.3}, "encoder_noise", 0.3),
    ("torque", {"torque_noise": 0.3}, "torque_noise", 0.3),
    ("wrench", {"force_noise": 0.3}, "plate_noise", [0.3, 0.3, 0.3, 0, 0, 0]),
    ("wrench", {"moment_noise": 0.2}, "plate_noise", [0, 0, 0, 0.2, 0.2, 0.2]),
]


@pytest.mark.parametrize(("signal", "noise", "kind", "sigma"), NOISES)
def test_noise_is_added_to_its_signal_alone(
    signal: str, noise: dict[str, Any], kind: str, sigma: Any
) -> None:
    recording = seen(Instrument(**noise))
    for name in ("position", "torque", "wrench"):
        exact = getattr(truth(), name)
        added = sigma * stream(kind, 7).normal(size=exact.shape) if name == signal else 0.0
        same(getattr(recording, name), exact + added)


GOLDEN = {
    "encoder_noise": -0.2407279463145176,
    "torque_noise": -0.5346093661287762,
    "plate_noise": -2.0306006741711506,
    "encoder_resolution": -0.05591096996529509,
    "some_fault": -1.5672328128223696,
}


def test_streams_are_those_of_older_recordings() -> None:
    """Golden: a recording made again from its seed shows the same numbers in any version."""
    first = {kind: stream(kind, 1996).normal() for kind in GOLDEN}
    assert first == GOLDEN


def test_torque_constants_are_wrong_by_the_joints_name() -> None:
    recording = seen(Instrument(torque_constant_error={"b": 0.08, "c": -0.02, "stranger": 9.0}))
    same(recording.torque, truth().torque * [1.0, 1.08, 0.98])


def test_encoders_count_the_noisy_position() -> None:
    noisy = seen(Instrument(encoder_noise=0.3)).position
    both = seen(Instrument(encoder_noise=0.3, encoder_resolution=0.25)).position
    same(both, 0.25 * np.round(noisy / 0.25))


def test_the_plate_has_noise_of_forces_and_of_moments() -> None:
    same(Instrument(force_noise=2.0, moment_noise=0.1).plate_noise, np.repeat([2.0, 0.1], 3))


SIZES = ("encoder_resolution", "encoder_noise", "torque_noise", "force_noise", "moment_noise")


@pytest.mark.parametrize("name", SIZES)
@pytest.mark.parametrize("value", [-1e-9, np.inf, np.nan])
def test_noise_that_is_none_is_refused_by_name(name: str, value: float) -> None:
    wrong: dict[str, Any] = {name: value}
    with pytest.raises(SettingsError, match=f"^{name} cannot be negative or infinite"):
        replace(Instrument(), **wrong)


@pytest.mark.parametrize("rate", [0.0, -1.0, np.inf, np.nan])
def test_a_rate_that_is_none_is_refused(rate: float) -> None:
    with pytest.raises(SettingsError, match="rate is a positive frequency"):
        Instrument(rate=rate)


@pytest.mark.parametrize("error", [np.nan, np.inf])
def test_a_torque_constant_that_is_no_number_is_refused_by_joint(error: float) -> None:
    with pytest.raises(SettingsError, match="torque_constant_error of 'b' is no number"):
        Instrument(torque_constant_error={"a": 0.1, "b": error})
