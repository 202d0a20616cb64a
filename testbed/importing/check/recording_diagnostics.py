"""What may be wrong with a recording, before anything is estimated."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, diagnose
from testbed.core.base.errors import components, few, round_significant
from testbed.core.recordings.channels import ChannelFault
from testbed.core.recordings.columns import AXES, STILL
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.source import Source
from testbed.core.robot.tree import Tree
from testbed.importing.check.explanation import Explanation
from testbed.importing.check.instants import Instants
from testbed.importing.check.plate import MIXED, UNEXPLAINED
from testbed.importing.check.remedies import KINDS, Hypothesis, Remedy, own_joints
from testbed.importing.import_report import in_mapping

NOISE_RESTS, ROUNDING = 1e-2, 1e-9
"""Motion of joints below which noise is no motion [rad or m]; part of a value that a filter's
rounding changes at most."""

RARE, FEWEST, APART = 1e-3, 5, 3
"""Part of the samples, and number, that may be spikes; samples after which one is over."""

FAR, LITTLE = 2.0, 1e-2
"""Ranges of all other samples by which a spike lies outside; part of the largest range of its
signal's channels that each has at least."""

SHOWN, WIDE = 60, 110
"""Characters that spikes, and ranges, may take."""

MOVED = 0.1
"""Part of a torque's variance that is left where a joint at rest moves indeed."""

NOISY = 3.0
"""Times a channel's noise that may be left besides."""

PULLED = -0.1
"""Parts of the robot's weight below which a robot weighs less than nothing."""

LIGHT = 0.03
"""Part of the robot's mass below which nobody sees whether a pedestal was weighed."""

DOUBTED, REFUSED = 2.5, 4.0
"""Times too large or too small, by the model file, from which torques are doubted, and from which
they are refused: no masses are so wrong."""

SMALLER = {"N m": "N mm", "A": "mA", "V": "mV", "kN m": "N m", "N": "mN"}
"""Units a thousand times smaller."""

CLEARLY = 1.2
"""Times as much as with the remedies that a channel leaves without, for its share to be said."""


def share(part: float) -> str:
    """A part of a channel's variance as a person reads it.

    Args:
        part: 1 for all.
    """
    return f"{100 * min(part, 1.0):.3g}%"


def spikes(recording: Recording) -> Iterator[Diagnostic]:
    """Channels with a few samples far outside of all others.

    Args:
        recording: Or a part of one.
    """
    for signal in ("position", "torque", "wrench"):
        if signal not in recording.signals:
            continue
        values = recording.measured(signal)
        rare = min(max(FEWEST / len(values), RARE), 0.25)
        low, high = np.quantile(values, [rare, 1 - rare], axis=0)
        room = FAR * np.maximum(high - low, LITTLE * (high - low).max())
        outside = (values < low - room) | (values > high + room)
        lasting = outside[APART:] & outside[:-APART]
        for k in np.flatnonzero(outside.any(axis=0) & ~lasting.any(axis=0)):
            name = f"the {signal} of '{recording.names[k]}'"
            if signal == "wrench":
                name = f"the plate's {AXES[k]}"
            at = np.flatnonzero(outside[:, k])
            said = few(
                [f"{values[i, k]:.4g} at {recording.time[i]:.6g} s" for i in at], SHOWN
            )
            yield diagnose(
                "channel.spikes", name, len(at), spikes=said, low=low[k], high=high[k]
            )


def out_of_range(tree: Tree, position: Array) -> Iterator[Diagnostic]:
    """Positions that no joint of this robot can have: beyond its range by as much as that spans.

    Args:
        tree: The robot.
        position: (M, n) [rad or m].
    """
    low, high = np.array([joint.position_range for joint in tree.joints]).T
    least, most = position.min(axis=0), position.max(axis=0)
    room = high - low
    beyond = np.flatnonzero((least < low - room) | (most > high + room))
    if not beyond.size:
        return
    lines = [
        f"'{tree.names[k]}' {least[k]:.4g} to {most[k]:.4g} (its range is {low[k]:.4g} to "
        f"{high[k]:.4g} {'rad' if tree.joints[k].revolute else 'm'})"
        for k in beyond
    ]
    turning = any(tree.joints[k].revolute for k in beyond)
    cause, unit = ("degrees", "deg") if turning else ("millimetres", "mm")
    yield diagnose(
        "position.range",
        "positions",
        len(lines),
        causes=(cause, "motor-side"),
        ranges=few(lines, WIDE),
        unit=unit,
    )


def at_rest(tree: Tree, instants: Instants) -> Iterator[Diagnostic]:
    """A robot that does not move, or else a plate that shows one value throughout.

    Args:
        tree: The robot.
        instants: Of the recording.
    """
    position = instants.motion.q[:, list(own_joints(tree))]
    moved, wrench = np.ptp(position, axis=0).max(initial=0.0), instants.wrench
    # in a wrong unit noise may be larger: it changes from instant to instant, as no motion does
    noise = (np.diff(position, axis=0).var(axis=0) > position.var(axis=0)).all()
    if position.size and moved < (NOISE_RESTS if noise else STILL):
        yield diagnose("robot.rest", "the robot", moved)
    elif (
        wrench.size and np.ptp(wrench, axis=0).max() <= ROUNDING * np.abs(wrench).max()
    ):
        yield diagnose("plate.silent", "the plate", 0.0, wrench=components(wrench[0]))


