"""Faults of single channels of a recording: clipped, dead, stuck, copied and others.

Single torque channels are tested by `channel_tests`; this module compares channels with each other.
No model of the robot's dynamics is needed.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from itertools import combinations
from typing import Any

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, make_diagnostic
from testbed.core.recordings.channel_tests import (
    EQUALITY_TOLERANCE,
    JUMP_FACTOR,
    STUCK_FACTOR,
    TORQUE_TESTS,
    Finding,
    JointMotion,
    Spans,
    equal_runs,
    find_slow_updates,
    sample_ranges,
    white_noise_sigma,
)
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.source import Source

MAX_BLOCK_SAMPLES, MIN_SAMPLES = 200_000, 100
"""Largest and smallest number of samples that are tested together."""

MIN_COPIED_SHARE = 0.98
"""Smallest share of samples at which a copied channel equals the original channel."""

THINNING, MAX_SMOOTHED_RATIO, MIN_WHITE_RATIO = 4, 0.25, 0.6
"""Step between thinned samples; and bounds on the ratio of noise in consecutive samples to noise in
thinned samples: upper bound for a low-pass filtered channel, lower bound for the median of the
other channels."""

MIN_SMOOTHED_RATE = 80.0
"""Smallest sampling rate at which this noise ratio is used [Hz]; at lower rates, motion appears as
noise of thinned samples."""

NOISE_FACTOR, MIN_RELATIVE_NOISE = 6.0, 0.1
"""Smallest noise of a noisy channel: as a multiple of the other channels' noise (both absolute and
relative to channel size), and relative to the size of the channel."""


@dataclass(frozen=True, eq=False)
class ChannelFault:
    """Fault of a channel of a recording.

    Attributes:
        kind: Kind as in the messages, such as "clipped".
        signal: Signal of the channel, position or torque.
        name: Joint name.
        share: Share of faulty samples.
        first: Time of the first faulty sample [s].
        last: Time of the last faulty sample [s].
        facts: Numbers and names for the message, keyed by field.
        left_out: Ranges of samples that estimates must not use, (k, 2): index of the first sample,
            and index after the last one.
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
        """Diagnostic of the fault."""
        return make_diagnostic(
            f"{self.signal}-column.{self.kind}",
            f"the {self.signal} of '{self.name}'",
            self.share,
            first=self.first,
            last=self.last,
            **self.facts,
        )


def _find_copies(
    names: Sequence[str], values: Array, moving: Sequence[int]
) -> Iterator[tuple[int, Finding]]:
    """Yield channels that copy another channel or its negative, with their indices.

    Both channels of a pair are yielded. Their magnitudes are equal, within `EQUALITY_TOLERANCE`
    times the range, at more than `MIN_COPIED_SHARE` of the samples.

    Args:
        names: Joint names.
        values: Values of a signal, (M, n).
        moving: Indices of the moving joints.
    """
    sizes = np.abs(values)
    for i, j in combinations(moving, 2):
        same = np.abs(sizes[:, i] - sizes[:, j]) <= EQUALITY_TOLERANCE * np.ptp(
            values[:, i]
        )
        if np.ptp(values[:, i]) > 0 and same.mean() > MIN_COPIED_SHARE:
            yield i, ("copied", same, {"other": names[j]})
            yield j, ("copied", same, {"other": names[i]})


def _torque_findings(
    names: Sequence[str], torque: Array, joints: Sequence[JointMotion]
) -> Iterator[tuple[int, Finding]]:
    """Yield faults found in the torques of moving joints, with joint indices.

    A copied channel is not tested further. For other channels, the first fault found by
    `TORQUE_TESTS` is reported. Channels without a fault are compared by `_find_unusual_noise`.

    Args:
        names: Joint names.
        torque: Torques, (M, n).
        joints: Motion of each joint.
    """
    moving = [k for k, each in enumerate(joints) if each.is_moving]
    findings = dict(_find_copies(names, torque, moving))
    for k in moving:
        tested = (
            test(torque[:, k], joints[k]) for test in TORQUE_TESTS if k not in findings
        )
        finding = next(filter(None, tested), None)
        findings |= {} if finding is None else {k: finding}
    yield from findings.items()
    faultless = [k for k in moving if k not in findings]
    yield from _find_unusual_noise(torque, faultless, joints[0].rate)


def _find_unusual_noise(
    torque: Array, faultless: Sequence[int], rate: float
) -> Iterator[tuple[int, Finding]]:
    """Yield torque channels that are smoother or noisier than all others, with indices.

    A channel is smoothed if the noise of consecutive samples is below `MAX_SMOOTHED_RATIO` times
    the noise of thinned samples, while the median ratio of the other channels is above
    `MIN_WHITE_RATIO`. A channel is noisy if its noise is above `NOISE_FACTOR` times that of the
    others (both absolute and relative to size) and above `MIN_RELATIVE_NOISE` times its own size.
    At least three channels are needed.

    Args:
        torque: Torques, (M, n).
        faultless: Indices of the channels without other faults.
        rate: Sampling rate [Hz]; smoothed channels are sought only above `MIN_SMOOTHED_RATE`.
    """
    values = torque[:, faultless].T
    noise = np.array([white_noise_sigma(channel) for channel in values])
    thinned = np.array([white_noise_sigma(channel[::THINNING]) for channel in values])
    whiteness = noise / np.maximum(thinned, np.finfo(float).tiny)
    size = np.sqrt((values**2).mean(axis=1))
    for c, k in enumerate(faultless) if len(faultless) > 2 else ():
        others = np.arange(len(faultless)) != c
        relative = size[c] * np.max((noise / size)[others])
        reference = max(np.median(noise[others]), relative)
        is_smooth = 0 < whiteness[c] < MAX_SMOOTHED_RATIO and rate > MIN_SMOOTHED_RATE
        if is_smooth and np.median(whiteness[others]) > MIN_WHITE_RATIO:
            yield k, ("smoothed", True, {"size": whiteness[c]})
        elif noise[c] > max(NOISE_FACTOR * reference, MIN_RELATIVE_NOISE * size[c]):
            yield k, ("noisy", True, {"size": noise[c]})


