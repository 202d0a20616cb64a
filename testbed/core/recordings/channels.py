"""Faults that single channels show by themselves: clipped, dead, stuck, copied and others.

Nothing is asked of the robot's dynamics. A torque is judged while its joint moves: at rest it may
well be constant.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, diagnose
from testbed.core.recordings.columns import STILL
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.repeats import runs
from testbed.core.recordings.source import Source

SAMPLES, FEWEST = 200_000, 100
"""Samples that are looked at together, at most and at least."""

EQUAL, TOP, CONSTANT = 1e-6, 0.05, 1e-9
"""Part of a channel's range by which equal values differ at most, after interpolation; part of it
that is near its greatest value; part of a value by which a constant changes."""

SPELL, SLOW, MOVING = 0.025, 0.1, 0.2
"""Time over which speeds are taken [s]; part of a joint's rms speed below which it rests; part of
the samples at which it moves, below which nothing is said of it."""

STUCK, JUMP, REGULAR = 20, 5.0, 0.9
"""Times a channel's usual run of equal values that a stuck one lasts; times the usual changes that
a jump is; part of the runs that are as long as a slow device makes them."""

EXACT, NOISY = (0.01, 6.0), (0.06, 4.0)
"""Part of the samples at a stop, at least, and times those below, of which a crest has 2.4; of
values, and of means of noisy ones."""

NEAR, KINK = 3.0, 12.5
"""Sigmas of means within which a noisy plateau lies; times as far below is the torque a quarter of
the plateau later, where flat crests are not."""

COPIED = 0.98
"""Part of the samples at which a copied channel is the other one."""

ROUGH, LEVELS = 0.05, 120
"""Deviation by rounding, in those of the channel, from which steps matter; most values of such."""

AWAY = 0.15
"""Time from rests and reversals after which a jump is no friction, of late torques, too [s]."""

THINNED, SMOOTHED, WHITE = 4, 0.25, 0.6
"""Samples of which one is kept; noise in consecutive samples over that in those that are kept, of a
channel behind a low-pass, at most, and of others, at least."""

FASTEST = 80.0
"""Samples a second below which motion is noise in those that are kept [Hz]."""

NOISIER, LOUD = 6.0, 0.1
"""Times the other channels' noise, as it is and relative to their size; relative noise."""

OUTLYING, SMALL, RARE = 10.0, 0.02, 0.01
"""Times all but a twentieth of a channel's bends that an outlier is, and part of its range; part of
the samples, at most."""

TOUCHES, BOUNCE = 3, 3.0
"""Times that a magnitude is zero; its rise over two spells beside that over one, where a smooth
minimum has four."""

Spans = NDArray[np.int64]
"""Samples from the first to before the second, (k, 2)."""

Flags = NDArray[np.bool_]
Finding = tuple[str, Flags | bool, Mapping[str, Any]]
"""Kind, samples, and facts by the fields of its message."""


@dataclass(frozen=True, eq=False)
class ChannelFault:
    """A fault of one channel.

    Attributes:
        kind: As of the messages, such as "clipped".
        signal: Of the channel, position or torque.
        name: Of the joint.
        share: Part of the samples.
        first: Time of the first of these [s].
        last: Time of the last [s].
        facts: Numbers and names for a person, by the fields of the message.
        left_out: Samples that no estimate should use.
    """

    kind: str
    signal: str
    name: str
    share: float
    first: float
    last: float
    facts: Mapping[str, Any]
    left_out: Spans

    @property
    def diagnostic(self) -> Diagnostic:
        """For a person."""
        return diagnose(
            f"{self.signal}-column.{self.kind}",
            f"the {self.signal} of '{self.name}'",
            self.share,
            first=self.first,
            last=self.last,
            **self.facts,
        )


