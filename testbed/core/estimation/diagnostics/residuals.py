"""What residuals show: faults of the instrument, repetition, offsets, and noise of the encoders."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
from scipy import special

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, diagnose, ordered, phrase
from testbed.core.base.errors import few
from testbed.core.estimation.estimate import METHODS, Estimate
from testbed.core.estimation.noise.noise_model import NoiseModel
from testbed.core.estimation.regression.normal_equations import TINY
from testbed.core.estimation.sensor.encoders import (
    ECCENTRICITY,
    ENCODER_DELAYS,
    ENCODER_GAINS,
    JOINT_ZEROS,
    SAMPLING,
)
from testbed.core.estimation.sensor.estimates import TraceTest
from testbed.core.parameters.minimal_set import selection
from testbed.core.robot.shafts import shares

FALSE_ALARMS = 1e-6
"""Nominal probability of a diagnostic of a recording without any fault, all its tests together. It
is small since noise need not be what the model of it says: of poor encoders it grows with the
robot's inertia."""

FIRST_ORDER = 0.5
"""Largest offset of an encoder to be named [rad]: noise that wanders imitates larger ones, whose
columns the parameters nearly make up."""

FILTERED = 1e-5
"""Part of the largest signal that the filters may leave of a perfect recording."""

NAMED = 3
"""Most causes, and most numbers of a cause, that are named."""

OF_ENCODERS = (JOINT_ZEROS, ENCODER_GAINS, ENCODER_DELAYS, ECCENTRICITY, SAMPLING)
"""Faults that spoil estimates by torques as well."""

"""Least chance that has a number of standard deviations."""

LIKE_TILT = {"crosstalk", "gains", "pose"}
"""Kinds whose effects the weight on a plate that is not level resembles."""

SMALL_CHANCE = 1e-3
"""Probability below which what is found is not taken for chance."""

DRIFT = 0.5
"""Part of a recording over which the noise of a channel is correlated, and is a drift."""


def fault_diagnostics(estimate: Estimate) -> Iterator[Diagnostic]:
    """What the residuals hold that is no noise.

    Args:
        estimate: With its tests, the clearest first.
    """
    tests = estimate.trace_tests
    if not noisy(estimate):
        return
    clear = [t for t in tests if t.chance * len(tests) < FALSE_ALARMS and not _too_far(t)]
    if not clear:
        yield from _repetition(estimate)
        return
    best, kinds = clear[0], [test.nuisance.kind for test in clear[:NAMED]]
    yield diagnose(
        f"sensor.{best.nuisance.kind}",
        "the plate's residuals",
        best.shift,
        significance=float(-special.ndtri(max(best.chance / 2, TINY))),
        method="" if best.nuisance in OF_ENCODERS else "external",
        causes=[*kinds, *["level"] * bool(LIKE_TILT & {*kinds}), "unmodelled-load"],
        chance=chance_text(best.chance),
        cause=phrase(best.nuisance.kind),
        kind=best.nuisance.kind,
        size=", ".join(best.largest(NAMED)),
        parameter=best.parameter,
    )


def _too_far(test: TraceTest) -> bool:
    """Whether a wrong zero is so large that it is none: columns of it hold to first order."""
    one = test.alone if test.nuisance is JOINT_ZEROS else None
    return one is not None and one.unit == "rad" and abs(one.value) > FIRST_ORDER


def noisy(estimate: Estimate) -> bool:
    """Whether residuals are more than what the filter on positions takes from the motion.

    Args:
        estimate: Of either method.
    """
    rms = estimate.normal_equations.rms
    return bool(np.any(estimate.residual > FILTERED * rms.max(initial=0.0)))


