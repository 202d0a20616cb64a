"""A stage of an instrument: what happens to a signal on its way from the truth to the recording.

An imperfection is one frozen dataclass with `kind` and `apply`, in the module of the device
that has it. Stages of a signal are applied in order.

Random numbers come from a stream of the stage's kind and the seed, so that adding, removing
or changing a stage leaves the noise of all others as it was, to the bit.
"""

from __future__ import annotations

import hashlib
from typing import ClassVar, Protocol

import numpy as np

from testbed.arrays import Array

_FIRST_STREAMS = {"encoder_noise": 0, "torque_noise": 1, "plate_noise": 2}
"""Streams of the kinds that were there before kinds had names; their noise stays the same."""


class Stage(Protocol):
    """One imperfection."""

    kind: ClassVar[str]
    """Its name in files, and of its random stream."""

    def apply(self, signal: Array, time: Array, rng: np.random.Generator) -> Array:
        """What the stage makes of a signal.

        Args:
            signal: (M, k), in the signal's unit.
            time: (M,) [s].
            rng: The kind's own random numbers.
        """


def stream(kind: str, seed: int) -> np.random.Generator:
    """Random numbers of a kind of stage.

    Args:
        kind: Of the stage.
        seed: Of the recording.
    """
    number = _FIRST_STREAMS.get(kind)
    if number is None:
        number = int.from_bytes(hashlib.sha256(kind.encode()).digest()[:4], "big")
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))


def applied(stages: tuple[Stage, ...], signal: Array, time: Array, seed: int) -> Array:
    """A signal through stages, in their order.

    Args:
        stages: What the instrument does to it.
        signal: (M, k).
        time: (M,) [s].
        seed: Of the recording.
    """
    for stage in stages:
        signal = stage.apply(signal, time, stream(stage.kind, seed))
    return signal
