"""Recordings that are wrong: physical faults at every joint and channel."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

import testbed as tb
from testbed.core.base.arrays import AnyArray, Array
from testbed.core.parameters.rules import SIGNALS, Signal
from testbed.core.recordings.columns import WRENCH_COMPONENTS
from testbed.core.recordings.recording import Recording

POUND = 4.4482216152605
"""Of force [N]."""

Change = Callable[[Recording], Recording]
Told = tuple[str, str, Change]
"""Kind, words and change."""


@dataclass(frozen=True)
class Trial:
    """One fault, of a kind, and which method suffers from it."""

    kind: str
    fault: str
    method: Signal
    change: Change
    tree: tb.Tree


def trials(tree: tb.Tree) -> Iterator[Trial]:
    """All faults at every joint and channel where they can be."""
    for kind, fault, change in _of_the_plate():
        yield Trial(kind, fault, "wrench", change, tree)
    for kind, fault, change in _of_the_drives(tree.names):
        yield Trial(kind, fault, "torque", change, tree)
    for method in SIGNALS:
        for kind, fault, change in _of_the_encoders(tree.names):
            yield Trial(kind, fault, method, change, tree)
        for kind, fault, change, other in _of_the_model(tree):
            yield Trial(kind, fault, method, change, other)


def _of_channels(signal: str, names: Sequence[str], words: str, gain: float) -> Iterator[Told]:
    """Of each channel: sense, gain, a stop; of each two: their order."""
    eye = np.eye(len(names))
    called = [words.format(name) for name in names]
    for k, name in enumerate(called):
        unit = np.outer(eye[k], eye[k])
        yield "sign", f"{name} of opposite sign", _linear(signal, eye - 2 * unit)
        yield "gain", f"{name} x {gain:g}", _linear(signal, eye + (gain - 1) * unit)
        if signal != "position":
            yield "channel", f"{name} saturated at half", _saturated(signal, k)
            yield "channel", f"{name} dead", _linear(signal, eye - unit)
    for a, b in combinations(range(len(names)), 2):
        both = called[a].replace(" of", "s of")
        swapped = eye[[{a: b, b: a}.get(k, k) for k in range(len(names))]]
        yield "order", f"{both} and {names[b]} exchanged", _linear(signal, swapped)


def _of_the_plate() -> Iterator[Told]:
    eye = np.eye(6)
    yield "sign", "wrench and tare negated", lambda r: _tared(_linear("wrench", -eye)(r), -1.0)
    yield "tare", "tare 0", lambda r: _tared(r, 0.0)
    yield "unit", "wrench in lbf", _linear("wrench", eye / POUND)
    yield "unit", "wrench in kgf", _linear("wrench", eye / 9.80665)
    yield "unit", "moments in N mm", _linear("wrench", np.diag([1, 1, 1, 1e3, 1e3, 1e3]))
    yield from _of_channels("wrench", WRENCH_COMPONENTS, "{}", 1.05)
    for k, axis in enumerate(WRENCH_COMPONENTS):
        size = 20.0 if k < 3 else 4.0
        yield "drift", f"{axis} drifts by {size:g}", _drift(size * eye[k])
    for late in (5, 20):
        yield "clock", f"wrench {late} ms late", _late("wrench", late)
    for degrees, axes in ((5, "xyz"), (1, "xy")):
        for k, axis in enumerate(axes):
            turned = _turned(np.deg2rad(degrees), k)
            yield "pose", f"plate turned {degrees} deg about {axis}", turned
    for far in (0.02, 0.2):
        for k, axis in enumerate("xyz"):
            moved = _moved(far * np.eye(3)[k])
            yield "pose", f"moment point off by {100 * far:g} cm along {axis}", moved


def _of_the_drives(names: tuple[str, ...]) -> Iterator[Told]:
    eye = np.eye(len(names))
    yield "sign", "torques of opposite sign", _linear("torque", -eye)
    yield "unit", "torques in N mm", _linear("torque", 1e3 * eye)
    yield "unit", "torques in lbf ft", _linear("torque", eye / (POUND * 0.3048))
    yield from _of_channels("torque", names, "torque of {}", 1.1)
    for name, one in zip(names, eye, strict=True):
        yield "unit", f"torque of {name} in N mm", _linear("torque", eye + 999 * np.diag(one))
    for late in (5, 20):
        yield "clock", f"torques {late} ms late", _late("torque", late)


def _of_the_encoders(names: tuple[str, ...]) -> Iterator[Told]:
    eye = np.eye(len(names))
    degrees = 180 / np.pi
    yield "unit", "encoders in degrees", _linear("position", degrees * eye)
    yield from _of_channels("position", names, "encoder of {}", 1.01)
    for k, (name, one) in enumerate(zip(names, eye, strict=True)):
        yield "zero", f"encoder of {name} + 0.02", _shifted(0.02 * one)
        in_degrees = _linear("position", eye + (degrees - 1) * np.diag(one))
        yield "unit", f"encoder of {name} in degrees", in_degrees
        yield "clock", f"encoder of {name} 20 ms late", _late("position", 20, k)
    yield "clock", "1 % of samples lost", _lossy
    yield "clock", "clock 1 % fast", lambda r: replace(r, time=r.time / 1.01)


def _of_the_model(tree: tb.Tree) -> Iterator[tuple[str, str, Change, tb.Tree]]:
    longer = [replace(j, offset=j.offset * (0.45 / 0.4318)) for j in tree.joints[2:]]
    wrong = replace(tree, joints=(*tree.joints[:2], *longer))
    yield "model", "upper arm 0.45 m for 0.4318 m", _of_no_robot, wrong
    for fault, gravity in (("Moon's gravity", (0, 0, -1.62)), ("gravity upwards", (0, 0, 9.81))):
        yield "gravity", fault, _under(gravity), tree


def _linear(signal: str, matrix: AnyArray) -> Change:
    """A signal's channels mixed; the wrench's tare is what it was."""
    return _with(signal, lambda values: values @ np.asarray(matrix).T)


def _tared(recording: Recording, factor: float) -> Recording:
    assert recording.tare is not None
    return replace(recording, tare=factor * recording.tare)


def _drift(size: Array) -> Change:
    return _with("wrench", lambda values: values + np.linspace(0, 1, len(values))[:, None] * size)


def _saturated(signal: str, channel: int) -> Change:
    """Beyond half of what it reaches from its mean, nothing."""

    def change(values: Array) -> Array:
        away = values[:, channel] - values[:, channel].mean()
        far = 0.5 * np.abs(away).max()
        values[:, channel] += np.clip(away, -far, far) - away
        return values

    return _with(signal, change)


def _late(signal: str, milliseconds: int, channel: int | None = None) -> Change:
    """A whole signal, or one channel of it, comes later than the others."""
    which = slice(None) if channel is None else channel

    def change(recording: Recording) -> Recording:
        lag = round(1e-3 * milliseconds * recording.rate)

        def later(values: Array) -> Array:
            values[lag:, which] = values[:-lag, which].copy()
            return values

        # nobody saw what came before
        return _with(signal, later)(recording).part(lag, recording.samples)

    return change


def _with(signal: str, change: Callable[[Array], Array]) -> Change:
    """A signal's samples changed."""
    return lambda r: replace(r, **{signal: change(r.measured(signal).copy())})  # type: ignore[arg-type]