def noise_diagnostics(estimate: Estimate) -> Iterator[Diagnostic]:
    """What offsets, slow noise and noise of the encoders do to an estimate.

    Args:
        estimate: With what its noise is like.
    """
    noise = estimate.noise
    if noise is None:
        return
    if noise.noise_limited:
        yield diagnose("encoder.noise", few(noise.noise_limited), method=estimate.method)
    if noise.steps_matter:
        steps = zip(estimate.joints, noise.least_counts, strict=True)
        coarse = few([f"'{name}' ({count:.3g} a step)" for name, count in steps if count])
        share = min(noise.by_counts, 1.0)
        yield diagnose("encoder.resolution", coarse, share, method=estimate.method)
    hidden, verb = ", ".join(noise.hidden), "is" if len(noise.hidden) == 1 else "are"
    if noise.bias_chance <= SMALL_CHANCE:
        constants = zip(
            estimate.channels, estimate.channel_units, noise.bias, noise.bias_sigma, strict=True
        )
        yield diagnose(
            "plate.offset",
            "the plate",
            method="external",
            constants=", ".join(
                f"{channel} {value:.3g} +- {sigma:.2g} {unit}"
                for channel, unit, value, sigma in constants
                if sigma > 0 and abs(value) > 2 * sigma
            ),
            hidden=hidden,
            verb=verb,
        )
    elif any(_slow(noise)) and noise.hidden:
        memories = zip(estimate.channels, noise.memory, _slow(noise), strict=True)
        slow = ", ".join(
            f"{channel} ({time:.2g} s)" for channel, time, is_slow in memories if is_slow
        )
        yield diagnose(
            "plate.drift", "the plate", method="external", channels=slow, hidden=hidden, verb=verb
        )


def zero_unknown(noise: NoiseModel | None) -> tuple[str, ...]:
    """Parameters that are not identifiable beside the plate's zero, where that is off or drifts.

    Args:
        noise: What the residuals are like.
    """
    if noise is None:
        return ()
    known = noise.bias_chance > SMALL_CHANCE and not any(_slow(noise))
    return () if known else noise.hidden


def chance_text(chance: float) -> str:
    """A probability as a person reads it."""
    return f"chance {chance:.0e}" if chance > 1e-99 else "chance below 1e-99"


def _slow(noise: NoiseModel) -> list[bool]:
    """Of each channel, whether it wanders so slowly that its constant rests on nothing."""
    return [memory > DRIFT * noise.span for memory in noise.memory]


def _repetition(estimate: Estimate) -> Iterator[Diagnostic]:
    """Residuals that repeat with the motion, for a cause that was not tested for."""
    noise = estimate.noise
    found = None if noise is None else noise.repetition
    if noise is None or found is None or found.chance > FALSE_ALARMS:
        return
    share, channel = max(zip(found.share, estimate.channels, strict=True))
    first = ["encoder-steps"] * noise.steps_matter
    yield diagnose(
        "estimate.repetition",
        "the plate's residuals",
        share,
        method="external",
        causes=[*first, "elastic", "hoses", "encoder-errors", "unmodelled-load"],
        period=found.period,
        chance=chance_text(found.chance),
        channel=channel,
    )


LEAST, MOST = 0.77, 1.3
"""Factors between which it is a torque constant that is wrong."""

OFF = 0.02
"""Part by which a factor differs from one without a word."""

SURE = 8.0
"""Sigmas within which it may be noise."""

CLEAR = 10.0
"""Times the unexplained rest of a torque, in power, that must follow the predicted one."""

KNOWN = 0.05
"""Relative error up to which the predicted torque is known well enough."""

APART = 1e-3
"""Part of the predicted torque, in power, that a rotor, friction or an offset cannot replace."""

UNITS = {
    1e3: "torques-in-n-mm",
    1e-3: "moments-in-n-mm",
    0.7376: "torques-in-lbf-ft",
    1.3558: "wrench-in-lbf-ft",
    4.4482: "wrench-in-lbf",
    0.2248: "torques-in-lbf",
    9.8067: "wrench-in-kgf",
    0.10197: "torques-in-kgf-m",
    180 / np.pi: "degrees",
}
"""What a factor may mean: codes of causes."""

