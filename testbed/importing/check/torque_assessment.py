"""What a log's torques say of its mapping and of gravity, in remedies and words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, diagnose
from testbed.core.base.errors import few, quoted
from testbed.core.recordings.channels import ChannelFault
from testbed.core.recordings.recording import Recording
from testbed.core.robot.tree import Tree
from testbed.importing.check.body_prior import BodyPrior, body_prior
from testbed.importing.check.gravity_readings import AXES
from testbed.importing.check.recording_diagnostics import (
    odd_sizes,
    share,
    undecided,
    wrong_mapping,
)
from testbed.importing.check.remedies import (
    Hypothesis,
    Remedy,
    in_words,
    merge,
    remedies_for,
)
from testbed.importing.check.torque_columns import contradictory
from testbed.importing.check.torque_products import SCALED
from testbed.importing.check.torque_readings import LogReading, TorqueCase
from testbed.importing.check.torque_signals import torque_signals
from testbed.importing.check.torque_verdict import (
    LARGEST,
    MARGIN,
    NEAR,
    TorqueVerdict,
    explain,
    without_mistake,
)
from testbed.importing.import_report import in_mapping

VAGUE = 30.0
"""Standard deviation of a direction that says nothing [deg]."""

NOTHING = 1e-3
"""Nats of a reading that changes nothing at all."""

CLEAR, TIMES, RIDGE = 0.01, 5.0, 1e-9
"""Part of a torque that bodies must explain for its size to be known, and times what is left; and
part of a column's square by which dependent ones are kept apart."""


@dataclass(frozen=True, eq=False)
class TorqueAssessment:
    """Diagnostics, remedies and scale factors from the torques of a log.

    Attributes:
        diagnostics: What is wrong, open, or not explained.
        remedies: What would make it right, to be applied together.
        sizes: Times what the model file's masses make, (n,); nan where that is not known.
        verdict: On the log; None where nothing can be judged.
        unexplained: Parts of the torques' variance that are left as given, (n,) or (0,).
    """

    diagnostics: tuple[Diagnostic, ...] = ()
    remedies: tuple[Remedy, ...] = ()
    sizes: Array = field(default_factory=lambda: np.zeros(0))
    verdict: TorqueVerdict | None = None
    unexplained: Array = field(default_factory=lambda: np.zeros(0))


def assess_torques(
    tree: Tree,
    recording: Recording,
    faults: Sequence[ChannelFault] = (),
    prior: BodyPrior | None = None,
) -> TorqueAssessment:
    """Check a log's mapping and gravity against its joint torques.

    Args:
        tree: The robot, under the gravity that the log states.
        recording: In the order of its joints.
        faults: Of its channels; their samples do not count.
        prior: Of its bodies by a force plate, beside which positions and gravity are known.
    """
    signals = torque_signals(recording, faults)
    if signals is None:
        return TorqueAssessment()
    bodies = body_prior(tree) if prior is None else prior
    gravity = np.asarray(tree.gravity, dtype=np.float64)
    ones = np.ones(tree.n)
    case = TorqueCase(tree, signals, bodies, gravity, ones, fixed=prior is not None)
    if not case.live.any():
        return TorqueAssessment()
    sizes, verdict, resized = _sized_verdict(case)
    before = _unexplained(case, case.as_given)
    last = verdict.readings[-1] if verdict.readings else verdict.case.as_given
    after = _unexplained(verdict.case, last)
    mapping = recording.metadata.mapping or {}
    remedies = remedies_for(
        tree, merge(verdict.hypotheses), before, after, mapping, tree.n
    )
    needed = tuple(each for each in remedies if each.lines)
    assessment = TorqueAssessment((), needed, sizes, verdict, before)
    words = [*_diagnostics(case, assessment, resized=resized)]
    if resized:
        words += odd_sizes(tree, sizes, mapping, certain=True)
    return replace(assessment, diagnostics=tuple(words))