def still_joints(
    tree: Tree, instants: Instants, unexplained: Array
) -> Iterator[Diagnostic]:
    """Joints that rest throughout by their positions, those first that their torques say move.

    Args:
        tree: The robot.
        instants: Of the recording.
        unexplained: Parts of the torques' variance that are left, (n,) or (0,).
    """
    position = instants.motion.q
    still = [k for k in own_joints(tree) if np.ptp(position[:, k]) < STILL]
    dead = [k for k in still if unexplained.size and unexplained[k] > MOVED]
    if dead:
        yield diagnose("position.still", few([tree.names[k] for k in dead]), len(dead))
    elif still:
        places = position.mean(axis=0)
        held = [f"{tree.names[k]} at {places[k]:.4g}" for k in still]
        yield diagnose("position.held", few(held))


def unexplained_plate(best: Explanation) -> Iterator[Diagnostic]:
    """A plate that no mapping explains.

    Args:
        best: What explains the recording best.
    """
    evidence, plate = best.fit.plate, best.plate
    if plate.explained(MIXED):
        return
    shares, noise = plate.unexplained, plate.noise
    channel = int(np.argmax(shares - NOISY * noise))
    certain = not plate.explained(UNEXPLAINED)
    yield diagnose(
        "plate.crosstalk" if evidence.mixed(shares) else "plate.foreign",
        "the plate",
        shares[channel],
        level="error" if certain else "warning",
        channel=AXES[channel],
        share=share(shares[channel]),
        mixed=share(evidence.least),
    )


def negative_weight(best: Explanation, tare: Array | None) -> Iterator[Diagnostic]:
    """A robot that pulls its plate up.

    Args:
        best: What explains the recording best; with a wrench.
        tare: What the recording says that it shows without the robot, as of `Prior.zero`.
    """
    tree = best.fit.prior.tree
    if tree.sensor is not None:
        return  # it turns with a link: its mean force is no weight
    carried, force = carried_mass(best, tare)
    if carried * np.linalg.norm(tree.gravity) < PULLED * best.fit.prior.weight:
        yield diagnose("plate.weight", "the plate", carried, force=components(force))


def carried_mass(best: Explanation, tare: Array | None) -> tuple[float, Array]:
    """What a plate carries besides what is known [kg], and the mean force of it, (3,) [N].

    Args:
        best: What explains the recording best; with a wrench.
        tare: As of `negative_weight`.
    """
    prior = best.fit.prior
    force = (best.fit.plate.wrench(best.plate).mean(axis=0) - prior.zero(tare))[:3]
    size = float(np.linalg.norm(prior.tree.gravity))
    return (float(-force @ prior.tree.gravity / size**2) if size else 0.0), force


def weights(best: Explanation) -> tuple[float, float, float] | None:
    """The robot with the pedestal in a plate's reading, without it, and by the file [kg].

    None where the model's pedestal is no weight, or there is no plate.

    Args:
        best: What explains the recording best.
    """
    tree = best.fit.prior.tree
    file, pedestal = sum(each.mass for each in tree.inertias), tree.pedestal.mass
    if pedestal < LIGHT * file:
        return None
    included, without = (carried_mass(best, tare)[0] for tare in (None, np.zeros(6)))
    return included, without, float(file)


def unsaid_pedestal(
    best: Explanation, mapping: Mapping[str, Any]
) -> Iterator[Diagnostic]:
    """A plate that seems to be read without the pedestal, of which its mapping says nothing.

    Args:
        best: What explains the recording best.
        mapping: What the recording's mapping file says; empty if it has none.
    """
    table = mapping.get("wrench")
    found = weights(best) if table and not {"pedestal", "tare"} & table.keys() else None
    if found is not None and removed(*found):
        pedestal = best.fit.prior.tree.pedestal.mass
        yield diagnose(
            "plate.pedestal",
            "the plate",
            found[0],
            pedestal=pedestal,
            other=found[1],
            file=found[2],
        )


def removed(included: float, without: float, file: float) -> bool:
    """Whether a weight is nearer the model file's without the pedestal in the plate's reading."""
    ratios = np.maximum([included, without], 1e-9) / file
    return bool(np.diff(np.abs(np.log(ratios)))[0] < 0)


def other_zero(remedy: Remedy) -> Diagnostic:
    """A plate whose zero is another one, and nothing else wrong.

    Args:
        remedy: Of the kind `tare`.
    """
    return diagnose(
        "plate.zero",
        "the plate",
        np.abs(remedy.values).max(),
        causes=(KINDS["tare"].words,),
        wrench=components(remedy.values),
        lines=in_mapping(remedy.lines),
    )