ALIKE = 0.15
"""Relative difference up to which factors are the same."""


class Factor(NamedTuple):
    """Between a torque as it is reported and as it is predicted.

    Attributes:
        value: The factor.
        sigma: Its standard deviation: of noise in the torque, and of what is predicted at worst.
    """

    value: float
    sigma: float


def cross_check(external: Estimate, internal: Estimate) -> Iterator[Diagnostic]:
    """Joints whose torques are not what the plate's estimate predicts.

    A factor near one says something of the drive only where nothing is wrong with the plate.

    Args:
        external: From the plate.
        internal: From the torques of the same recording, with the same zeros and gravity.
    """
    try:
        s = selection(internal.minimal, external.minimal)
    except ValueError:  # not of one robot, gravity and list of zeros
        return
    known, spread = s @ external.base.values, s @ external.base.covariance @ s.T
    for joint, name in enumerate(internal.joints):
        factor, subject = torque_factor(internal, known, spread, joint), f"the torque of '{name}'"
        if factor is None:
            continue
        value, sigma = factor
        if not LEAST < value < MOST:
            units = [cause for unit, cause in UNITS.items() if abs(abs(value) / unit - 1) < ALIKE]
            causes = ["sign"] * (value < 0) + [*units, "motor-side", "exchanged"]
            yield diagnose("torque.scale", subject, value, sigma=sigma, causes=causes)
        elif not external.doubtful and abs(value - 1) > max(OFF, SURE * sigma):
            yield diagnose(
                "torque.constant",
                subject,
                value,
                sigma=sigma,
                significance=abs(value - 1) / max(sigma, TINY),
                method="internal",
            )


def diagnostics_of(estimates: Iterable[Estimate]) -> tuple[Diagnostic, ...]:
    """What estimates of one recording say of it, each alone and compared with each other.

    Args:
        estimates: By both methods or by one.
    """
    by_method = {estimate.method: estimate for estimate in estimates}
    found = [each for estimate in by_method.values() for each in estimate.diagnostics]
    if len(by_method) == len(METHODS):
        found += cross_check(by_method["external"], by_method["internal"])
    return ordered(found)


def torque_factor(internal: Estimate, known: Array, spread: Array, joint: int) -> Factor | None:
    """Factor between a joint's reported torque and the predicted one.

    Args:
        internal: From the torques.
        known: The dynamic minimal parameters from elsewhere, (N_d,).
        spread: Their covariance, (N_d, N_d).
        joint: Index of the joint.

    Returns:
        None where the joint's torque does not say: it is mostly friction, rotor or noise, or
        it is not predicted well.
    """
    normal, right, square = internal.normal_equations.of_channel(joint)
    count = internal.minimal.count
    own = [k for k, body in enumerate(internal.minimal.axial) if body == joint]
    if internal.drives is not None:
        turn = shares(internal.drives.tree)[:, joint]
        own += [count + k for k, term in enumerate(internal.drives.terms) if turn[term.joint]]
    predicted = np.zeros(len(right))
    predicted[:count] = known
    predicted[own] = 0.0  # a rotor may be part of it
    size = float(predicted @ normal @ predicted)
    among = normal[np.ix_(own, own)]
    shared = np.linalg.lstsq(among, normal[own] @ predicted, rcond=1e-12)[0]
    alone = size - float(predicted @ normal[own].T @ shared)  # what friction does not explain
    if alone <= APART * size:
        return None
    factor = (float(right @ predicted) - float(right[own] @ shared)) / alone
    theirs = float(right[own] @ np.linalg.lstsq(among, right[own], rcond=1e-12)[0])
    left = square - theirs - factor**2 * alone
    error = float(np.sum(normal[:count, :count] * spread))
    if factor**2 * alone <= CLEAR * left or error >= KNOWN**2 * alone:
        return None
    rows = max(float(internal.normal_equations.used[joint]), 1.0)
    return Factor(factor, float(np.sqrt((max(left, 0.0) / rows + error) / alone)))
