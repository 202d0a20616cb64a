"""Faults planted in single channels: how many are named, by kind and joint, and what else is."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from typing import Annotated, Any

import numpy as np
import typer
from scipy.signal import butter, lfilter

import testbed as tb
from benchmarks.inverse_recordings import RATE, ROBOTS, truth
from testbed.core.base.arrays import Array
from testbed.core.recordings.channels import ChannelFault, channel_faults
from testbed.core.recordings.metadata import Metadata

Spoil = Callable[[Array, np.random.Generator], Array]

THINNED = 5
"""Samples of a simulation of which one is kept: 100 Hz."""


def limited(share: float, noise: float = 0.0, *, both: bool = True) -> Spoil:
    """Torques at a limit for a part of the time, with noise that comes after it."""

    def spoil(x: Array, rng: np.random.Generator) -> Array:
        top = np.quantile(np.abs(x) if both else x, 1 - share)
        clipped = np.clip(x, -top if both else -np.inf, top)
        return np.asarray(clipped + noise * x.std() * rng.normal(size=len(x)))

    return spoil


def spells(length: int, every: int, *, zero: bool) -> Spoil:
    """Spells in which a channel shows zero, or the last value."""

    def spoil(x: Array, rng: np.random.Generator) -> Array:
        first = int(rng.integers(every // 4, every // 2))
        found = x.copy()
        for begin in range(first, len(x) - length - 10, every):
            found[begin : begin + length] = 0.0 if zero else x[begin]
        return found

    return spoil


def held(period: int) -> Spoil:
    """A device that is slower than the log."""
    return lambda x, rng: x[np.arange(len(x)) // period * period]


def rounded(part: float) -> Spoil:
    """Steps of so many standard deviations."""
    return lambda x, rng: np.round(x / (part * x.std())) * part * x.std()


def low_passed(order: int, cutoff: float) -> Spoil:
    """A causal filter; the cutoff in sampling rates."""
    b, a = butter(order, 2 * cutoff)
    return lambda x, rng: x[0] + lfilter(b, a, x - x[0])


def struck(x: Array, rng: np.random.Generator) -> Array:
    """Six samples far from their neighbours."""
    found, at = x.copy(), rng.choice(np.arange(20, len(x) - 20), 6, replace=False)
    found[at] += np.ptp(x) * rng.choice([-1, 1], 6)
    return found


def shifted(x: Array, rng: np.random.Generator) -> Array:
    """Another zero from some instant on."""
    return x + np.ptp(x) * (np.arange(len(x)) > rng.uniform(0.3, 0.7) * len(x))


PLANTED: Mapping[str, tuple[str, Spoil]] = {
    "limit, both sides, 30 %": ("torque clipped", limited(0.3)),
    "limit, one side, 10 %": ("torque clipped", limited(0.1, both=False)),
    "limit, one side, 4 %": ("torque clipped", limited(0.04, both=False)),
    "limit, then noise": ("torque clipped", limited(0.25, 0.01)),
    "zero throughout": ("torque dead", lambda x, rng: 0 * x),
    "zero, second half": ("torque dead", lambda x, rng: x * (np.arange(len(x)) < len(x) / 2)),
    "zero mostly": ("torque dead", spells(240, 300, zero=True)),
    "zero, 3 % of samples": ("torque dead", lambda x, rng: x * (rng.uniform(size=len(x)) > 0.03)),
    "last value for 1.5 s": ("torque stuck", spells(150, 900, zero=False)),
    "last value, often": ("torque stuck", spells(60, 400, zero=False)),
    "every fourth new": ("torque slow", held(4)),
    "every tenth new": ("torque slow", held(10)),
    "steps of half a sigma": ("torque coarse", rounded(0.5)),
    "steps of a fifth": ("torque coarse", rounded(0.2)),
    "low-pass, first order": ("torque smoothed", low_passed(1, 0.03)),
    "low-pass, second order": ("torque smoothed", low_passed(2, 0.04)),
    "noise": (
        "torque noisy",
        lambda x, rng: x + 0.5 * np.sqrt(np.mean(x**2)) * rng.normal(size=len(x)),
    ),
    "outliers": ("torque outliers", struck),
    "another zero": ("torque offset-step", shifted),
    "magnitude": ("torque magnitude", lambda x, rng: np.abs(x - np.median(x))),
    "encoder, every fifth new": ("position slow", held(5)),
}
"""What is done to a column, and what is to be named."""


@cache
def sound(name: str, seed: int) -> tb.Recording:
    """An imported recording of a robot at 100 Hz, nothing wrong with it."""
    made = truth(name, seed)
    thin = slice(None, None, THINNED)
    time = np.arange(len(made.position))[thin] / RATE
    columns = made.position[thin], made.torque[thin]
    return tb.Recording(made.tree.names, time, *columns, metadata=Metadata(mapping={}))


def planted(recording: tb.Recording, plant: str, seed: int) -> tuple[tb.Recording, str]:
    """A recording with a fault in a channel of a joint, and the fault as `named` has it."""
    rng, (fault, spoil) = np.random.default_rng(seed), PLANTED[plant]
    torque, signal = recording.measured("torque"), fault.partition(" ")[0]
    joint = int(rng.choice(np.flatnonzero(torque.std(axis=0) > 1e-3)))
    values = recording.measured(signal).copy()
    values[:, joint] = spoil(values[:, joint], rng)
    spoiled: dict[str, Any] = {signal: values}
    return replace(recording, **spoiled), f"{fault} {recording.names[joint]}"


def named(fault: ChannelFault) -> str:
    """Signal, kind and joint."""
    return f"{fault.signal} {fault.kind} {fault.name}"


def main(
    seeds: Annotated[int, typer.Option(help="Recordings of each robot.")] = 3,
) -> None:
    """Plant each fault in recordings of every robot."""
    missed: Counter[str] = Counter()
    other, false = 0, 0
    for name in ROBOTS:
        for seed in range(seeds):
            recording = sound(name, seed)
            false += len(channel_faults(recording)) > 0
            for k, plant in enumerate(PLANTED):
                spoiled, fault = planted(recording, plant, 100 * seed + k)
                found = {named(each) for each in channel_faults(spoiled)}
                missed[plant] += fault not in found
                other += len(found - {fault}) > 0
    count = len(ROBOTS) * seeds
    for plant in PLANTED:
        print(f"{plant:28s} named {count - missed[plant]:4d} of {count}")
    print(f"in all {1 - missed.total() / (count * len(PLANTED)):.1%} named")
    print(f"something else beside {other} of them; of {count} sound recordings, {false}")
