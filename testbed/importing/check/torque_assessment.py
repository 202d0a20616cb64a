"""Errors of a mapping and of gravity that are found from a log's joint torques."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, make_diagnostic
from testbed.core.base.errors import quoted_list, shortened_list
from testbed.core.recordings.channels import ChannelFault
from testbed.core.recordings.recording import Recording
from testbed.core.robot.tree import Tree
from testbed.importing.check.body_prior import BodyPrior, body_prior
from testbed.importing.check.gravity_readings import GRAVITY_DIRECTIONS
from testbed.importing.check.recording_diagnostics import (
    check_torque_scales,
    check_undetermined_positions,
    percentage,
    wrong_mapping_diagnostic,
)
from testbed.importing.check.remedies import (
    Hypothesis,
    Remedy,
    hypothesis_description,
    merge_hypotheses,
    remedies_for,
)
from testbed.importing.check.torque_columns import has_contradictory_scales
from testbed.importing.check.torque_products import SCALED_COEFFICIENTS
from testbed.importing.check.torque_readings import LogReading, TorqueCase
from testbed.importing.check.torque_signals import torque_signals
from testbed.importing.check.torque_verdict import (
    EQUAL_DIRECTION_COSINE,
    MAX_TORQUE_SCALE,
    MIN_EVIDENCE_RATIO,
    TorqueVerdict,
    case_without_mistake,
    compare_readings,
)
from testbed.importing.import_report import mapping_advice

MAX_DIRECTION_SIGMA = 30.0
"""Standard deviation from which a direction is not determined [deg]."""

MIN_EFFECT = 1e-3
"""Least change of the log evidence by a reading that has an effect at all [nats]."""

MIN_EXPLAINED_SHARE, MIN_RESIDUAL_RATIO, RIDGE = 0.01, 5.0, 1e-9
"""Least part of a torque explained by bodies for a known scale factor, absolute and relative to the
residual; relative ridge on the normal equations."""


@dataclass(frozen=True, eq=False)
class TorqueAssessment:
    """Diagnostics, remedies and scale factors from the torques of a log.

    Attributes:
        diagnostics: Errors, undetermined properties, and unexplained torques.
        remedies: Corrections of the mapping, to be applied together.
        torque_scales: Torques relative to the prediction from the model file's masses, (n,); nan if
            unknown.
        verdict: Result of the model comparison; None if nothing can be tested.
        unexplained: Unexplained shares of the torques' variance as given, (n,) or (0,).
    """

    diagnostics: tuple[Diagnostic, ...] = ()
    remedies: tuple[Remedy, ...] = ()
    torque_scales: Array = field(default_factory=lambda: np.zeros(0))
    verdict: TorqueVerdict | None = None
    unexplained: Array = field(default_factory=lambda: np.zeros(0))


def assess_torques(
    tree: Tree,
    recording: Recording,
    faults: Sequence[ChannelFault] = (),
    prior: BodyPrior | None = None,
) -> TorqueAssessment:
    """Check a log's mapping and gravity against its joint torques.

    Interpretations of the log are compared by Bayesian evidence (`compare_readings`). The result is
    empty if the recording is too short or has too few valid torques.

    Args:
        tree: Robot under the gravity stated by the log.
        recording: Recording in the robot's order of joints.
        faults: Faults of channels; faulty samples are excluded.
        prior: Prior of the bodies from a force plate; if given, positions and gravity are known.
    """
    signals = torque_signals(recording, faults)
    if signals is None:
        return TorqueAssessment()
    bodies = body_prior(tree) if prior is None else prior
    gravity = np.asarray(tree.gravity, dtype=np.float64)
    ones = np.ones(tree.n)
    case = TorqueCase(
        tree, signals, bodies, gravity, ones, motion_known=prior is not None
    )
    if not case.usable_channels.any():
        return TorqueAssessment()
    sizes, verdict, rescaled = _scaled_verdict(case)
    before = _residual_shares(case, case.as_given)
    last = verdict.readings[-1] if verdict.readings else verdict.case.as_given
    after = _residual_shares(verdict.case, last)
    mapping = recording.metadata.mapping or {}
    remedies = remedies_for(
        tree, merge_hypotheses(verdict.hypotheses), before, after, mapping, tree.n
    )
    mapping_remedies = tuple(each for each in remedies if each.lines)
    assessment = TorqueAssessment((), mapping_remedies, sizes, verdict, before)
    diagnostics = [*_diagnostics(case, assessment, rescaled=rescaled)]
    if rescaled:
        diagnostics += check_torque_scales(tree, sizes, mapping, certain=True)
    return replace(assessment, diagnostics=tuple(diagnostics))


def _scaled_verdict(case: TorqueCase) -> tuple[Array, TorqueVerdict, bool]:
    """Torque scale factors, verdict, and True if torques were rescaled before the verdict.

    Torques are rescaled if they are not right as given and their median scale factor is outside the
    range from 1 / 2.5 to 2.5. The verdict on rescaled torques is returned if it is likelier, or if
    the first verdict explains nothing.
    """
    verdict, sizes = compare_readings(case), body_scale_factors(case)
    known = np.isfinite(sizes) & case.usable_channels
    median = float(np.median(sizes[known])) if known.any() else 1.0
    if (
        verdict.outcome == "as given"
        or 1 / MAX_TORQUE_SCALE < median < MAX_TORQUE_SCALE
    ):
        return _corrected_scale_factors(case, verdict), verdict, False
    sizes = np.where(known, sizes, median)
    spread = np.abs(np.log(sizes / median)).max()
    if (
        spread < np.log(MAX_TORQUE_SCALE) and not case.motion_known
    ):  # a common unit of all torques
        sizes = np.full(len(sizes), median)
    scaled_verdict = compare_readings(
        case_without_mistake(case, _rescaled_reading(case, sizes))
    )
    effective_count = (
        scaled_verdict.case.signals.valid.sum(axis=0) / scaled_verdict.case.inflation
    )
    density = (effective_count * np.log(sizes))[
        case.usable_channels
    ].sum()  # Jacobian of the rescaled torques
    best = max(
        (each.log_posterior for each in verdict.ranked_readings), default=-np.inf
    )
    is_likelier = (
        scaled_verdict.case.as_given.log_posterior
        + scaled_verdict.log_evidence_ratio
        - density
        > best
    )
    if scaled_verdict.outcome in ("as given", "explained") and (
        is_likelier or verdict.outcome == "not explained"
    ):
        return (
            sizes * _corrected_scale_factors(case, scaled_verdict),
            scaled_verdict,
            True,
        )
    return _corrected_scale_factors(case, verdict), verdict, False


def body_scale_factors(case: TorqueCase) -> Array:
    """Scale factors of torques relative to the prediction from the model file's bodies, (n,).

    They are fitted by least squares together with friction. A factor is nan if it is negative, or
    if the bodies explain less than 1 % of a torque's sum of squares or less than 5 times its
    residual.

    Args:
        case: Joint torques of a log, with robot and prior.
    """
    gram, moment = _scale_normal_equations(case)
    scale = np.sqrt(np.maximum(np.diagonal(gram, axis1=1, axis2=2), 1e-30))
    gram = gram / scale[:, :, None] / scale[:, None] + RIDGE * np.eye(gram.shape[1])
    values = np.linalg.solve(gram, (moment / scale)[..., None])[..., 0]
    information = 1 / np.linalg.inv(gram)[:, -1, -1]  # friction marginalised
    explained, square_sums = (
        information * values[:, -1] ** 2,
        case.products.square_sums(),
    )
    residual = square_sums - (values * (gram @ values[..., None])[..., 0]).sum(axis=1)
    significant = explained > np.maximum(
        MIN_EXPLAINED_SHARE * square_sums,
        MIN_RESIDUAL_RATIO * np.maximum(residual, 0.0),
    )
    sizes = values[:, -1] / scale[:, -1]
    return np.where(significant & (sizes > 0) & case.usable_channels, sizes, np.nan)


def _scale_normal_equations(case: TorqueCase) -> tuple[Array, Array]:
    """Normal equations of each of the C torques on friction and the model file's torque.

    Returns:
        Gram matrices, (C, 6, 6), and products with the torque, (C, 6), of viscous, dry, rotor,
        Stribeck and constant torque, and of the torque predicted from the model file.
    """
    products, count = case.products, case.products.shared_count
    columns = np.zeros((SCALED_COEFFICIENTS + 1, len(products.mean)))
    columns[:SCALED_COEFFICIENTS, count : count + SCALED_COEFFICIENTS] = np.eye(
        SCALED_COEFFICIENTS
    )
    columns[-1, :count] = products.mean[:count]
    inputs = products.products(case.gravity)
    shape = inputs.moment.shape
    fitted = [
        inputs.predicted_products(np.broadcast_to(each, shape)) for each in columns
    ]
    mean = inputs.predicted_products(np.broadcast_to(products.mean, shape))
    return np.stack(fitted, axis=1) @ columns.T, (inputs.moment + mean) @ columns.T


def _rescaled_reading(case: TorqueCase, sizes: Array) -> LogReading:
    """Interpretation of the log with rescaled torques."""
    joints = tuple(range(case.tree.n))
    hypothesis = Hypothesis("torque_size", joints, tuple(sizes.tolist()))
    return replace(case.as_given, hypotheses=(hypothesis,), kind="torque sizes")


def _corrected_scale_factors(case: TorqueCase, verdict: TorqueVerdict) -> Array:
    """Scale factors of the torques after the corrections of a verdict, (n,).

    They are taken from an accepted interpretation with torque scale factors, or else fitted by
    least squares.
    """
    for each in verdict.readings:
        if each.kind == "torque sizes":
            return np.array(each.hypotheses[0].values)
    corrected_case = verdict.case
    for each in verdict.readings:
        corrected_case = case_without_mistake(corrected_case, each)
    return body_scale_factors(corrected_case)


def _residual_shares(case: TorqueCase, reading: LogReading) -> Array:
    """Unexplained share of each torque's variance, (n,); zero for unusable channels."""
    torque = case.signals.torque
    counted = case.signals.valid
    square_sums = (counted * (torque - torque.mean(axis=0)) ** 2).sum(axis=0)
    residual = reading.evidence.residual_squares
    shares = np.minimum(residual / np.maximum(square_sums, 1e-12), 1.0)
    return np.asarray(shares * case.usable_channels)


