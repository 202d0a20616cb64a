"""Random motions within the limits, and the proven motion with the best prediction."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.errors import NoFeasibleMotion
from testbed.core.dynamics.newton_euler import Motion
from testbed.core.dynamics.regressor import regressor
from testbed.core.parameters.minimal_set import MinimalSet
from testbed.core.parameters.symbols import barycentric, parameter_scale
from testbed.core.robot.tree import Tree, require_tree
from testbed.motion.clearance import CLEARANCE_UNIT, MAX_DISTANCE, DistanceMeter
from testbed.motion.fourier import Fourier
from testbed.motion.limits import Limits, joint_limits, motor_efforts
from testbed.motion.proof import (
    MotionConstraints,
    Proof,
    prove,
    respects_limits_at_samples,
)
from testbed.motion.samples import MIN_RELATIVE_SCALE, NewtonEulerForces


def rest_posture(rules: MotionConstraints) -> Array:
    """Home posture if feasible at rest, otherwise the most feasible random posture.

    The limits considered are those of motor efforts, force plate, force sensors and clearances. The
    most feasible posture is that of `Limits.postures` with the smallest normalised excess.

    Args:
        rules: Limits of the motion.

    Returns:
        Joint positions, (n,) [rad or m].
    """
    postures = rules.limits.postures
    rest = NewtonEulerForces(rules.tree, Motion.at_rest(postures))
    excess = np.full(len(postures), -np.inf)
    for term in rules.force_limits:
        excess = np.maximum(excess, term.values(rest).max(axis=0))
    if rules.collision is not None:
        meter = DistanceMeter(rules.collision, rules.clearance + MAX_DISTANCE)
        missing = rules.clearance - meter.measure(postures).values
        excess = np.maximum(excess, missing.max(axis=1) / CLEARANCE_UNIT)
    return rules.limits.home if excess[0] < 0 else postures[excess.argmin()]


def least_effort_posture(tree: Tree, limits: Limits) -> Array:
    """Posture with the smallest ratio of motor effort at rest to limit, (n,) [rad or m].

    The ratio of a posture is the largest of all joints. Candidates are the home posture and random
    postures.

    Args:
        tree: The robot.
        limits: Limits of the joints.
    """
    postures = limits.postures
    share = np.abs(motor_efforts(tree, Motion.at_rest(postures))) / limits.effort
    return np.asarray(postures[share.max(axis=1).argmin()])


USABLE_SHARE = 0.95
"""Usable fraction of every limit; the rest is reserved for the controller."""

_LIMIT_SAMPLES = (
    500,
    20,
)  # smallest number of samples, and samples per harmonic, for checks of limits
_SCORE_SAMPLES = 100, 12  # the same for scores

AMPLITUDE_SHARES = (1.0, 0.8, 0.6, 0.4, 0.25, 0.15, 0.08, 0.04)
"""Amplitude factors of random motions, tried in turn until a motion is proven."""


@dataclass(frozen=True, eq=False)
class RandomSeries:
    """Random Fourier series with the largest amplitudes that the joint limits allow.

    Attributes:
        motion: Series with zero offset.
        preferred_offset: Preferred offset, (n,) [rad or m].
        limits: Limits of the joints.
    """

    motion: Fourier
    preferred_offset: Array
    limits: Limits

    def sized(self, share: float) -> Fourier:
        """Motion with scaled amplitudes, and an offset that respects the position limits.

        The offset is as near to `preferred_offset` as USABLE_SHARE of the position ranges allows.

        Args:
            share: Amplitude factor.
        """
        middle, half = self.limits.middle, self.limits.half
        times = _period_times(self.motion, *_LIMIT_SAMPLES)
        amplitude = np.abs(self.motion.derivative(times, 0)).max(axis=0)
        # largest distance of the offset from the middle
        offset_range = USABLE_SHARE * half - share * amplitude
        offset = np.clip(
            self.preferred_offset, middle - offset_range, middle + offset_range
        )
        sine, cosine = (
            share * coefficients
            for coefficients in (self.motion.sine, self.motion.cosine)
        )
        return Fourier(self.motion.fundamental, offset, sine, cosine)


def draw_random_series(
    limits: Limits, fundamental: float, harmonics: int, rng: np.random.Generator
) -> RandomSeries:
    """Draw a random Fourier series, with each joint scaled to its most restrictive limit.

    Coefficients of harmonic k are normally distributed with standard deviation 1/k before scaling
    to USABLE_SHARE of the limits; offsets are uniform in the middle half of the position range.

    Args:
        limits: Limits of the joints.
        fundamental: Fundamental frequency [Hz].
        harmonics: Number of harmonics.
        rng: Random generator.
    """
    n, decay = len(limits.low), 1 / np.arange(1, harmonics + 1)
    sine, cosine = (rng.normal(size=(n, harmonics)) * decay for _ in range(2))
    preferred_offset = limits.middle + rng.uniform(-0.5, 0.5, n) * limits.half
    unscaled = Fourier(fundamental, np.zeros(n), sine, cosine)
    times = _period_times(unscaled, *_LIMIT_SAMPLES)
    bounds = (limits.half, limits.velocity, limits.acceleration)
    scale_factors = [
        limit / np.abs(unscaled.derivative(times, order)).max(axis=0)
        for order, limit in enumerate(bounds)
    ]
    scale = USABLE_SHARE * np.min(scale_factors, axis=0)[:, None]
    return RandomSeries(
        Fourier(fundamental, np.zeros(n), scale * sine, scale * cosine),
        preferred_offset,
        limits,
    )


EXTRA_CANDIDATES, MAX_EXTRA_BATCHES = 20, 2
"""Number of additional candidates per batch, and largest number of batches, if no candidate is
proven."""


def random_motion(
    tree: Tree,
    limits: Limits | None = None,
    fundamental: float = 0.1,
    harmonics: int = 5,
    seed: np.random.Generator | int = 0,
) -> Fourier:
    """Draw a random Fourier motion, with each joint scaled to its most restrictive limit.

    Amplitudes are reduced until the motor efforts are within USABLE_SHARE of their limits, first
    about a random posture and, if no amplitude suffices there, about the posture with the smallest
    efforts. The limits are checked at samples only; `testbed excite` proves them.

    Args:
        tree: The robot, with a-priori inertias for the efforts.
        limits: Limits of the joints; by default the limits of the model file, completed by default
            limits.
        fundamental: Fundamental frequency [Hz].
        harmonics: Number of harmonics.
        seed: Seed of the random numbers, or a random generator.

    Returns:
        Motion; `motion.at(times)` returns its samples.

    Raises:
        NoFeasibleMotion: Even slow motions exceed the effort limits.
    """
    require_tree(tree, "random_motion(robot)")
    limits, rng = limits or joint_limits(tree), np.random.default_rng(seed)
    series = draw_random_series(limits, fundamental, harmonics, rng)
    motion, effort_shares = _within_efforts(tree, series)
    if motion is None:
        motion, effort_shares = _within_efforts(
            tree, replace(series, preferred_offset=least_effort_posture(tree, limits))
        )
    if motion is not None:
        return motion
    exceeded = [
        f"{name} {share:.0%}"
        for name, share in zip(tree.names, effort_shares, strict=True)
        if share > USABLE_SHARE
    ]
    raise NoFeasibleMotion(
        f"no random motion keeps the motor efforts within their limits (slowest try: "
        f"{', '.join(exceeded)} of the limit); check the effort limits and masses in the model"
    )


def _within_efforts(tree: Tree, series: RandomSeries) -> tuple[Fourier | None, Array]:
    """Largest motion of a series within the effort limits, and relative efforts, (n,).

    Relative efforts are ratios of peak efforts to limits. If all motions exceed USABLE_SHARE of the
    limits, the result is None, with the relative efforts of the smallest motion.

    Args:
        tree: The robot.
        series: Random series.
    """
    motion = series.motion
    times = _period_times(motion, *_LIMIT_SAMPLES)
    for share in 0.9 ** np.arange(30):
        motion = series.sized(float(share))
        effort_shares = (
            np.abs(motor_efforts(tree, motion.at(times))).max(axis=0)
            / series.limits.effort
        )
        if (effort_shares <= USABLE_SHARE).all():
            return motion, effort_shares
    return None, effort_shares


def best_random_motion(
    rules: MotionConstraints,
    minimal: MinimalSet,
    noise: Array,
    fundamental: float,
    harmonics: int,
    candidates: int,
    rng: np.random.Generator,
) -> tuple[Fourier, float]:
    """Proven random motion with the smallest predicted relative standard deviation.

    The first proven candidate in the order of predicted standard deviations is taken. If no
    candidate is proven, amplitudes are reduced towards the rest posture by AMPLITUDE_SHARES, then
    up to MAX_EXTRA_BATCHES batches of candidates are added.

    Args:
        rules: Limits of the motion.
        minimal: Base parameters of the wrench to be identified.
        noise: Standard deviation of the plate's channels, (6,) [N, N m].
        fundamental: Fundamental frequency [Hz].
        harmonics: Number of harmonics.
        candidates: Number of random motions.
        rng: Random generator.

    Returns:
        Motion, and its score (`relative_sigma`).

    Raises:
        NoFeasibleMotion: No motion is proven, or even slow motions exceed the effort limits.
    """
    tree, limits = rules.tree, rules.limits
    last_proof: Proof | None = None
    centre: Array | None = None
    for count in (candidates, *((EXTRA_CANDIDATES,) * MAX_EXTRA_BATCHES)):
        motions = [
            random_motion(tree, limits, fundamental, harmonics, rng)
            for _ in range(count)
        ]
        scores = [relative_sigma(tree, motion, minimal, noise) for motion in motions]
        order = np.argsort(scores, kind="stable")
        for share, k in product(AMPLITUDE_SHARES, order):
            motion = motions[k]
            if share < 1:
                centre = rest_posture(rules) if centre is None else centre
                motion = motion.scaled(share, centre)
            if not respects_limits_at_samples(motion, rules):
                continue
            proof = prove(motion, rules)
            if proof.is_valid:
                is_unscaled = share == 1
                return motion, scores[k] if is_unscaled else relative_sigma(
                    tree, motion, minimal, noise
                )
            last_proof = proof
    note = (
        ""
        if last_proof is None
        else f" (the last one: {last_proof.smallest_margin.words})"
    )
    raise NoFeasibleMotion(
        f"none of {candidates + EXTRA_CANDIDATES * MAX_EXTRA_BATCHES} random motions keeps "
        "clear of the robot itself and "
        f"of what stands around it, however small{note}: give limits of the joints, or leave it "
        'out with excitation.clearance = "off"'
    )


SPEED_SHARES = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5)
"""Speed factors of an equally fast motion, tried in turn."""

TRIALS_PER_SHARE = 20
"""Number of random phases tried for each speed factor."""


def equally_fast_motion(
    motion: Fourier, rules: MotionConstraints, rng: np.random.Generator
) -> Fourier:
    """Proven motion with the amplitudes of a given motion and random phases.

    The rms velocities and accelerations of every joint over a period equal those of the given
    motion. If the limits require it, they are reduced by a common factor of SPEED_SHARES, at least
    0.5.

    Args:
        motion: Given motion.
        rules: Limits of both motions.
        rng: Random generator of the phases.

    Raises:
        NoFeasibleMotion: No motion with at least half the speed respects all limits.
    """
    for share, _ in product(SPEED_SHARES, range(TRIALS_PER_SHARE)):
        other = motion.rephased(rng).scaled(share, motion.offset)
        if respects_limits_at_samples(other, rules) and prove(other, rules).is_valid:
            return other
    raise NoFeasibleMotion(
        "no other motion that is half as fast as it respects all limits"
    )


def relative_sigma(
    tree: Tree, motion: Fourier, minimal: MinimalSet, noise: Array
) -> float:
    """Predicted rms relative standard deviation of the base parameters for 100 samples per period.

    Standard deviations are relative to the a-priori base parameters, where small parameters are
    raised (`parameter_scale`). The result is infinite if the motion does not identify all
    parameters.

    Args:
        tree: The robot, with a-priori inertias.
        motion: Periodic motion.
        minimal: Base parameters of the wrench.
        noise: Standard deviation of the plate's channels, (6,) [N, N m].
    """
    times = _period_times(motion, *_SCORE_SAMPLES)
    phi = regressor(tree, motion.at(times), minimal) / noise[:, None]
    scale = parameter_scale(
        minimal.values(barycentric(tree)), minimal.units, MIN_RELATIVE_SCALE
    )
    scaled = phi.reshape(-1, minimal.count) * scale
    singular_values = np.linalg.svd(scaled, compute_uv=False)
    if singular_values[-1] <= 1e-12 * singular_values[0]:
        return float("inf")
    return float(
        np.sqrt(np.mean(1 / singular_values**2) * len(times) / _SCORE_SAMPLES[0])
    )


def _period_times(
    motion: Fourier, min_samples: int, samples_per_harmonic: int
) -> Array:
    """Evenly spaced times of a period from 0 [s].

    Args:
        motion: Periodic motion.
        min_samples: Smallest number of samples.
        samples_per_harmonic: Smallest number of samples per harmonic.
    """
    count = max(min_samples, samples_per_harmonic * motion.harmonics)
    return np.linspace(0, motion.period, count, endpoint=False)
