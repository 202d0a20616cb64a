"""What a plate's best reading says besides: crosstalk, another robot, its zero."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from testbed.arrays import Array
from testbed.dynamics.inverse_dynamics import pedestal_wrench
from testbed.identification.finding import Finding, components
from testbed.recordings.columns import AXES
from testbed.robot.rotations import from_rpy
from testbed.robot.tree import Tree
from testbed.sanity.cure_words import share
from testbed.sanity.explanation import Explanation
from testbed.sanity.mistakes import Mistake
from testbed.sanity.position_reading import MIXED

UNEXPLAINED, NOISY = 0.05, 3.0
"""Share of a channel that no reading of a right recording leaves; times the noise's own besides."""

MOVED, CLEAR = 0.03, 5.0
"""Parts of the robot's weight, and sigmas, from which a plate's zero is another one."""

ARM = 1.0
"""Lever by which a weight counts as a moment [m]."""

PULLED = -0.1
"""Parts of the robot's weight below which a robot weighs less than nothing."""

FOREIGN, MIXED_CHANNELS, WEIGHT = "plate.foreign", "plate.crosstalk", "plate.weight"
"""Codes of findings."""

ALONG = 1e-3
"""By how much a turn's axis may differ from a joint's."""


def map_findings(best: Explanation) -> tuple[list[Finding], list[Finding]]:
    """What is certainly wrong, and what may be, where no mapping explains the plate.

    Args:
        best: What explains the recording best.
    """
    left, noise = best.left[-6:], best.noise[-6:]
    odd = left > MIXED + NOISY * noise
    channel = int(np.argmax(left - NOISY * noise))
    if not odd.any():
        return [], []
    sure = bool((left > UNEXPLAINED + NOISY * noise).any())
    any_map = best.reading.linear_share
    said = f"{share(left[channel])} of {AXES[channel]} is unexplained by every turn, unit and order"
    if best.reading.mixed(left):
        mixed = Finding(
            "the plate",
            f"mixes its channels: {said}, {share(any_map)} by a matrix of all six",
            float(left[channel]),
            ("crosstalk", "a calibration matrix that is not used"),
            "calibrate the plate (testbed calibrate), or give [wrench] its matrix",
            MIXED_CHANNELS,
        )
        return ([mixed], []) if sure else ([], [mixed])
    foreign = Finding(
        "the plate",
        f"has measured another robot, or in other columns: {said}",
        float(left[channel]),
        ("another robot", "columns that are not the plate's", "a plate that drifts"),
        "look at the columns of [position] and [wrench], and at the model",
        FOREIGN,
    )
    return ([foreign], []) if sure else ([], [foreign])


def zero_of_plate(best: Explanation) -> tuple[Array, Array]:
    """What the plate shows without the robot, and its sigma, (6,) [N, N m].

    The robot's share is that of the parameters that the varying part of the wrench tells, with the
    model file as prior; its weight is told by no motion on a base at rest.

    Args:
        best: What explains the recording best; with a wrench.
    """
    reading = best.reading
    mean, root = reading.posterior(best)
    rest = reading.wrench(best) - reading.base @ mean
    spread = reading.base.mean(axis=0) @ root
    return rest.mean(axis=0), np.linalg.norm(spread, axis=1)


def zero_mistake(best: Explanation, tare: Array | None, least: float = MOVED) -> Mistake | None:
    """The mistake of a plate that shows something without the robot, if it clearly does.

    Args:
        best: What explains the recording best; with a wrench.
        tare: What the recording says that it shows, (6,) [N, N m]; None for the model's pedestal.
        least: Parts of the robot's weight by which it must be another one.
    """
    tree = best.reading.prior.tree
    known = pedestal_wrench(tree) if tare is None else tare
    found, sigma = zero_of_plate(best)
    smallest = least * weight(tree) * np.repeat([1.0, ARM], 3)
    if not (np.abs(found - known) > np.maximum(smallest, CLEAR * sigma)).any():
        return None
    return Mistake("tare", (), tuple(np.round(found, 3).tolist()))


def weight_finding(best: Explanation, tare: Array | None) -> Iterator[Finding]:
    """A robot that pulls its plate up.

    Args:
        best: What explains the recording best; with a wrench.
        tare: As of `zero_mistake`.
    """
    tree = best.reading.prior.tree
    known = pedestal_wrench(tree) if tare is None else tare
    mean = best.reading.wrench(best).mean(axis=0) - known
    gravity = tree.gravity
    size = float(np.linalg.norm(gravity))
    carried = float(-mean[:3] @ gravity / size**2) if size else 0.0
    if carried * size < PULLED * weight(tree):
        yield Finding(
            "the plate",
            f"is pulled up: the robot would weigh {carried:.3g} kg, the mean force is "
            f"{components(mean[:3])} N",
            carried,
            ("a plate that was zeroed under the robot", "the opposite sense of the wrench"),
            "in the mapping: [wrench] tare, what the plate shows without the robot",
            WEIGHT,
        )


def weight(tree: Tree) -> float:
    """Of the robot by the model file [N]."""
    mass = sum(each.mass for each in tree.inertias)
    return float(mass * np.linalg.norm(tree.gravity))


def equal_zeros(tree: Tree, mistakes: Sequence[Mistake]) -> Iterator[str]:
    """Zeros of the first joint that are the same as a turn of the plate's frame about its axis.

    Args:
        tree: The robot.
        mistakes: That explain a recording.
    """
    roots = [joint for joint in tree.joints if joint.parent < 0]
    for each in mistakes:
        if each.kind != "turn" or len(roots) != 1 or not roots[0].revolute or tree.floating:
            continue
        turn, axis = from_rpy(each.values), roots[0].carried_axis
        if np.linalg.norm(turn @ axis - axis) < ALONG:
            sine = float(axis @ [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0],
                                 turn[1, 0] - turn[0, 1]]) / 2  # fmt: skip
            angle = np.arctan2(sine, (np.trace(turn) - 1) / 2)
            yield f"another zero of '{roots[0].name}' ({-np.rad2deg(angle):.4g} deg)"
