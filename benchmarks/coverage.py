"""How often intervals of 95 % hold the truth, under white and coloured noise.

Motions are random ones, inside the robot's limits; signals are those of rigid bodies with dry
and viscous friction, simulated where the joints' torques are asked for. Every seed is another
motion and other noise.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import testbed as tb
from testbed.arrays import Array
from testbed.excitation.limits import limits_of
from testbed.excitation.random_motion import random_motion
from testbed.identification.estimate import Estimate, Method
from testbed.instruments.chain import Instrument, measure
from testbed.recordings.recording import Recording, Truth

ROOT = Path(__file__).parent.parent
ROBOTS: Mapping[str, Path] = {"puma": ROOT / "models/puma562.xml"} | {
    name: ROOT / f"tests/golden/robots/{name}.urdf"
    for name in ("ur5", "gantry_ppp_rrr", "stanford", "kuka_lwr4")
}
SPEEDS: Mapping[str, float | None] = {"default": None, "slow": 0.3}
"""Greatest joint speed [rad/s or m/s]; None for the robot's own."""

PLATE = Instrument(
    encoder_resolution=1e-4,
    encoder_noise=1e-4,
    force_noise=0.5,
    moment_noise=0.1,
    torque_noise=0.5,
)
"""The instrument of table6, its torque constants exact."""

RATE = 1000.0
NORMAL = 1.96

Noise = Callable[[np.random.Generator, tuple[int, int]], Array]


@dataclass(frozen=True)
class Study:
    """What is repeated.

    Attributes:
        robot: One of ROBOTS.
        motion: One of SPEEDS.
        noise: One of NOISES: the plate's; joints' torques have white noise always.
        method: Whose sigmas.
        seconds: Duration of every recording.
        settings: Of the identification.
    """

    robot: str
    motion: str
    noise: str
    method: Method
    seconds: float
    settings: tb.Settings


def coverage(study: Study, first: int, runs: int) -> dict[str, Any]:
    """Shares of 95 % intervals that hold the truth, and errors.

    Args:
        study: What is repeated.
        first: The first seed.
        runs: How many.
    """
    tree = tb.load_tree(ROBOTS[study.robot])
    scores, errors, taken = [], [], 0.0
    names: tuple[str, ...] = ()
    for seed in range(first, first + runs):
        recording = recorded(tree, study, seed)
        start = time.process_time()
        estimate = tb.identify(tree, recording, study.method, settings=study.settings)
        taken += time.process_time() - start
        truth = truth_of(tree, estimate)
        scores.append((estimate.values - truth) / estimate.sigma)
        errors.append((estimate.values - truth) / truth)
        names = estimate.names
        if sys.stderr.isatty():
            print(f"\r{seed - first + 1} of {runs}", end="", file=sys.stderr)
    inside = np.abs(scores) < NORMAL
    mass = np.array([name.startswith("mbar") for name in names])
    each = inside.mean(axis=0)
    kept = each[~mass]
    bodies = estimate.minimal.count
    line: dict[str, Any] = {
        "robot": study.robot,
        "motion": study.motion,
        "noise": study.noise,
        "method": study.method,
        "seconds": study.seconds,
        "runs": runs,
        "seeds": f"{first} to {first + runs - 1}",
        "coverage": _share(kept.mean()),
        "bound": _share(2 * inside[:, ~mass].mean(axis=1).std(ddof=1) / np.sqrt(runs)),
        "worst": _share(kept.min()),
        "worst_parameter": np.array(names)[~mass][kept.argmin()],
        "total_mass": _share(each[mass].mean()) if mass.any() else None,
        "rms_z": _share(float(np.sqrt(np.mean(np.square(scores))))),
        "error_of_nine": float(f"{np.sqrt(np.mean(np.square(errors)[:, :9])):.3g}"),
        "cpu_seconds": round(taken / runs, 2),
    }
    if study.method == "internal":
        line |= {"bodies": _share(each[:bodies].mean()), "friction": _share(each[bodies:].mean())}
    return line


