"""Chains of sensor errors, each with random numbers of its own."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterable, Iterator

import numpy as np

from testbed.core.base.arrays import Array
from testbed.sensors.sensor_error import SensorError

_FIRST_STREAMS = {"encoder_noise": 0, "torque_noise": 1, "plate_noise": 2}
"""Streams of the kinds that were there before kinds had names; their noise stays the same."""


def stream(kind: str, seed: int, number: int = 0, use: str = "") -> np.random.Generator:
    """Random numbers of an error.

    Args:
        kind: Of the error.
        seed: Of the recording.
        number: Of the error among those of its kind in its chain.
        use: What the numbers are for; by default the noise of a recording.
    """

    def code(word: str) -> int:
        return int.from_bytes(hashlib.sha256(word.encode()).digest()[:4], "big")

    key = [_FIRST_STREAMS.get(kind, code(kind))]
    if number or use:
        key += [number, code(use)]
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=tuple(key)))


def number_kinds(chain: Iterable[SensorError]) -> Iterator[tuple[SensorError, int]]:
    """Errors, each with its number among those of its kind."""
    seen: Counter[str] = Counter()
    for error in chain:
        yield error, seen[error.kind]
        seen[error.kind] += 1


def apply_chain(
    chain: Iterable[SensorError], signal: Array, time: Array, seed: int, use: str = ""
) -> Array:
    """Signal after a chain of errors, in their order.

    Args:
        chain: The errors.
        signal: (M, k).
        time: (M,) [s].
        seed: Of the recording.
        use: What is measured, where it is not a recording's signal: it has noise of its own.
    """
    for error, number in number_kinds(chain):
        signal = error.apply(signal, time, stream(error.kind, seed, number, use))
    return signal