@dataclass(frozen=True, eq=False)
class _Joint:
    """How a channel's joint moves, (M,) each."""

    rate: float
    speed: Array
    moving: Flags

    @staticmethod
    def of(position: Array, rate: float) -> _Joint:
        """By its encoder."""
        reach = max(1, round(SPELL * rate))
        ends = np.pad(position, reach, "reflect", reflect_type="odd")
        speed = (ends[2 * reach :] - ends[: -2 * reach]) * rate / (2 * reach)
        moves = np.ptp(position) > max(STILL, STUCK * _noise(position))
        usual = np.sqrt(np.mean(speed**2)) if moves else np.inf
        return _Joint(rate, speed, np.abs(speed) > SLOW * usual)

    @property
    def moves(self) -> bool:
        """Whether its torque can be judged."""
        return bool(self.moving.mean() > MOVING)

    def makes(self, values: Array, plateau: Flags, near: float) -> bool:
        """Whether inertia and friction of the joint make a plateau of a torque, within `near`."""
        columns = np.vander(self.speed, 2), np.sign(self.speed), np.gradient(self.speed)
        motion, part = np.column_stack(columns), self.moving
        expected = motion @ np.linalg.lstsq(motion[part], values[part])[0]
        return bool(expected[plateau & part].std() < 2 * near)


def _noise(values: Array) -> float:
    """Standard deviation of white noise in consecutive values."""
    return float(np.median(np.abs(np.diff(values, 4))) / (0.6745 * np.sqrt(70)))