def recorded(tree: tb.Tree, study: Study, seed: int) -> Recording:
    """A recording of a motion of its own."""
    time, truth, tare, facts = _happened(tree, study, seed)
    quiet = study.noise != "white"
    plate = replace(PLATE, force_noise=0.05, moment_noise=0.01) if quiet else PLATE
    recording = measure(plate, tree.names, time, truth, tare, facts, seed)
    if quiet:
        rng = np.random.default_rng([seed, 1])
        coloured = NOISES[study.noise](rng, (len(time), 6)) * np.repeat([0.5, 0.1], 3)
        recording = replace(recording, wrench=recording.measured("wrench") + coloured)
    return recording.blind()


def truth_of(tree: tb.Tree, estimate: Estimate) -> Array:
    """The true values of what was estimated."""
    theta, drives = tb.barycentric(tree), estimate.drives
    return estimate.minimal.values(theta) if drives is None else drives.values(theta, tree)


def _happened(tree: tb.Tree, study: Study, seed: int) -> tuple[Array, Truth, Array, dict[str, Any]]:
    """The truth: for the plate by rigid bodies alone, for the drives simulated with friction."""
    speed = SPEEDS[study.motion]
    if study.method == "internal":
        settings = [f"seed={seed}", f"motion.duration={study.seconds}", "motion.candidates=1"]
        if speed is not None:
            listed = ",".join(f'"{name}"={speed}' for name in tree.names)
            settings.append(f"motion.max_velocity={{{listed}}}")
        experiment = tb.Experiment.load(ROOT / "experiments/table6.toml", settings)
        changed = {"model": str(ROBOTS[study.robot]), "measurement": Instrument()}
        found = tb.simulate(experiment.model_copy(update=changed))
        assert found.truth is not None
        assert found.tare is not None
        return found.time, found.truth, found.tare, dict(found.facts)
    limits = limits_of(tree, {} if speed is None else dict.fromkeys(tree.names, speed), {})
    fourier = random_motion(tree, limits, 0.1, 5, np.random.default_rng(seed))
    motion = fourier.at(np.arange(0, study.seconds, 1 / RATE))
    tare = tb.pedestal_wrench(tree)
    still = np.zeros_like(motion.q)
    torque, wrench = tb.joint_forces(tree, motion), tb.base_wrench(tree, motion) + tare
    truth = Truth(motion.q, motion.qd, motion.qdd, torque, still, wrench)
    return motion.t, truth, tare, {}


def autoregressive(memory: float) -> Noise:
    """Noise of unit variance that fades to 1/e within a time [s]."""

    def noise(rng: np.random.Generator, shape: tuple[int, int]) -> Array:
        from scipy.signal import lfilter

        a = np.exp(-1 / (memory * RATE))
        before = int(10 * memory * RATE)
        white = rng.normal(size=(shape[0] + before, shape[1])) * np.sqrt(1 - a * a)
        return np.asarray(lfilter([1.0], [1.0, -a], white, axis=0)[before:])

    return noise


def pink(rng: np.random.Generator, shape: tuple[int, int]) -> Array:
    """Noise of unit variance whose power falls with frequency, flat below 0.02 Hz."""
    count = 2 * shape[0]
    frequency = np.fft.rfftfreq(count, 1 / RATE)
    gain = 1 / np.sqrt(np.maximum(frequency, 0.02))
    spectrum = np.fft.rfft(rng.normal(size=(count, shape[1])), axis=0)
    shaped = np.fft.irfft(spectrum * gain[:, None], count, axis=0)[: shape[0]]
    return np.asarray(shaped / np.sqrt(np.mean(gain**2)))


NOISES: Mapping[str, Noise] = {
    "white": lambda rng, shape: rng.normal(size=shape),
    "ar .3 s": autoregressive(0.3),
    "ar 3 s": autoregressive(3.0),
    "pink": pink,
}
"""Of the plate, beside a tenth of its white noise."""


def studies(settings: tb.Settings, seconds: float) -> Iterator[Study]:
    """All that docs/uncertainty.md shows."""
    zeros = replace(settings, zeros=True)
    for motion in SPEEDS:
        for noise in NOISES:
            yield Study("puma", motion, noise, "external", seconds, zeros)
    for noise in ("white", "ar .3 s"):
        yield Study("ur5", "default", noise, "external", seconds, settings)
    for motion in SPEEDS:
        yield Study("puma", motion, "white", "internal", seconds, zeros)


def _share(value: float) -> float:
    return round(float(value), 3)