def _turned(angle: float, axis: int) -> Change:
    c, s = np.cos(angle), np.sin(angle)
    turn = np.roll(np.array([[1, 0, 0], [0, c, -s], [0, s, c]]), (axis, axis), (0, 1))
    return _linear("wrench", np.kron(np.eye(2), turn))


def _moved(off: Array) -> Change:
    lever = np.eye(6)
    lever[3:, :3] = np.cross(off, np.eye(3)).T  # moments about a point that is `off` elsewhere
    return _linear("wrench", lever)


def _shifted(by: Array) -> Change:
    return _with("position", lambda values: values + by)


def _lossy(recording: Recording) -> Recording:
    """What is lost leaves no gap in the time stamps."""
    kept = np.flatnonzero(np.random.default_rng(0).random(recording.samples) > 0.01)
    signals = {s: recording.measured(s)[kept] for s in recording.signals if s != "time"}
    return replace(recording, time=recording.time[: len(kept)], **signals)  # type: ignore[arg-type]


def _of_no_robot(recording: Recording) -> Recording:
    """Without the geometry that would give another robot away."""
    return replace(recording, metadata=replace(recording.metadata, geometry={}))


def _under(gravity: tuple[float, float, float]) -> Change:
    return lambda r: replace(r, metadata=replace(r.metadata, gravity=gravity))
