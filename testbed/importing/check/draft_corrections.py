"""Corrections of a draft mapping: delays, and the frame and zero of a force plate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.transform import Transform
from testbed.core.recordings.source import Source
from testbed.core.robot.rotations import matrix_to_rpy, rotvec_to_matrix, rpy_to_matrix
from testbed.importing.check.assessment import zero_hypothesis
from testbed.importing.check.explanation import Explanation
from testbed.importing.check.plate import MAX_ORIGIN_SIGMA
from testbed.importing.check.plate_frame import plate_frame_of, unit_ratio
from testbed.importing.check.plate_map import (
    DELAY_INDEX,
    RATIO_INDEX,
    ROTATION_INDICES,
    SHIFT_INDICES,
    rotation_vector,
)
from testbed.importing.check.time_offset import TimeOffset, alignment_lines
from testbed.importing.import_report import MappingDraft
from testbed.importing.mapping import Mapping as MappingFile

ANGLE_STEPS = np.deg2rad([90, 45, 30, 15])
"""Steps to which angles are rounded [rad]."""

DELAY_Z_THRESHOLD = 4.0
"""Normalised delay from which a plate with the clock of the positions is late."""

MAX_SQUARED_DISTANCE = 14.2
"""Largest squared distance of a rotation from rounded angles, in standard deviations: 99.7 %
quantile of the chi-squared distribution with three degrees of freedom."""


def with_clocks(
    draft: MappingDraft, source: Source, offsets: Sequence[TimeOffset]
) -> MappingDraft:
    """Draft in which significant delays and drifts of clocks are corrected.

    Args:
        draft: Draft of the mapping.
        source: Recording made with this draft.
        offsets: Estimated delays and drifts; insignificant ones have no effect.
    """
    content = draft.content
    for each in offsets:
        for table, key, value in alignment_lines(each, content, source.metadata.report):
            if key == "delay":
                draft = with_delay(draft, table, value, each.sigma)
            else:
                note = (
                    f"solved: {1e6 * each.skew:.1f} +- {1e6 * each.skew_sigma:.1f} ppm"
                )
                draft = draft.with_key(table, key, value, note)
    return draft


def with_delay(
    draft: MappingDraft, signal: str, delay: float, sigma: float
) -> MappingDraft:
    """Draft with a signal's delay [s], or with the offset of its separate clock.

    If the signal's source differs from that of the positions, the delay is subtracted from the
    source's `offset`, and the signal's key `delay` is removed.

    Args:
        draft: Draft of the mapping.
        signal: Table of the signal.
        delay: Delay, which replaces the stated delay [s].
        sigma: Standard deviation, for the comment [s].
    """
    source = draft.tables[signal]["source"]
    table, key, value = signal, "delay", round(delay, 7)
    if source != draft.tables["position"]["source"]:
        table, key = f"sources.{source}", "offset"
        value = round(draft.tables[table].get("offset", 0.0) - delay, 7)
        draft = draft.with_key(signal, "delay", None)
    return draft.with_key(
        table, key, value, f"solved: {1e3 * value:.3f} +- {1e3 * sigma:.3f} ms"
    )


def with_plate_correction(draft: MappingDraft, best: Explanation) -> MappingDraft:
    """Draft with frame, delay and zero of a plate as determined from the data.

    Corrections are estimated by `PlateEvidence.frame_correction`; angles are rounded to multiples
    of 90, 45, 30 or 15 deg if consistent with the data. A plate that shares the positions' clock
    gets a delay only beyond 4 standard deviations. The ratio of units is only stated in a comment.

    Args:
        draft: Draft of the mapping.
        best: Best explanation (plate map and hypotheses) of the recording made with this draft.
    """
    table = draft.tables.get("wrench")
    if table is None:
        return draft
    frame = plate_frame_of(draft.content)
    corrections, covariance = best.fit.plate.frame_correction(best.plate)
    sigma = np.sqrt(np.diagonal(covariance))
    turn = rotvec_to_matrix(corrections[ROTATION_INDICES])
    rotation, xyz = (
        turn @ frame.rotation,
        turn @ frame.origin + corrections[SHIFT_INDICES],
    )
    rpy = _rounded_angles(
        rotation, covariance[np.ix_(ROTATION_INDICES, ROTATION_INDICES)]
    )
    draft = _with_place(draft, rotation, xyz, rpy, sigma)
    ratio = 1 / unit_ratio(frame.units) / (1 + corrections[RATIO_INDEX])
    note = draft.key_comments.get(("wrench", "units"), "by the file")
    note += f"; ratio {ratio:.6g} +- {ratio * sigma[RATIO_INDEX]:.2g}"
    draft = draft.with_key("wrench", "units", table["units"], note)
    delay = float(corrections[DELAY_INDEX])
    same_clock = (
        table["source"] == draft.tables["position"]["source"] and "delay" not in table
    )
    if not same_clock or abs(delay) > DELAY_Z_THRESHOLD * sigma[DELAY_INDEX]:
        draft = with_delay(
            draft, "wrench", table.get("delay", 0.0) + delay, float(sigma[DELAY_INDEX])
        )
    matrix = (
        Transform(rpy_to_matrix(rpy), xyz).wrench_matrix
        @ frame.wrench_to_sensor
        @ best.plate.map
    )
    return with_plate_zero(draft, replace(best, plate=replace(best.plate, map=matrix)))


def _with_place(
    draft: MappingDraft, rotation: Array, xyz: Array, rpy: Sequence[float], sigma: Array
) -> MappingDraft:
    """Draft with a plate's origin and rounded angles, and with a comment on their uncertainty.

    Args:
        draft: Draft of the mapping.
        rotation: Rotation matrix from the sensor frame to the bedplate frame, (3, 3).
        xyz: Origin of the sensor frame in the bedplate frame, (3,) [m].
        rpy: Rounded roll, pitch and yaw of the sensor frame [rad].
        sigma: Standard deviations of the corrections of a map, (8,).
    """
    angles, angle_errors = (
        np.rad2deg(matrix_to_rpy(rotation)),
        np.rad2deg(sigma[ROTATION_INDICES]),
    )
    errors = sigma[SHIFT_INDICES]
    origin = draft.key_comments.get(("wrench", "place"), "solved")
    note = f"{origin}; rpy {_decimals(angles, 3)} +- {_decimals(angle_errors, 3)} deg"
    note += f"; xyz {_decimals(1e3 * xyz, 2)} +- {_decimals(1e3 * errors, 2)} mm"
    axes = [
        axis
        for axis, each in zip("xyz", errors, strict=True)
        if each > MAX_ORIGIN_SIGMA
    ]
    note += f"; {', '.join(axes)} not determined by these data" * bool(axes)
    value = {"xyz": np.round(xyz, 4).tolist(), "rpy": [round(a, 6) + 0.0 for a in rpy]}
    return draft.with_key("wrench", "# place", None).with_key(
        "wrench", "place", value, note
    )


def with_plate_zero(draft: MappingDraft, best: Explanation) -> MappingDraft:
    """Draft in which `tare` is the plate's wrench without the robot, if significant.

    It is significant if a component differs by more than 5 standard deviations from the stated tare
    or, by default, from the wrench of the model's pedestal.

    Args:
        draft: Draft of the mapping.
        best: Best explanation (plate map and hypotheses) of the recording made with this draft.
    """
    table = MappingFile.model_validate(draft.content).wrench
    zero = (
        None
        if table is None
        else zero_hypothesis(best, table.static_wrench(None), min_shift=0.0)
    )
    if zero is None:
        return draft
    note = "solved: by the data; the part of Fz, Mx and My due to weight by the file's masses"
    return with_tare(draft, list(zero.values), note)


def with_tare(draft: MappingDraft, tare: list[float], note: str) -> MappingDraft:
    """Draft with a `tare`, which replaces the statement that the pedestal is included.

    Args:
        draft: Draft of the mapping.
        tare: Wrench on the plate without the robot, pedestal included, (6,) [N, N m].
        note: Comment at the end of the line.
    """
    included = draft.tables["wrench"].get("pedestal") == "included"
    draft = draft.with_key("wrench", "pedestal", None) if included else draft
    return draft.with_key("wrench", "tare", tare, note)


def _rounded_angles(rotation: Array, covariance: Array) -> Sequence[float]:
    """Roll, pitch and yaw [rad], rounded to common steps if consistent with the covariance.

    The largest step out of 90, 45, 30 and 15 deg is taken for which the rounded rotation is within
    the 99.7 % confidence ellipsoid.

    Args:
        rotation: Rotation matrix, (3, 3).
        covariance: Covariance of its rotation vector, (3, 3) [rad^2].
    """
    rpy = matrix_to_rpy(rotation)
    for step in ANGLE_STEPS:
        rounded = [round(angle / step) * step for angle in rpy]
        difference = rotation_vector(rpy_to_matrix(rounded) @ rotation.T)
        if difference @ np.linalg.solve(covariance, difference) < MAX_SQUARED_DISTANCE:
            return rounded
    return rpy


def _decimals(values: Array, digits: int) -> str:
    """Numbers with a given number of decimals, separated by commas."""
    return ", ".join(f"{value:.{digits}f}" for value in values)