def _sized_verdict(case: TorqueCase) -> tuple[Array, TorqueVerdict, bool]:
    """Torque scale factors, verdict, and whether torques were rescaled before."""
    given, sizes = explain(case), body_sizes(case)
    known = np.isfinite(sizes) & case.live
    middle = float(np.median(sizes[known])) if known.any() else 1.0
    if given.outcome == "as given" or 1 / LARGEST < middle < LARGEST:
        return _corrected_sizes(case, given), given, False
    sizes = np.where(known, sizes, middle)
    apart = np.abs(np.log(sizes / middle)).max()
    if apart < np.log(LARGEST) and not case.fixed:  # a unit that is common to all
        sizes = np.full(len(sizes), middle)
    sized = explain(without_mistake(case, _resized(case, sizes)))
    counted = sized.case.signals.counted.sum(axis=0) / sized.case.inflation
    density = (counted * np.log(sizes))[case.live].sum()  # of torques of another size
    best = max((each.log for each in given.ranked), default=-np.inf)
    likelier = sized.case.as_given.log + sized.nats - density > best
    if sized.outcome in ("as given", "explained") and (
        likelier or given.outcome == "not explained"
    ):
        return sizes * _corrected_sizes(case, sized), sized, True
    return _corrected_sizes(case, given), given, False


def body_sizes(case: TorqueCase) -> Array:
    """Scale factors of torques relative to the model file's bodies, (n,).

    By least squares beside friction; nan where bodies explain little of a torque.

    Args:
        case: The log.
    """
    gram, moment = _bodies_beside_friction(case)
    scale = np.sqrt(np.maximum(np.diagonal(gram, axis1=1, axis2=2), 1e-30))
    gram = gram / scale[:, :, None] / scale[:, None] + RIDGE * np.eye(gram.shape[1])
    values = np.linalg.solve(gram, (moment / scale)[..., None])[..., 0]
    own = 1 / np.linalg.inv(gram)[:, -1, -1]  # what no friction imitates
    explained, whole = own * values[:, -1] ** 2, case.products.whole()
    left = whole - (values * (gram @ values[..., None])[..., 0]).sum(axis=1)
    clear = explained > np.maximum(CLEAR * whole, TIMES * np.maximum(left, 0.0))
    sizes = values[:, -1] / scale[:, -1]
    return np.where(clear & (sizes > 0) & case.live, sizes, np.nan)


def _bodies_beside_friction(case: TorqueCase) -> tuple[Array, Array]:
    """Normal equations of each torque on friction and the model file's torque."""
    products, count = case.products, case.products.shared
    columns = np.zeros((SCALED + 1, len(products.mean)))
    columns[:SCALED, count : count + SCALED] = np.eye(SCALED)
    columns[-1, :count] = products.mean[:count]
    inputs = products.products(case.gravity)
    shape = inputs.moment.shape
    fitted = [inputs.times(np.broadcast_to(each, shape)) for each in columns]
    mean = inputs.times(np.broadcast_to(products.mean, shape))
    return np.stack(fitted, axis=1) @ columns.T, (inputs.moment + mean) @ columns.T


def _resized(case: TorqueCase, sizes: Array) -> LogReading:
    """Reading of the log with rescaled torques."""
    joints = tuple(range(case.tree.n))
    hypothesis = Hypothesis("torque_size", joints, tuple(sizes.tolist()))
    return replace(case.as_given, hypotheses=(hypothesis,), kind="torque sizes")


def _corrected_sizes(case: TorqueCase, verdict: TorqueVerdict) -> Array:
    """Scale factors of the torques corrected by a verdict, (n,)."""
    for each in verdict.readings:
        if each.kind == "torque sizes":
            return np.array(each.hypotheses[0].values)
    last = verdict.case
    for each in verdict.readings:
        last = without_mistake(last, each)
    return body_sizes(last)


def _unexplained(case: TorqueCase, reading: LogReading) -> Array:
    """Relative residual variance of each torque, (n,)."""
    torque = case.signals.torque
    counted = case.signals.counted
    whole = (counted * (torque - torque.mean(axis=0)) ** 2).sum(axis=0)
    left = reading.evidence.residual
    share_left = np.minimum(left / np.maximum(whole, 1e-12), 1.0)
    return np.asarray(share_left * case.live)


def _diagnostics(
    case: TorqueCase, assessment: TorqueAssessment, *, resized: bool
) -> Iterator[Diagnostic]:
    """Yield diagnostics of a verdict."""
    verdict, tree = assessment.verdict, case.tree
    assert verdict is not None
    if verdict.outcome == "explained":
        yield from _explained(case, assessment, verdict, resized=resized)
    elif verdict.outcome == "not distinguished":
        readings = [_words(case, each) for each in verdict.equals]
        yield diagnose(
            "recording.ambiguous",
            "the torques",
            readings=", or ".join(readings),
        )
    elif verdict.outcome == "not explained":
        yield _not_explained(case, assessment, verdict)
    else:
        yield from () if resized else _contradiction(case, verdict)
        first = verdict.case.as_given.log
        open_ones = [
            each.hypotheses[0]
            for each in verdict.ranked
            if each.hypotheses
            and each.hypotheses[0].kind in ("zero", "position_sign", "position_order")
            and each.evidence.log > first - MARGIN
            and abs(each.evidence.log - first) > NOTHING
        ]
        yield from undecided(tree, open_ones)