def _diagnostics(
    case: TorqueCase, assessment: TorqueAssessment, *, rescaled: bool
) -> Iterator[Diagnostic]:
    """Yield the diagnostics of a verdict: accepted, ambiguous or unexplained interpretations.

    If the torques are right as given, the diagnostics are contradictory scale factors, and
    positions that the data do not determine (whose log evidence is at most 20 nats lower than that
    of the positions as given).
    """
    verdict, tree = assessment.verdict, case.tree
    assert verdict is not None
    if verdict.outcome == "explained":
        yield from _accepted_diagnostics(case, assessment, verdict, rescaled=rescaled)
    elif verdict.outcome == "not distinguished":
        readings = [_description(case, each) for each in verdict.equivalent_readings]
        yield make_diagnostic(
            "recording.ambiguous",
            "the torques",
            readings=", or ".join(readings),
        )
    elif verdict.outcome == "not explained":
        yield _unexplained_diagnostic(case, assessment, verdict)
    else:
        yield from () if rescaled else _contradiction_diagnostics(case, verdict)
        first = verdict.case.as_given.log_posterior
        undetermined = [
            each.hypotheses[0]
            for each in verdict.ranked_readings
            if each.hypotheses
            and each.hypotheses[0].kind in ("zero", "position_sign", "position_order")
            and each.evidence.log_evidence > first - MIN_EVIDENCE_RATIO
            and abs(each.evidence.log_evidence - first) > MIN_EFFECT
        ]
        yield from check_undetermined_positions(tree, undetermined)