def _runs(values: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """First samples of runs of equal values, and their lengths."""
    return runs(np.round(values[:, None] / (EQUAL * np.ptp(values) or 1.0)))


def _constant(values: Array, joint: _Joint) -> Finding | None:
    """One value throughout."""
    constant = np.ptp(values) <= CONSTANT * np.abs(values[0])
    return ("dead", True, {"size": values[0]}) if constant else None


def _slow(values: Array, joint: _Joint) -> Finding | None:
    """A new value at every so many samples only."""
    starts, lengths = _runs(values)
    moved = lengths[joint.moving[starts]]
    period = int(np.median(moved)) if len(moved) > STUCK else 1
    regular = np.mean(moved == period) > 0.6 and np.mean(moved % period < 2) > REGULAR
    old = ~np.isin(np.arange(len(values)), starts)
    return ("slow", old, {"period": period}) if period > 1 and regular else None


def _stuck(values: Array, joint: _Joint) -> Finding | None:
    """Runs of one value while the joint moves, longer than others or zero between jumps."""
    starts, lengths = _runs(values)
    level, change = values[starts], np.abs(np.diff(values))
    jump = change[(values[1:] != 0) & (values[:-1] != 0) & (change > 0)]
    jump = JUMP * np.quantile(jump, 0.9) if len(jump) else np.inf
    jumps = np.concatenate([[True], change > jump, [True]])
    entered, left = jumps[starts], jumps[starts + lengths]
    long = lengths > STUCK * np.quantile(lengths, 0.95)
    room = np.minimum(values.max() - level, level - values.min())
    # plateaus at a limit, which may begin or end at a jump of friction
    limit = long & (room < TOP * np.ptp(values)) & (level != 0)
    limit &= ~(entered & left) | (limit.sum() > 1)
    lost = long & ~limit | (level == 0) & entered & left
    clear = lost & (np.add.reduceat(joint.moving, starts) > lengths / 2)
    if lengths[clear].sum() < 3:
        return None
    worst = np.argmax(clear * lengths)
    facts = {"size": level[worst]}
    return "stuck" if level[worst] else "dead", np.repeat(lost, lengths), facts


def _clipped(values: Array, joint: _Joint) -> Finding | None:
    """Plateaus at the greatest or the least value, or both, that the joint does not make."""
    every, levels = np.zeros(len(values), bool), []
    means = max(3, round(0.05 * joint.rate))
    for sign in (1.0, -1.0):
        plateau = _plateau(sign * values, joint, 1) or _plateau(
            sign * values, joint, means
        )
        if plateau is not None and not joint.makes(values, plateau[0], plateau[2]):
            every |= plateau[0]
            levels.append(sign * plateau[1])
    words = " and ".join(f"{each:.4g}" for each in sorted(levels))
    return ("clipped", every, {"size": words}) if levels else None


def _plateau(
    values: Array, joint: _Joint, count: int
) -> tuple[Flags, float, float] | None:
    """Samples of a stop at the top, its value and resolution; of a crest, None.

    Of means over so many samples the noise is small that came after the stop. Splines swing beyond
    a stop, a little.
    """
    means = np.convolve(values, np.ones(count) / count, "same")
    seen, (share, times) = np.sort(means[joint.moving]), EXACT
    span = float(seen[-1] - seen[0])
    near = max(EQUAL * span, np.diff(np.unique(values)).min())
    if count > 1:
        noise = _noise(values) / np.sqrt(count)
        (share, times), near = NOISY, max(near, 2e-3 * span, NEAR * noise)
    level = _stop(seen, near, share, times)
    if level is None or near > 0.04 * span:
        return None
    at = means > level - 1.5 * near
    return (at, level, near) if _is_steep(means, at, level, near, count) else None


def _stop(seen: Array, near: float, share: float, times: float) -> float | None:
    """The value near the greatest at which most sorted values are, if those below are few."""
    levels = seen[seen >= seen[-1] - 0.2 * (seen[-1] - seen[0])]
    within = [np.searchsorted(seen, levels + k * near) for k in (-3, -1, 1)]
    below, here = np.diff(within, axis=0)
    here[here < times * (len(seen) - within[2])] = 0
    k = int(np.argmax(here))
    enough = max(7, share * len(seen), times * below[k])
    return float(levels[k]) if here[k] > enough else None


def _is_steep(
    values: Array, plateau: Flags, level: float, near: float, count: int
) -> bool:
    """Whether values fall from a plateau at once, as from no flat crest."""
    begins, ends = _spans(plateau).T
    away = np.maximum(count, (ends - begins) // 4)
    beside = values.take([begins - away, ends + away], mode="clip").mean(axis=0)
    return bool(np.average(level - beside, weights=ends - begins) > KINK * near)


def _coarse(values: Array, joint: _Joint) -> Finding | None:
    """Steps that are large beside the channel's motion."""
    gaps = np.diff(np.unique(values))
    step = float(gaps.min())
    whole = np.abs(gaps / step - np.round(gaps / step)) < 0.01
    noise = step / 12**0.5
    coarse = len(gaps) < LEVELS and whole.all() and noise > ROUGH * values.std()
    return ("coarse", True, {"size": step, "noise": noise}) if coarse else None


def _magnitude(values: Array, joint: _Joint) -> Finding | None:
    """Values of one sign that bounce at zero."""
    from scipy.ndimage import minimum_filter1d  # scipy.signal takes half a second

    size, reach = np.abs(values), max(2, round(0.03 * joint.rate))
    inner = size[1:-1]
    least_near = minimum_filter1d(size, 4 * reach + 1)[1:-1]
    strict = (inner == least_near) & (inner < size[:-2]) & (inner < size[2:])
    at = 1 + np.flatnonzero(strict)
    at = at[joint.moving[at] & (size[at] < np.median(np.abs(np.diff(values))))]
    least, near, far = (
        np.sum(size.take([at - k, at + k], mode="clip")) for k in (0, reach, 2 * reach)
    )
    bounces = len(at) >= TOUCHES and far - least < BOUNCE * (near - least)
    signed = values.min() < 0 < values.max()
    return ("magnitude", True, {"count": len(at)}) if bounces and not signed else None


def _outliers(values: Array, joint: _Joint) -> Finding | None:
    """Single samples that their neighbours do not know."""
    bend = np.abs(values[1:-1] - (values[2:] + values[:-2]) / 2)
    usual = OUTLYING * np.quantile(bend, 0.95)
    alone = bend > max(8 * _noise(values), usual, SMALL * np.ptp(values))
    alone &= np.abs(values[2:] - values[:-2]) < bend / 2
    at = np.pad(alone, 1)
    few = np.any(at & joint.moving) and at.sum() <= RARE * len(values)
    return ("outliers", at, {"count": int(at.sum())}) if few else None


def steps(
    time: Array, values: Array, times: float = OUTLYING
) -> Iterator[tuple[int, float]]:
    """Samples before steps, and sizes, across which a channel's rate of change is continuous.

    Args:
        time: (M,), increasing [s].
        values: (M,).
        times: All but the fastest of the other changes that a step is at least.
    """
    speed = np.diff(values) / np.diff(time)
    if len(speed) < 5:
        return
    before, after = speed[:-2], speed[2:]
    change = speed[1:-1] - (before + after) / 2
    usual = times * float(np.quantile(np.abs(change), 0.99))
    alone = np.abs(before - after) < np.abs(change) / 4
    for i in 1 + np.flatnonzero((np.abs(change) > usual) & alone):
        yield int(i), float(change[i - 1] * (time[i + 1] - time[i]))


def _offset_step(values: Array, joint: _Joint) -> Finding | None:
    """Jumps of a torque, at most three, away from reversals."""
    reach, samples = round(AWAY * joint.rate), np.arange(len(values))
    turns = np.diff(np.sign(joint.speed)) != 0
    turning = np.convolve(turns, np.ones(2 * reach + 1), "same") > 0.5
    every = steps(samples / joint.rate, values, JUMP)
    sizes = {i + 1: size for i, size in every if not turning[i]}
    if not 0 < len(sizes) <= 3:
        return None
    size = max(sizes.values(), key=abs)
    return "offset-step", np.isin(samples, list(sizes)), {"size": size}


TESTS = (
    _constant,
    _slow,
    _stuck,
    _clipped,
    _magnitude,
    _coarse,
    _outliers,
    _offset_step,
)
"""Of a torque; the first that finds something decides."""


def _copies(
    names: Sequence[str], values: Array, moving: Sequence[int]
) -> Iterator[tuple[int, Finding]]:
    """Channels that are others' copies, or their negatives, by their numbers."""
    sizes = np.abs(values)
    for i, j in combinations(moving, 2):
        same = np.abs(sizes[:, i] - sizes[:, j]) <= EQUAL * np.ptp(values[:, i])
        if np.ptp(values[:, i]) > 0 and same.mean() > COPIED:
            yield i, ("copied", same, {"other": names[j]})
            yield j, ("copied", same, {"other": names[i]})


def _torque_findings(
    names: Sequence[str], torque: Array, joints: Sequence[_Joint]
) -> Iterator[tuple[int, Finding]]:
    """Findings of torques, by the numbers of their joints."""
    moving = [k for k, each in enumerate(joints) if each.moves]
    findings = dict(_copies(names, torque, moving))
    for k in moving:
        tested = (test(torque[:, k], joints[k]) for test in TESTS if k not in findings)
        first = next(filter(None, tested), None)
        findings |= {} if first is None else {k: first}
    yield from findings.items()
    clean = [k for k in moving if k not in findings]
    yield from _odd_noise(torque, clean, joints[0].rate)


def _odd_noise(
    torque: Array, clean: Sequence[int], rate: float
) -> Iterator[tuple[int, Finding]]:
    """Channels that are smoother, or noisier, than all others."""
    values = torque[:, clean].T
    noise = np.array([_noise(each) for each in values])
    thinned = np.array([_noise(each[::THINNED]) for each in values])
    whiteness = noise / np.maximum(thinned, np.finfo(float).tiny)
    size = np.sqrt((values**2).mean(axis=1))
    for c, k in enumerate(clean) if len(clean) > 2 else ():
        others = np.arange(len(clean)) != c
        relative = size[c] * np.max((noise / size)[others])
        beside = max(np.median(noise[others]), relative)
        smooth = 0 < whiteness[c] < SMOOTHED and rate > FASTEST
        if smooth and np.median(whiteness[others]) > WHITE:
            yield k, ("smoothed", True, {"size": whiteness[c]})
        elif noise[c] > max(NOISIER * beside, LOUD * size[c]):
            yield k, ("noisy", True, {"size": noise[c]})


def _position_findings(
    names: Sequence[str], position: Array, joints: Sequence[_Joint]
) -> Iterator[tuple[int, Finding]]:
    """Encoders that stand still and jump, are updated rarely, or are others' copies."""
    moving = [k for k, each in enumerate(joints) if each.moves]
    yield from _copies(names, position, moving)
    slow = {k: _slow(position[:, k], joints[k]) for k in moving}
    for k in moving:
        finding = slow[k]
        # of all encoders, it is a slow device: poses are interpolated
        if finding is not None and not all(slow.values()):
            yield k, finding
        starts, lengths = _runs(position[:, k])
        change = np.abs(np.diff(position[:, k], append=position[-1, k]))
        jumps = change[starts + lengths - 1] > JUMP * np.quantile(change, 0.999)
        long = lengths > STUCK * np.median(lengths)
        lost = np.repeat(jumps & long, lengths)
        if lost.any():
            yield k, ("stuck", lost, {})


KEPT = {"coarse", "offset-step", "smoothed", "noisy"}
"""Faults of torques that concern all samples alike, or whose right part nobody knows."""


def channel_faults(source: Source, *, torques: bool = True) -> tuple[ChannelFault, ...]:
    """Faults of a recording's positions and torques, of a long one part by part.

    Args:
        source: The recording.
        torques: Whether torques are looked at, too.
    """
    return tuple(
        fault
        for begin, end in source.segments
        for first in range(begin, end, SAMPLES)
        for fault in _faults(
            source.part(first, min(end, first + SAMPLES)), first, torques=torques
        )
    )


def _faults(
    recording: Recording, first: int, *, torques: bool
) -> Iterator[ChannelFault]:
    """Those of a part of a recording, by the number of its first sample."""
    if recording.samples < FEWEST:
        return
    names, torque = recording.names, recording.torque if torques else None
    joints = [_Joint.of(each, recording.rate) for each in recording.position.T]
    encoders = _position_findings(names, recording.position, joints)
    findings = [("position", *each) for each in encoders]
    if torque is not None:
        drives = _torque_findings(names, torque, joints)
        findings += [("torque", *each) for each in drives]
    for signal, k, (kind, where, facts) in findings:
        at = np.broadcast_to(where, recording.samples)
        kept = kind in KEPT if signal == "torque" else kind != "stuck"
        times = recording.time[at]
        yield ChannelFault(
            kind=kind,
            signal=signal,
            name=names[k],
            share=float(at.mean()),
            first=float(times[0]),
            last=float(times[-1]),
            facts=facts,
            left_out=first + _spans(at & (not kept)),
        )


def _spans(at: Flags) -> Spans:
    """Runs of flags."""
    edges = np.diff(np.pad(at, 1).astype(np.int64))
    return np.flatnonzero(edges).reshape(-1, 2)


def left_out(
    faults: Iterable[ChannelFault],
    channels: Sequence[str],
    whole: Sequence[str],
    reach: int,
) -> tuple[Spans, ...]:
    """Samples of channels that estimates leave out, (k, 2) each; () where there are none.

    Args:
        faults: Of the recording.
        channels: As "torque/elbow".
        whole: Those that are left out altogether, by patterns of a shell.
        reach: Samples to either side that a wrong position spoils, of all channels.
    """
    around, every = np.array([-reach, reach]), np.array([[0, np.iinfo(np.int64).max]])
    each = []
    for channel in channels:
        spans = [np.zeros((0, 2), np.int64)]
        spans += [every] * any(fnmatchcase(channel, pattern) for pattern in whole)
        for fault in faults:
            if fault.signal == "position":
                spans.append(fault.left_out + around)
            elif f"{fault.signal}/{fault.name}" == channel:
                spans.append(fault.left_out)
        each.append(np.concatenate(spans))
    return tuple(each) if any(map(len, each)) else ()