def _position_findings(
    names: Sequence[str], position: Array, joints: Sequence[JointMotion]
) -> Iterator[tuple[int, Finding]]:
    """Yield faults of the encoders of moving joints (copied, slow or stuck), with joint indices.

    Slow encoders are not reported if all encoders are slow. An encoder is stuck if a run of equal
    values is longer than `STUCK_FACTOR` times the median length and ends in a jump larger than
    `JUMP_FACTOR` times the 99.9th percentile of changes.

    Args:
        names: Joint names.
        position: Encoder positions, (M, n) [rad or m].
        joints: Motion of each joint.
    """
    moving = [k for k, each in enumerate(joints) if each.is_moving]
    yield from _find_copies(names, position, moving)
    slow_findings = {k: find_slow_updates(position[:, k], joints[k]) for k in moving}
    for k in moving:
        finding = slow_findings[k]
        # if all encoders are slow, it is a slow device whose poses are interpolated elsewhere
        if finding is not None and not all(slow_findings.values()):
            yield k, finding
        starts, lengths = equal_runs(position[:, k])
        change = np.abs(np.diff(position[:, k], append=position[-1, k]))
        jumps = change[starts + lengths - 1] > JUMP_FACTOR * np.quantile(change, 0.999)
        is_long = lengths > STUCK_FACTOR * np.median(lengths)
        is_lost = np.repeat(jumps & is_long, lengths)
        if is_lost.any():
            yield k, ("stuck", is_lost, {})


USABLE_KINDS = {"coarse", "offset-step", "smoothed", "noisy"}
"""Torque faults whose samples are still used: all are affected, or the valid ones are unknown."""


def channel_faults(source: Source, *, torques: bool = True) -> tuple[ChannelFault, ...]:
    """Faults of a recording's positions and torques, block by block.

    Each segment between gaps is tested in blocks of up to `MAX_BLOCK_SAMPLES` samples. Blocks of
    fewer than `MIN_SAMPLES` samples are not tested.

    Args:
        source: The recording.
        torques: True to test torques as well as positions.
    """
    return tuple(
        fault
        for begin, end in source.segments
        for first in range(begin, end, MAX_BLOCK_SAMPLES)
        for fault in _block_faults(
            source.part(first, min(end, first + MAX_BLOCK_SAMPLES)),
            first,
            torques=torques,
        )
    )


def _block_faults(
    recording: Recording, first: int, *, torques: bool
) -> Iterator[ChannelFault]:
    """Yield the faults of a block of a recording, positions first.

    Estimates still use the samples of torque faults of `USABLE_KINDS`, and of position faults other
    than stuck encoders.

    Args:
        recording: Block of the recording; not tested if shorter than `MIN_SAMPLES` samples.
        first: Index of the block's first sample.
        torques: True to test torques as well as positions.
    """
    if recording.samples < MIN_SAMPLES:
        return
    names, torque = recording.names, recording.torque if torques else None
    joints = [
        JointMotion.from_position(each, recording.rate) for each in recording.position.T
    ]
    encoders = _position_findings(names, recording.position, joints)
    findings = [("position", *each) for each in encoders]
    if torque is not None:
        drives = _torque_findings(names, torque, joints)
        findings += [("torque", *each) for each in drives]
    for signal, k, (kind, finding_samples, facts) in findings:
        samples = np.broadcast_to(finding_samples, recording.samples)
        is_usable = kind in USABLE_KINDS if signal == "torque" else kind != "stuck"
        times = recording.time[samples]
        yield ChannelFault(
            kind=kind,
            signal=signal,
            name=names[k],
            share=float(samples.mean()),
            first=float(times[0]),
            last=float(times[-1]),
            facts=facts,
            left_out=first + sample_ranges(samples & (not is_usable)),
        )


def excluded_samples(
    faults: Iterable[ChannelFault],
    channels: Sequence[str],
    excluded_channels: Sequence[str],
    reach: int,
) -> tuple[Spans, ...]:
    """Ranges of samples of each channel that estimates leave out, (k, 2) each.

    A range consists of the index of the first sample and the index after the last one. The result
    is empty if no samples are left out.

    Args:
        faults: Faults of the recording.
        channels: Names of channels, such as "torque/elbow".
        excluded_channels: Shell patterns of channels that are left out completely.
        reach: Number of samples before and after a wrong position that are left out of all
            channels, such as the filter half-length.
    """
    margins, all_samples = (
        np.array([-reach, reach]),
        np.array([[0, np.iinfo(np.int64).max]]),
    )
    ranges = []
    for channel in channels:
        spans = [np.zeros((0, 2), np.int64)]
        spans += [all_samples] * any(
            fnmatchcase(channel, pattern) for pattern in excluded_channels
        )
        for fault in faults:
            if fault.signal == "position":
                spans.append(fault.left_out + margins)
            elif f"{fault.signal}/{fault.name}" == channel:
                spans.append(fault.left_out)
        ranges.append(np.concatenate(spans))
    return tuple(ranges) if any(map(len, ranges)) else ()
