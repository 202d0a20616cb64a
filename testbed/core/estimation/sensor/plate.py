"""Unknowns of a plate: its 36 sensitivities, constants and trends, its pose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from testbed.core.base.arrays import Array, apply
from testbed.core.base.transform import Transform
from testbed.core.dynamics.newton_euler import wrench_transforms
from testbed.core.estimation.sensor.estimates import Nuisance, Numbers, Part, always, of_wrench
from testbed.core.estimation.sensor.predicted_wrench import PredictedWrench
from testbed.core.recordings.columns import AXES, PLATE_UNITS
from testbed.core.recordings.recording import Recording
from testbed.core.robot.rotations import from_vector
from testbed.core.robot.tree import Tree

SENSITIVITIES = tuple(
    Part(f"gain/{shown}", "", 1.0)
    if shown == felt
    else Part(f"crosstalk/{shown}/{felt}", {"FM": "1/m", "MF": "m"}.get(f"{shown[0]}{felt[0]}", ""))
    for shown in AXES
    for felt in AXES
)
"""Row by row: `gain/Fz` is what the plate shows of a force Fz there, `crosstalk/Fx/Fz` what Fx
shows of it."""


def _columns(predicted: PredictedWrench) -> Array:
    filtered = predicted.rows(predicted.wrench[:, :, None])[..., 0]
    found = np.zeros((len(filtered), 6, 36))
    for shown in range(6):
        found[:, shown, 6 * shown : 6 * shown + 6] = filtered
    return found


def _unmixed(values: Array) -> Array:
    return np.asarray(np.linalg.inv(values.reshape(6, 6)))


_MIXED = np.flatnonzero(~np.eye(6, dtype=np.bool_))
"""Sensitivities of a channel to the load of another."""


def _channels(kind: str, per: str = "") -> Numbers:
    units = zip(AXES, PLATE_UNITS, strict=True)
    return always(*(Part(f"{kind}/{axis}", f"{unit}{per}") for axis, unit in units))


BIAS = Nuisance(
    "bias",
    _channels("bias"),
    lambda predicted: np.broadcast_to(np.eye(6), (len(predicted.time), 6, 6)),
    of_wrench(lambda wrench, values, time: wrench - values),
    passing=True,
    added=True,
)


SLOPE = Nuisance(
    "slope",
    _channels("slope", "/s"),
    lambda predicted: predicted.time[:, None, None] * np.eye(6),
    of_wrench(lambda wrench, values, time: wrench - time[:, None] * values),
    passing=True,
    added=True,
)
"""From the middle of the recording."""

TARE = replace(BIAS, kind="tare", parts=_channels("tare"), passing=False)
"""What the plate shows of the pedestal beyond the tare: to a fixed plate the same as a bias."""


def _moving_constants(predicted: PredictedWrench) -> Array:
    moved = [*wrench_transforms(predicted.tree, predicted.motion.q).values()]
    none = np.zeros((predicted.motion.samples, 6, 0))
    return predicted.rows(-np.concatenate([none, *moved], axis=2))


def _without_moving_constants(
    recording: Recording, values: Array, time: Array, tree: Tree
) -> Recording:
    del time
    moved = wrench_transforms(tree, recording.position).values()
    each = zip(moved, values.reshape(-1, 6), strict=True)
    taken = sum((apply(to, zero) for to, zero in each), np.zeros(6))
    return replace(recording, wrench=recording.measured("wrench") + taken)


def _moved(wrench: Array) -> Array:
    """By each of the six, (M, 6, 6)."""
    force, moment = wrench[:, :3], wrench[:, 3:]
    found = np.zeros((len(force), 6, 6))
    for k, axis in enumerate(np.eye(3)):
        found[:, :3, k] = -np.cross(axis, force)
        found[:, 3:, k] = -np.cross(axis, moment)
        found[:, 3:, 3 + k] = -np.cross(axis, force)
    return found


def _moved_back(wrench: Array, pose: Array) -> Array:
    """Wrench in the bedplate's frame of one that a plate in a pose, (6,), shows, (M, 6)."""
    return Transform(from_vector(pose[:3]), pose[3:]).wrench(wrench)


PLATE = (
    BIAS,
    # what the next force sensors show too much: taken off the wrench, it turns with them
    Nuisance(
        "next_bias",
        lambda tree: tuple(
            part for cut in tree.cuts for part in _channels(f"bias/{cut.name}")(tree)
        ),
        _moving_constants,
        _without_moving_constants,
        beside=BIAS.kind,
        added=True,
    ),
    TARE,
    SLOPE,
    Nuisance(
        "matrix",
        always(*SENSITIVITIES),
        _columns,
        of_wrench(lambda wrench, values, time: wrench @ _unmixed(values).T),
        covers=("gains", "crosstalk", "pose", "height"),
        whole=True,
        added=True,
        unmixed=_unmixed,
    ),
    Nuisance(
        "pose",
        always(
            *(Part(f"pose/r{axis}", "rad") for axis in "xyz"),
            *(Part(f"pose/p{axis}", "m") for axis in "xyz"),
        ),
        lambda predicted: predicted.rows(_moved(predicted.wrench)),
        of_wrench(lambda wrench, values, time: _moved_back(wrench, values)),
        by_measured=lambda predicted: _moved(predicted.shown),
        tested=True,
    ),
    # the third component of the pose's shift alone
    Nuisance(
        "height",
        always(Part("height", "m")),
        lambda predicted: predicted.rows(_moved(predicted.wrench))[..., 5:],
        of_wrench(lambda wrench, values, time: _moved_back(wrench, np.pad(values, (5, 0)))),
        by_measured=lambda predicted: _moved(predicted.shown)[..., 5:],
    ),
    # relative
    Nuisance(
        "gains",
        always(*(Part(f"gains/{axis}", "") for axis in AXES)),
        lambda predicted: _columns(predicted)[..., ::7],
        tested=True,
    ),
    # what a channel shows of another's load; a plate that is turned or shifted does that, too
    Nuisance(
        "crosstalk",
        always(*(Part(SENSITIVITIES[k].name, "") for k in _MIXED)),
        lambda predicted: _columns(predicted)[..., _MIXED],
        covers=("pose",),
        tested=True,
    ),
)
"""Errors of the plate."""