def _explained(
    case: TorqueCase,
    assessment: TorqueAssessment,
    verdict: TorqueVerdict,
    *,
    resized: bool,
) -> Iterator[Diagnostic]:
    """Yield diagnostics of accepted readings, with their remedies."""
    by_kind = {each.kind: each for each in verdict.readings}
    gravity = [each for each in assessment.remedies if each.kind == "gravity"]
    for remedy in gravity[-1:]:
        reading = next(
            each
            for each in verdict.readings[::-1]
            if any(h.kind == "gravity" for h in each.hypotheses)
        )
        yield diagnose(
            "mapping.gravity",
            "gravity",
            float(np.rad2deg(reading.sigma.max(initial=0.0))),
            direction=gravity_words(reading),
            before=share(remedy.before),
            after=share(remedy.after),
            channel=remedy.channel,
            lines=in_mapping(remedy.lines),
        )
    others = [each for each in assessment.remedies if each not in gravity]
    if others:
        equals = [_words(case, each) for each in verdict.equals[1:]]
        yield wrong_mapping(case.tree, others, equals, verdict.nats, certain=True)
    springs = [each for each in verdict.readings if each.kind == "spring"]
    if springs:
        joints = [
            case.tree.names[h.joints[0]] for each in springs for h in each.hypotheses
        ]
        yield diagnose("torque.spring", f"the torque of {quoted(joints)}")
    if "torque sizes" in by_kind and not resized:
        sizes = _factors(case, by_kind["torque sizes"])
        yield diagnose("torque.factors", "the torques", sizes=sizes)


def gravity_words(reading: LogReading) -> str:
    """Description of a reading's gravity for messages.

    Args:
        reading: Of gravity.
    """
    size = float(np.linalg.norm(reading.gravity))
    if not size:
        return "not in the torques: they are compensated"
    if reading.kind == "part of gravity":
        return f"in the torques in part: {size:.3g} m/s^2"
    direction = reading.gravity / size
    names = [name for name, axis in AXES.items() if direction @ axis > NEAR]
    name = f", as of a robot on a {names[0]}" if names and names[0] != "level" else ""
    along = ", ".join(f"{each:.3f}" for each in direction)
    degrees = np.rad2deg(reading.sigma.max(initial=0.0))
    sigma = f" +- {degrees:.2f} deg" if 0 < degrees < VAGUE else ""
    return f"along ({along}){sigma} in the base's frame{name}"


def _factors(case: TorqueCase, reading: LogReading) -> str:
    """List of relative torque scale factors with standard deviations."""
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
    return few(words, 160)


def _contradiction(case: TorqueCase, verdict: TorqueVerdict) -> Iterator[Diagnostic]:
    """Yield the diagnostic of inconsistent torque scale factors."""
    for reading in verdict.ranked:
        if reading.kind == "torque sizes" and contradictory(reading):
            sizes = _factors(case, reading)
            yield diagnose("torque.contradiction", "the torques", sizes=sizes)


def _not_explained(
    case: TorqueCase, assessment: TorqueAssessment, verdict: TorqueVerdict
) -> Diagnostic:
    """Diagnostic of an unexplained log, with the likeliest attempts."""
    left = assessment.unexplained
    worst = np.argsort(-left)[:3]
    joints = [
        f"{share(left[k])} at '{case.tree.names[k]}'" for k in worst if left[k] > 1e-3
    ]
    attempts = {
        each.reading.kind: _words(case, each.reading) for each in verdict.attempts
    }
    return diagnose(
        "recording.unexplained",
        "the torques",
        float(left.max(initial=0.0)),
        joints=few(joints),
        attempts="; ".join(attempts.values()),
    )


def _words(case: TorqueCase, reading: LogReading) -> str:
    """Description of a reading for messages."""
    if not reading.hypotheses:
        return "nothing wrong"
    parts = []
    for each in reading.hypotheses:
        if each.kind == "gravity":
            parts.append(f"gravity {gravity_words(reading)}")
        elif each.kind == "delay":
            parts.append(f"torques that are {1e3 * each.values[0]:.0f} ms late")
        else:
            parts.append(in_words(case.tree, each))
    return " and ".join(parts)
