"""Feasible random motions about postures that a robot can hold, and the best of a few."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.errors import InfeasibleMotion
from testbed.core.dynamics.newton_euler import Motion
from testbed.core.dynamics.regressor import regressor
from testbed.core.parameters.minimal_set import MinimalSet
from testbed.core.parameters.symbols import barycentric, parameter_scale
from testbed.core.robot.tree import Tree, require_tree
from testbed.motion.clearance import CLEARANCE_UNIT, FAR, DistanceMeter
from testbed.motion.fourier import Fourier
from testbed.motion.limits import Limits, limits_of, motor_efforts
from testbed.motion.proof import Proof, Rules, prove, seems_to_hold
from testbed.motion.samples import SMALL, Computed


def rest_posture(rules: Rules) -> Array:
    """The posture of zeros where it keeps all limits at rest, else the best of random ones.

    Args:
        rules: Limits of efforts, plate and clearance.

    Returns:
        (n,) [rad or m]; where no posture keeps all limits, the one that exceeds them least.
    """
    postures = rules.limits.postures
    still = Computed(rules.tree, Motion.at_rest(postures))
    excess = np.full(len(postures), -np.inf)
    for term in rules.terms:
        excess = np.maximum(excess, term.values(still).max(axis=0))
    if rules.collision is not None:
        meter = DistanceMeter(rules.collision, rules.clearance + FAR)
        missing = rules.clearance - meter.measure(postures).values
        excess = np.maximum(excess, missing.max(axis=1) / CLEARANCE_UNIT)
    return rules.limits.home if excess[0] < 0 else postures[excess.argmin()]


def easiest_posture(tree: Tree, limits: Limits) -> Array:
    """The posture that asks least of its motors, of the zeros and random ones, (n,) [rad or m].

    Args:
        tree: The robot.
        limits: Of its joints.
    """
    postures = limits.postures
    share = np.abs(motor_efforts(tree, Motion.at_rest(postures))) / limits.effort
    return np.asarray(postures[share.max(axis=1).argmin()])


MARGIN = 0.95
"""Share of every limit that a motion may use: the rest is for the controller."""

_CHECK = 500, 20  # samples of a period, and of a harmonic, on which limits are checked
_SCORE = 100, 12  # the same on which a motion is scored

SHARES = (1.0, 0.8, 0.6, 0.4, 0.25, 0.15, 0.08, 0.04)
"""Of the swing of random motions, tried one after the other until one can be proven."""


@dataclass(frozen=True, eq=False)
class Draw:
    """A random series as it was drawn, and how large it may be for the limits on its motion.

    Attributes:
        motion: With the swing that the limits allow, about no posture.
        wish: Posture about which to swing if there is room, (n,) [rad or m].
        limits: What may be asked of the robot.
    """

    motion: Fourier
    wish: Array
    limits: Limits

    def sized(self, share: float) -> Fourier:
        """The motion with a share of its swing, as near to its wish as the limits allow."""
        middle, half = self.limits.middle, self.limits.half
        times = _times(self.motion, *_CHECK)
        swing = np.abs(self.motion.derivative(times, 0)).max(axis=0)
        # how far the offset may stray from the middle
        room = MARGIN * half - share * swing
        offset = np.clip(self.wish, middle - room, middle + room)
        sine, cosine = (share * part for part in (self.motion.sine, self.motion.cosine))
        return Fourier(self.motion.fundamental, offset, sine, cosine)


def sample(
    limits: Limits, fundamental: float, harmonics: int, rng: np.random.Generator
) -> Draw:
    """One random series, each joint scaled until its nearest limit.

    Args:
        limits: What may be asked of the robot.
        fundamental: Frequency at which the motion repeats [Hz].
        harmonics: Number of harmonics.
        rng: Source of randomness.
    """
    n, decay = len(limits.low), 1 / np.arange(1, harmonics + 1)
    sine, cosine = (rng.normal(size=(n, harmonics)) * decay for _ in range(2))
    wish = limits.middle + rng.uniform(-0.5, 0.5, n) * limits.half
    shape = Fourier(fundamental, np.zeros(n), sine, cosine)
    times = _times(shape, *_CHECK)
    largest = (limits.half, limits.velocity, limits.acceleration)
    room = [
        limit / np.abs(shape.derivative(times, order)).max(axis=0)
        for order, limit in enumerate(largest)
    ]
    size = MARGIN * np.min(room, axis=0)[:, None]
    return Draw(
        Fourier(fundamental, np.zeros(n), size * sine, size * cosine), wish, limits
    )


MORE, BATCHES = 20, 2
"""Random motions drawn once more, and how often, if none can be proven."""


def random_motion(
    tree: Tree,
    limits: Limits | None = None,
    fundamental: float = 0.1,
    harmonics: int = 5,
    seed: np.random.Generator | int = 0,
) -> Fourier:
    """One random Fourier motion, each joint scaled until its nearest limit.

    Where the motors hold the robot in none about a random posture, it is about the one that asks
    least of them. Nothing is proven of it: `testbed excite` does that.

    Args:
        tree: The robot, its inertias an a-priori model for the efforts.
        limits: What may be asked of it; default the model file's, completed by calm ones.
        fundamental: Frequency at which the motion repeats [Hz].
        harmonics: Number of harmonics.
        seed: Of the random numbers, or their source.

    Returns:
        The motion; `motion.at(times)` are its samples.

    Raises:
        InfeasibleMotion: Even slow motions exceed the efforts.
    """
    require_tree(tree, "random_motion(robot)")
    limits, rng = limits or limits_of(tree), np.random.default_rng(seed)
    draw = sample(limits, fundamental, harmonics, rng)
    motion, effort = _within_efforts(tree, draw)
    if motion is None:
        motion, effort = _within_efforts(
            tree, replace(draw, wish=easiest_posture(tree, limits))
        )
    if motion is not None:
        return motion
    tight = [
        f"{name} {share:.0%}"
        for name, share in zip(tree.names, effort, strict=True)
        if share > MARGIN
    ]
    raise InfeasibleMotion(
        f"no random motion keeps the motor efforts within their limits (slowest try: "
        f"{', '.join(tight)} of the limit); check the effort limits and masses in the model"
    )


def _within_efforts(tree: Tree, draw: Draw) -> tuple[Fourier | None, Array]:
    """The largest share of a motion that the motors can do, and shares of efforts that it takes."""
    motion = draw.motion
    times = _times(motion, *_CHECK)
    for share in 0.9 ** np.arange(30):
        motion = draw.sized(float(share))
        effort = (
            np.abs(motor_efforts(tree, motion.at(times))).max(axis=0)
            / draw.limits.effort
        )
        if (effort <= MARGIN).all():
            return motion, effort
    return None, effort


def best_motion(
    rules: Rules,
    minimal: MinimalSet,
    noise: Array,
    fundamental: float,
    harmonics: int,
    candidates: int,
    rng: np.random.Generator,
) -> tuple[Fourier, float]:
    """The proven candidate with the smallest predicted relative standard deviation.

    Candidates that cannot be proven are left out; if none is left, all swing less and less, and
    ever nearer to the posture of zeros, or to another where that keeps no limits.

    Args:
        rules: What a motion must respect.
        minimal: The reaction set to be identified.
        noise: Standard deviation of the plate's channels, (6,) [N, N m].
        fundamental: Frequency at which the motions repeat [Hz].
        harmonics: Number of harmonics.
        candidates: How many random motions to draw.
        rng: Source of randomness.

    Returns:
        The motion, and its score (`relative_sigma`).

    Raises:
        InfeasibleMotion: None can be proven, or even slow motions exceed the efforts.
    """
    tree, limits = rules.tree, rules.limits
    nearest: Proof | None = None
    rest: Array | None = None
    for count in (candidates, *((MORE,) * BATCHES)):
        sample = [
            random_motion(tree, limits, fundamental, harmonics, rng)
            for _ in range(count)
        ]
        scores = [relative_sigma(tree, motion, minimal, noise) for motion in sample]
        order = np.argsort(scores, kind="stable")
        for share, k in product(SHARES, order):
            motion = sample[k]
            if share < 1:
                rest = rest_posture(rules) if rest is None else rest
                motion = motion.scaled(share, rest)
            if not seems_to_hold(motion, rules):
                continue
            proof = prove(motion, rules)
            if proof.holds:
                same = share == 1
                return motion, scores[k] if same else relative_sigma(
                    tree, motion, minimal, noise
                )
            nearest = proof
    said = "" if nearest is None else f" (the last one: {nearest.worst.words})"
    raise InfeasibleMotion(
        f"none of {candidates + MORE * BATCHES} random motions keeps clear of the robot itself and "
        f"of what stands around it, however small{said}: give limits of the joints, or leave it "
        'out with excitation.clearance = "off"'
    )


NEARLY_AS_FAST = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5)
"""Of the speed of a motion, tried one after the other for another one."""

OTHERS = 20
"""Motions tried at each of them."""


def as_fast(motion: Fourier, rules: Rules, rng: np.random.Generator) -> Fourier:
    """A motion with the amplitudes of another one and other phases, proven.

    Over a period rms velocities and accelerations of every joint are those of that one, or a share
    of them, at least a half, where limits ask for it.

    Args:
        motion: The other motion.
        rules: What both respect.
        rng: Source of phases.

    Raises:
        InfeasibleMotion: None that is half as fast respects all limits.
    """
    for share, _ in product(NEARLY_AS_FAST, range(OTHERS)):
        other = motion.rephased(rng).scaled(share, motion.offset)
        if seems_to_hold(other, rules) and prove(other, rules).holds:
            return other
    raise InfeasibleMotion(
        "no other motion that is half as fast as it respects all limits"
    )


def relative_sigma(
    tree: Tree, motion: Fourier, minimal: MinimalSet, noise: Array
) -> float:
    """Predicted rms of sigma_i / |delta_i| for a hundred samples a period.

    Infinite if the motion leaves a parameter unseen.
    """
    times = _times(motion, *_SCORE)
    phi = regressor(tree, motion.at(times), minimal) / noise[:, None]
    scale = parameter_scale(minimal.values(barycentric(tree)), minimal.units, SMALL)
    scaled = phi.reshape(-1, minimal.count) * scale
    spread = np.linalg.svd(scaled, compute_uv=False)
    if spread[-1] <= 1e-12 * spread[0]:
        return float("inf")
    return float(np.sqrt(np.mean(1 / spread**2) * len(times) / _SCORE[0]))


def _times(motion: Fourier, least: int, a_harmonic: int) -> Array:
    """Instants of a period: so many, and so many a harmonic [s]."""
    count = max(least, a_harmonic * motion.harmonics)
    return np.linspace(0, motion.period, count, endpoint=False)
