"""What channels say by themselves: samples far outside, and what does not move."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from testbed.errors import few
from testbed.identification.finding import Finding, components
from testbed.recordings.columns import AXES
from testbed.recordings.recording import Recording
from testbed.robot.tree import Tree
from testbed.sanity.explanation import BRAKED, Explanation
from testbed.sanity.instants import Instants
from testbed.sanity.mistakes import own_joints

STILL, ROUNDING = 1e-3, 1e-9
"""Motion of joints below which they rest [rad or m]; part of a value that a filter's rounding
changes at most."""

RARE, FEWEST, APART = 1e-3, 5, 3
"""Part of the samples, and number, that may be spikes; samples after which one is over."""

FAR, LITTLE = 2.0, 1e-2
"""Ranges of all other samples by which a spike lies outside; part of the largest range of its
signal's channels that each has at least."""


def spike_findings(part: Recording) -> Iterator[Finding]:
    """Channels with a few samples far outside of all others.

    Args:
        part: Of a recording.
    """
    for signal in (name for name in ("position", "torque", "wrench") if name in part.signals):
        values = part.measured(signal)
        edge = min(max(FEWEST, int(RARE * len(values))), len(values) // 4)
        ordered = np.partition(values, (edge, len(values) - 1 - edge), axis=0)
        low, high = ordered[edge], ordered[-1 - edge]
        room = FAR * np.maximum(high - low, LITTLE * (high - low).max())
        outside = (values < low - room) | (values > high + room)
        lasting = outside[APART:] & outside[:-APART]
        for channel in np.flatnonzero(outside.any(axis=0) & ~lasting.any(axis=0)):
            at = np.flatnonzero(outside[:, channel])
            name = AXES[channel] if signal == "wrench" else f"'{part.names[channel]}'"
            said = ", ".join(f"{values[k, channel]:.4g} at {part.time[k]:.6g} s" for k in at[:3])
            yield Finding(
                f"the {signal} of {name}" if signal != "wrench" else f"the plate's {name}",
                f"is {said}{f' and {len(at) - 3} more' if len(at) > 3 else ''}, and between "
                f"{low[channel]:.4g} and {high[channel]:.4g} else",
                float(len(at)),
                ("spikes",),
                "cut them out by `start` and `stop` in the mapping, or repair the file",
            )


def still_findings(tree: Tree, taken: Instants) -> tuple[tuple[Finding, ...], tuple[Finding, ...]]:
    """What is certain, and what likely, where nothing moves or a plate shows one value throughout.

    Args:
        tree: The robot.
        taken: The recording.
    """
    moved = np.ptp(taken.position, axis=0)[list(own_joints(tree))]
    if moved.size and moved.max() < STILL:
        rest = Finding(
            "the robot",
            f"rests: no joint moves by more than {moved.max():.2g} rad or m, so nothing of units, "
            "signs, orders and frames can be told",
            float(moved.max()),
            ("a robot at rest", "columns that are not positions"),
            "record a motion of all joints",
        )
        return (), (rest,)
    wrench = taken.wrench
    if wrench is None or np.ptp(wrench, axis=0).max() > ROUNDING * np.abs(wrench).max():
        return (), ()
    silent = Finding(
        "the plate",
        f"shows the same throughout, {components(wrench[0])} N, N m, while joints move",
        0.0,
        ("columns that are not the plate's", "a plate that was not read"),
        "look at the columns of [wrench]",
    )
    return (silent,), ()


def unmoved_finding(tree: Tree, read: Explanation) -> Finding | None:
    """Joints that rest throughout by their positions, those first that their torques say move.

    Args:
        tree: The robot.
        read: The recording as it is; without torques, the plate's channels count.
    """
    taken = read.reading.taken
    odd = read.left > BRAKED + 3 * read.noise
    moves = odd[: tree.n] if taken.torque is not None else np.full(tree.n, odd.any())
    still = [k for k in own_joints(tree) if np.ptp(taken.position[:, k]) < STILL]
    dead = [k for k in still if moves[k]]
    if not still:
        return None
    said = ", and what was measured is not explained by a joint at rest" if dead else ""
    causes = ("a dead encoder", "a column that is not its position", "a joint held by its brake")
    return Finding(
        f"the position of {few([tree.names[k] for k in dead or still])}",
        f"is the same throughout{said}",
        float(len(dead)),
        causes if dead else ("a joint at rest", *causes),
        "look at the columns of [position]; of joints at rest nothing is identified",
    )