def wrong_mapping(
    tree: Tree,
    remedies: Sequence[Remedy],
    equals: Sequence[str],
    gain: float,
    *,
    certain: bool,
) -> Diagnostic:
    """A mapping that hypotheses contradict, and what would make it right.

    Args:
        tree: The robot.
        remedies: To be applied together.
        equals: What else explains the recording, in words.
        gain: How much likelier the data are with the remedies [nats].
        certain: Whether the data leave no doubt.
    """
    names = list(dict.fromkeys(name for each in remedies for name in each.joints))
    joints = f"joint '{names[0]}'" if len(names) == 1 else f"joints {few(names)}"
    if len(names) == len(own_joints(tree)) > 1:
        joints = "all joints"
    tables = [KINDS[each.kind].table for each in remedies]
    subjects = ["the plate"] * ("wrench" in tables) + ["the base"] * ("base" in tables)
    worst = max(remedies, key=lambda each: each.before - each.after)
    clear = worst.before > CLEARLY * worst.after
    return diagnose(
        "mapping.wrong" if clear else "mapping.unlikely",
        " and ".join([*subjects, *[joints][: len(names)]]),
        worst.before,
        level="error" if certain else "warning",
        causes=[
            " and ".join(dict.fromkeys(KINDS[each.kind].words for each in remedies))
        ],
        before=share(worst.before),
        after=share(worst.after),
        channel=worst.channel,
        gain=gain,
        equals=", or ".join(equals),
        lines=in_mapping(line for each in remedies for line in each.lines),
    )


def odd_sizes(
    tree: Tree, sizes: Array, mapping: Mapping[str, Any], *, certain: bool
) -> Iterator[Diagnostic]:
    """Torques that are far from what masses of that order make.

    Args:
        tree: The robot.
        sizes: Times what the model file's masses say, nan where that is not known, (n,) or (0,).
        mapping: What the recording's mapping file says; empty if it has none.
        certain: Whether other sizes explain the torques far better.
    """
    apart = np.maximum(sizes, 1 / sizes)
    certain = certain and bool((apart >= REFUSED).any())
    odd = np.flatnonzero(apart >= (REFUSED if certain else DOUBTED))
    if not odd.size:
        return
    small = bool((sizes[odd] < 1).all())
    unit = str((mapping.get("torque") or {}).get("unit"))
    units = {large: little for little, large in SMALLER.items()} if small else SMALLER
    causes: tuple[str, ...] = ("tool", "other-masses", "unit-n-mm")
    lines = "[torque] unit; or add the tool to the model file"
    if unit in units and 0.5 < np.nanmedian(sizes) * (1e3 if small else 1e-3) < 2.0:
        causes, lines = ("unit-n-mm",), f'[torque] unit = "{units[unit]}"'
    elif small:
        causes = ("motor-side", "currents")
        gains = ", ".join(
            f"{round_significant(1 / x, 5):g}" if x > 0 else "?" for x in sizes
        )
        lines = (
            f'[torque] side = "motor" with a table [gear] (ratio about [{gains}]), or '
            f'unit = "A" with gain about [{gains}]'
        )
    yield diagnose(
        "torque.size",
        "the torque",
        sizes[odd[0]],
        level="error" if certain else "warning",
        causes=causes,
        size="small" if small else "large",
        sizes=", ".join(f"{tree.names[k]} {sizes[k]:.2g}" for k in odd[:6]),
        lines=lines,
    )


def undecided(tree: Tree, hypotheses: Sequence[Hypothesis]) -> Iterator[Diagnostic]:
    """What data leave open of positions.

    Args:
        tree: The robot.
        hypotheses: That explain a recording about as well as none.
    """
    parts = []
    for kind in ("zero", "position_sign", "position_order"):
        joints = sorted(
            {k for each in hypotheses if each.kind == kind for k in each.joints}
        )
        if joints:
            what = kind.removeprefix("position_")
            parts.append(f"the {what} of {few([tree.names[k] for k in joints])}")
    if parts:
        yield diagnose("recording.undecided", "; ".join(parts))


STEPS = ("position.step", "position.unwrapped")
"""Codes of what an import finds of encoders."""


def encoder_steps(source: Source) -> list[Diagnostic]:
    """Diagnose encoder steps that the import of a source has found.

    Args:
        source: The recording.
    """
    return [each for each in source.metadata.diagnostics if each.code in STEPS]


def unknown_gains(source: Source) -> Iterator[Diagnostic]:
    """Diagnose torque constants computed from the model file's masses.

    Args:
        source: The recording.
    """
    mapping = source.metadata.mapping or {}
    if (mapping.get("torque") or {}).get("gain_from") == "model":
        yield diagnose("torque.gains", "the torque")


UNTIMED = ("clipped", "dead", "stuck", "slow", "copied", "magnitude", "smoothed")
"""Faults of torques with which their delay is not determined."""


def clocked(source: Source, faults: Iterable[ChannelFault]) -> list[str]:
    """Signals whose delay their own clock may make: a wrench, and torques of another source.

    Args:
        source: The recording.
        faults: Of its channels.
    """
    mapping = source.metadata.mapping or {}
    torque, position = (
        (mapping.get(each) or {}).get("source") for each in ("torque", "position")
    )
    faulty = any(each.signal == "torque" and each.kind in UNTIMED for each in faults)
    return ["wrench"] if faulty or torque == position else ["torque", "wrench"]