def _accepted_diagnostics(
    case: TorqueCase,
    assessment: TorqueAssessment,
    verdict: TorqueVerdict,
    *,
    rescaled: bool,
) -> Iterator[Diagnostic]:
    """Yield diagnostics of accepted interpretations, with the corrected lines of the mapping.

    The order is: gravity, other errors of the mapping, springs, torque scale factors.
    """
    by_kind = {each.kind: each for each in verdict.readings}
    gravity = [each for each in assessment.remedies if each.kind == "gravity"]
    for remedy in gravity[-1:]:
        reading = next(
            each
            for each in verdict.readings[::-1]
            if any(h.kind == "gravity" for h in each.hypotheses)
        )
        yield make_diagnostic(
            "mapping.gravity",
            "gravity",
            float(np.rad2deg(reading.sigma.max(initial=0.0))),
            direction=gravity_description(reading),
            before=percentage(remedy.before),
            after=percentage(remedy.after),
            channel=remedy.channel,
            lines=mapping_advice(remedy.lines),
        )
    others = [each for each in assessment.remedies if each not in gravity]
    if others:
        equals = [_description(case, each) for each in verdict.equivalent_readings[1:]]
        yield wrong_mapping_diagnostic(
            case.tree, others, equals, verdict.log_evidence_ratio, certain=True
        )
    springs = [each for each in verdict.readings if each.kind == "spring"]
    if springs:
        joints = [
            case.tree.names[h.joints[0]] for each in springs for h in each.hypotheses
        ]
        yield make_diagnostic("torque.spring", f"the torque of {quoted_list(joints)}")
    if "torque sizes" in by_kind and not rescaled:
        sizes = _scale_factor_list(case, by_kind["torque sizes"])
        yield make_diagnostic("torque.factors", "the torques", sizes=sizes)


