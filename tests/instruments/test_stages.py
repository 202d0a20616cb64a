"""Stages of an instrument: each has noise of its own, whatever stands beside it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from testbed.arrays import Array
from testbed.instruments.encoders import EncoderNoise, EncoderResolution
from testbed.instruments.plate_noise import PlateNoise
from testbed.instruments.stage import Stage, applied, stream

TIME = np.arange(100) / 100.0


@dataclass(frozen=True)
class Drift:
    """A made-up fault: a random slope."""

    kind: ClassVar[str] = "test_drift"
    size: float

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """The signal on a slope."""
        drifted: Array = signal + self.size * np.outer(time, rng.normal(size=signal.shape[1]))
        return drifted


def test_a_stage_more_leaves_the_noise_of_the_others_alone() -> None:
    zero = np.zeros((100, 6))
    noise = applied((PlateNoise(1.0, 0.1),), zero, TIME, seed=3)
    for stages in ((Drift(2.0), PlateNoise(1.0, 0.1)), (PlateNoise(1.0, 0.1), Drift(2.0))):
        both = applied(stages, zero, TIME, seed=3)
        drift = applied((Drift(2.0),), zero, TIME, seed=3)
        assert np.abs(drift).max() > 0.1
        np.testing.assert_allclose(both - drift, noise, atol=1e-14)


def test_stages_act_in_their_order() -> None:
    signal = np.linspace(0, 1, 100)[:, None]
    count, noise = EncoderResolution(0.1), EncoderNoise(0.01)
    last = applied((noise, count), signal, TIME, 0)
    np.testing.assert_allclose(last / 0.1, np.round(last / 0.1), atol=1e-9)
    first = applied((count, noise), signal, TIME, 0)
    assert np.abs(first / 0.1 - np.round(first / 0.1)).max() > 1e-3


def test_streams_differ_by_kind_and_seed_and_are_repeated() -> None:
    kinds = [stage.kind for stage in (EncoderNoise, EncoderResolution, PlateNoise, Drift)]
    draws = {(k, s): stream(k, s).normal(size=4).tobytes() for k in kinds for s in (0, 1)}
    assert len(set(draws.values())) == len(draws)
    assert all(stream(k, s).normal(size=4).tobytes() == found for (k, s), found in draws.items())


def test_every_stage_is_one() -> None:
    stages: tuple[Stage, ...] = (EncoderNoise(0.0), EncoderResolution(1.0), PlateNoise(0.0, 0.0))
    for stage in stages:
        same = stage.apply(np.ones((100, 6)), TIME, np.random.default_rng(0))
        np.testing.assert_array_equal(same, np.ones((100, 6)))
