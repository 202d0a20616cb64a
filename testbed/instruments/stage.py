"""A stage of an instrument: what happens to a signal on its way from the truth to the recording.

An imperfection is one frozen dataclass with `kind` and `apply`, in the module of the device
that has it. Stages of a signal are applied in order.

Random numbers come from a stream of the stage's kind and the seed, so that adding, removing
or changing a stage leaves the noise of all others as it was, to the bit. Several stages of
one kind in a chain have a stream each, numbered in their order: one more goes last.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterable, Iterator
from typing import ClassVar, Protocol, TypeVar

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


AnyStage = TypeVar("AnyStage", bound=Stage)


def stream(kind: str, seed: int, number: int = 0, use: str = "") -> np.random.Generator:
    """Random numbers of a stage.

    Args:
        kind: Of the stage.
        seed: Of the recording.
        number: Of the stage among those of its kind in its chain.
        use: What the numbers are for; by default the noise of a recording.
    """
    key = [_FIRST_STREAMS.get(kind, _code(kind))]
    if number or use:
        key += [number, _code(use)]
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=tuple(key)))


def _code(word: str) -> int:
    return int.from_bytes(hashlib.sha256(word.encode()).digest()[:4], "big")


def numbered(stages: Iterable[AnyStage]) -> Iterator[tuple[AnyStage, int]]:
    """Stages, each with its number among those of its kind."""
    seen: Counter[str] = Counter()
    for stage in stages:
        yield stage, seen[stage.kind]
        seen[stage.kind] += 1


def applied(stages: Iterable[Stage], signal: Array, time: Array, seed: int, use: str = "") -> Array:
    """A signal through stages, in their order.

    Args:
        stages: What the instrument does to it.
        signal: (M, k).
        time: (M,) [s].
        seed: Of the recording.
        use: What is measured, where it is not a recording's signal: it has noise of its own.
    """
    for stage, number in numbered(stages):
        signal = stage.apply(signal, time, stream(stage.kind, seed, number, use))
    return signal