def gravity_description(reading: LogReading) -> str:
    """Description of the gravity in an interpretation, for messages.

    Args:
        reading: Interpretation of the log with another gravity.
    """
    size = float(np.linalg.norm(reading.gravity))
    if not size:
        return "not in the torques: they are compensated"
    if reading.kind == "part of gravity":
        return f"in the torques in part: {size:.3g} m/s^2"
    direction = reading.gravity / size
    names = [
        name
        for name, axis in GRAVITY_DIRECTIONS.items()
        if direction @ axis > EQUAL_DIRECTION_COSINE
    ]
    name = f", as of a robot on a {names[0]}" if names and names[0] != "level" else ""
    components = ", ".join(f"{each:.3f}" for each in direction)
    degrees = np.rad2deg(reading.sigma.max(initial=0.0))
    sigma = f" +- {degrees:.2f} deg" if 0 < degrees < MAX_DIRECTION_SIGMA else ""
    return f"along ({components}){sigma} in the base's frame{name}"


def _scale_factor_list(case: TorqueCase, reading: LogReading) -> str:
    """List of torque scale factors, relative to their geometric mean, with standard deviations."""
    known = np.isfinite(reading.sigma)
    sizes = np.array(reading.hypotheses[0].values)
    relative = sizes / np.exp(np.log(sizes[known]).mean())
    words = [
        f"{name} {size:.2f} +- {size * sigma:.2f}"
        for name, size, sigma in zip(
            case.tree.names, relative, reading.sigma, strict=True
        )
        if np.isfinite(sigma)
    ]
    return shortened_list(words, 160)


def _contradiction_diagnostics(
    case: TorqueCase, verdict: TorqueVerdict
) -> Iterator[Diagnostic]:
    """Yield the diagnostic of torque scale factors that differ significantly between joints."""
    for reading in verdict.ranked_readings:
        if reading.kind == "torque sizes" and has_contradictory_scales(reading):
            sizes = _scale_factor_list(case, reading)
            yield make_diagnostic("torque.contradiction", "the torques", sizes=sizes)


def _unexplained_diagnostic(
    case: TorqueCase, assessment: TorqueAssessment, verdict: TorqueVerdict
) -> Diagnostic:
    """Diagnostic of an unexplained log, with the likeliest rejected interpretations."""
    shares = assessment.unexplained
    worst = np.argsort(-shares)[:3]
    joints = [
        f"{percentage(shares[k])} at '{case.tree.names[k]}'"
        for k in worst
        if shares[k] > 1e-3
    ]
    attempts = {
        each.reading.kind: _description(case, each.reading)
        for each in verdict.rejected_readings
    }
    return make_diagnostic(
        "recording.unexplained",
        "the torques",
        float(shares.max(initial=0.0)),
        joints=shortened_list(joints),
        attempts="; ".join(attempts.values()),
    )


def _description(case: TorqueCase, reading: LogReading) -> str:
    """Description of an interpretation, for messages."""
    if not reading.hypotheses:
        return "nothing wrong"
    parts = []
    for each in reading.hypotheses:
        if each.kind == "gravity":
            parts.append(f"gravity {gravity_description(reading)}")
        elif each.kind == "delay":
            parts.append(f"torques with a delay of {1e3 * each.values[0]:.0f} ms")
        else:
            parts.append(hypothesis_description(case.tree, each))
    return " and ".join(parts)
