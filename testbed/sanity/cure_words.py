"""What is wrong with a recording in words, and what would cure it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from testbed.arrays import Array
from testbed.errors import few
from testbed.identification.finding import Finding, components
from testbed.robot.tree import Tree
from testbed.sanity.cures import OF_BASE, OF_PLATE, WHAT, Cure, numbers, remedy
from testbed.sanity.mistakes import Mistake, own_joints

SMALLER = {"N m": "N mm", "A": "mA", "V": "mV", "kN m": "N m", "N": "mN"}
"""Units a thousand times smaller."""

SIZE = "torque.size"
"""Code of the finding of torques of another size."""

CLEARLY = 1.2
"""Times as much as the best leaves from which another explanation leaves more."""


def cure_finding(
    tree: Tree, cures: Sequence[Cure], runner_up: Sequence[str], times: float,
    equals: Sequence[str], gain: float,
) -> Finding:  # fmt: skip
    """Cures as a person reads them.

    Args:
        tree: The robot.
        cures: To be made together.
        runner_up: Kinds of mistakes of the next best explanation; empty if there is none.
        times: So many times more is left by that.
        equals: What explains the same, in words.
        gain: How much likelier the data are with the cures [nats].
    """
    names = list(dict.fromkeys(name for each in cures for name in each.joints))
    subject = f"joint '{names[0]}'" if len(names) == 1 else f"joints {few(names)}"
    if len(names) == len(own_joints(tree)) > 1:
        subject = "all joints"
    others = [s for kinds, s in ((OF_PLATE, "the plate"), (OF_BASE, "the base"))
              if any(each.kind in kinds for each in cures)]  # fmt: skip
    subject = " and ".join([*others, *([subject] if names else [])])
    worst = max(cures, key=lambda each: each.before - each.after)
    said = (
        f"cannot be as recorded: {share(worst.before)} of {worst.channel} is unexplained, "
        f"{share(worst.after)} with the cure"
        if worst.before > CLEARLY * worst.after
        else "cannot be as recorded with masses near the model file's: with the cure the log "
        f"likelihood rises by {gain:.0f}"
    )
    if runner_up:
        own = {each.kind for each in cures}
        next_best = ", ".join(WHAT[kind] for kind in runner_up if kind not in own)
        more = (
            f"{times:.2g} times as much" if times > CLEARLY else "as much, with masses less likely"
        )
        said += f"; the next best explanation, {next_best or 'of other values'}, leaves {more}"
    if equals:
        said += f"; the data cannot tell this from {', or '.join(equals)}"
    causes = " and ".join(dict.fromkeys(WHAT[each.kind] for each in cures))
    return Finding(subject, said, worst.before, (causes,), f"in the mapping: {remedy(cures)}")


def zero_finding(cure: Cure) -> Finding:
    """A plate whose zero is another one, and nothing else wrong.

    Args:
        cure: Of the kind `tare`.
    """
    return Finding(
        "the plate",
        f"shows {components(np.array(cure.values))} N, N m without the robot, by rough masses",
        float(np.abs(cure.values).max()),
        (WHAT["tare"],),
        f"identify with --set identification.tare=unknown, or in the mapping: {remedy([cure])}",
    )


def named(tree: Tree, mistake: Mistake) -> str:
    """A mistake with the joints that it is about, and by how much zeros are off.

    Args:
        tree: The robot.
        mistake: What may be wrong.
    """
    if not mistake.joints or len(mistake.joints) == len(own_joints(tree)):
        return WHAT[mistake.kind]
    names = few([tree.names[k] for k in mistake.joints])
    by = ", ".join(f"{np.rad2deg(angle):.0f}" for angle in mistake.values)
    return f"{WHAT[mistake.kind]} ({names}{f' by {by} deg' if mistake.kind == 'zero' else ''})"


def share(part: float) -> str:
    """A part of a channel's variance as a person reads it.

    Args:
        part: 1 for all.
    """
    return f"{100 * min(part, 1.0):.3g}%"


def gain_finding(
    tree: Tree, sizes: Array, least: float, most: float, mapping: Mapping[str, Any]
) -> Finding:
    """Torques that are far from what masses of that order make.

    Args:
        tree: The robot.
        sizes: Times what the model file's masses say, (n,).
        least: Below this they are doubted.
        most: Above this.
        mapping: What the recording's mapping file says; empty if it has none.
    """
    told = [k for k in range(tree.n) if np.isfinite(sizes[k])]
    odd = [k for k in told if not least < sizes[k] < most]
    said = ", ".join(f"{tree.names[k]} {sizes[k]:.2g}" for k in odd[:6])
    needed = numbers([1 / sizes[k] if k in told else 0.0 for k in range(tree.n)])
    small = all(sizes[k] < 1 for k in odd)
    causes = (
        ("torques on the motors' side of the gears", "currents taken for torques")
        if small
        else ("a unit such as N mm", "masses of another robot")
    )
    cure = (
        f'[torque] side = "motor" with a table [gear] (ratio about {needed}), or unit = "A" with '
        f"gain about {needed}"
        if small
        else f"[torque] unit{_smaller_unit(sizes[told], mapping)}"
    )
    return Finding(
        "the torque",
        f"is too {'small' if small else 'large'}: it is so many times what the model's masses "
        f"make: {said}",
        float(sizes[odd[0]]),
        causes,
        f"in the mapping: {cure}",
        SIZE,
    )


def position_finding(tree: Tree, position: Array, outside: float) -> Iterator[Finding]:
    """Positions that no joint of this robot can have.

    Args:
        tree: The robot.
        position: (M, n) [rad or m].
        outside: Ranges by which they leave the joint's range.
    """
    said, turning = [], False
    for joint, q in zip(tree.joints, position.T, strict=True):
        low, high = joint.position_range
        room = outside * (high - low)
        if q.min() < low - room or q.max() > high + room:
            turning |= joint.revolute
            said.append(
                f"'{joint.name}' {q.min():.4g} to {q.max():.4g} (its range is {low:.4g} to "
                f"{high:.4g} {'rad' if joint.revolute else 'm'})"
            )
    if said:
        more = f" and {len(said) - 2} more" if len(said) > 2 else ""
        unit = "deg" if turning else "mm"
        yield Finding(
            "positions",
            f"are such as no joint has: {', '.join(said[:2])}{more}",
            float(len(said)),
            (f"positions in {unit}", "positions on the motors' side of the gears"),
            f'in the mapping: [position] unit = "{unit}", or side = "motor" and a table [gear]',
        )


def _smaller_unit(sizes: Array, mapping: Mapping[str, Any]) -> str:
    """The unit a thousand times smaller than the mapping's, where torques are so many too large."""
    unit = (mapping.get("torque") or {}).get("unit")
    thousand = 0.5 < np.median(sizes) / 1e3 < 2.0
    return f' = "{SMALLER[unit]}"' if thousand and unit in SMALLER else ""
