"""What a motion leaves of its limits, kind by kind, over time: for pictures, no proof."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed.arrays import Array
from testbed.excitation.clearance import FAR, DistanceMeter
from testbed.excitation.fourier import Fourier
from testbed.excitation.proof import Rules
from testbed.excitation.samples import Computed


@dataclass(frozen=True, eq=False)
class Slack:
    """What the nearest limit of a kind leaves of what may be used.

    Attributes:
        label: The kind, as "velocity limits".
        unit: "%" or "mm".
        left: At each instant, (M,).
    """

    label: str
    unit: str
    left: Array


def slack(motion: Fourier, rules: Rules, times: Array) -> list[Slack]:
    """What is left of every kind of limit; of clearances, where anything comes nearer than FAR.

    Args:
        motion: The motion.
        rules: What it must respect.
        times: (M,) [s].
    """
    here, limits = Computed(rules.tree, motion.at(times)), rules.limits
    shares = {
        "position": np.abs(here.q - limits.middle) / limits.half,
        "velocity": np.abs(here.qd) / limits.velocity,
        "acceleration": np.abs(here.qdd) / limits.acceleration,
    }
    left = {kind: rules.margin - used.max(axis=1) for kind, used in shares.items()}
    left |= {term.labels[0].split()[0]: -term.values(here).max(axis=0) for term in rules.terms}
    found = [Slack(f"{kind} limits", "%", 100 * values) for kind, values in left.items()]
    if rules.collision is not None and rules.collision.pairs:
        meter = DistanceMeter(rules.collision)
        wanted = rules.clearance.max()
        whole = rules.clearance == wanted  # others are built nearer, and would hide all else
        nearest = meter.measure(here.q).values[:, whole].min(axis=1)
        if (nearest < FAR).any():  # else nothing ever comes near
            found.append(Slack("clearances", "mm", 1000 * (nearest - wanted)))
    return found
