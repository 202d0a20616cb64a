"""Chains of sensor errors, each with an independent random stream."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterable, Iterator

import numpy as np

from testbed.core.base.arrays import Array
from testbed.sensors.sensor_error import SensorError

_FIXED_STREAMS = {"encoder_noise": 0, "torque_noise": 1, "plate_noise": 2}
"""Fixed stream numbers of kinds whose noise must stay the same as in earlier versions."""


def random_stream(
    kind: str, seed: int, number: int = 0, use: str = ""
) -> np.random.Generator:
    """Random generator of a sensor error.

    Generators for different arguments are independent.

    Args:
        kind: Kind of the error.
        seed: Seed of the recording.
        number: Index of the error among the errors of the same kind in its chain.
        use: Purpose of the random numbers; "" for the noise of a recording.
    """

    def code(word: str) -> int:
        return int.from_bytes(hashlib.sha256(word.encode()).digest()[:4], "big")

    key = [_FIXED_STREAMS.get(kind, code(kind))]
    if number or use:
        key += [number, code(use)]
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=tuple(key)))


def numbered_errors(chain: Iterable[SensorError]) -> Iterator[tuple[SensorError, int]]:
    """Yield each sensor error with its index among the errors of its kind, from 0."""
    counts: Counter[str] = Counter()
    for error in chain:
        yield error, counts[error.kind]
        counts[error.kind] += 1


def apply_chain(
    chain: Iterable[SensorError], signal: Array, time: Array, seed: int, use: str = ""
) -> Array:
    """Apply a chain of sensor errors to a signal, in the order of the chain.

    Args:
        chain: The sensor errors.
        signal: Signal without errors, (M, k).
        time: Times of the samples, (M,) [s].
        seed: Seed of the recording.
        use: Purpose of a measurement that is not part of the recording; it selects other noise.
    """
    for error, number in numbered_errors(chain):
        signal = error.apply(signal, time, random_stream(error.kind, seed, number, use))
    return signal
