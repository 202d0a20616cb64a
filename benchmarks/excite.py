"""What designed motions gain over random ones that obey the same limits, and what they cost.

The random ones are scaled like those of an experiment and swing less until they are proven.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import testbed as tb
from testbed.core.base.errors import InfeasibleMotion
from testbed.core.kernel.numba_engine import warm_up
from testbed.lab.experiment.evaluate import model_of, robot_of
from testbed.lab.experiment.excite import excite, wish_of
from testbed.lab.simulation.plant import build_plant
from testbed.lab.simulation.rollout import Sampling, simulate_motion
from testbed.motion.clearance import DistanceMeter
from testbed.motion.design import Wish, criterion, design
from testbed.motion.fourier import Fourier
from testbed.motion.limits import motor_efforts
from testbed.motion.proof import Rules, prove, seems_to_hold
from testbed.motion.random_motion import random_motion

ROOT = Path(__file__).parents[1]
PUMA = ROOT / "models/puma562.xml"
SEVEN = ROOT / "tests/golden/robots/kuka_lwr4.urdf"
SHARES = 0.95 ** np.arange(60)
"""Of the swing of random motions, until one is proven."""

LOOP_STEP = 1e-3
"""Of simulations in closed loop [s]."""

PLATE = ("measurement.force_noise=0.5", "measurement.moment_noise=0.1", "motion.duration=10")


@dataclass(frozen=True)
class Case:
    """A robot, and whether it keeps clear."""

    name: str
    model: Path
    settings: tuple[str, ...]


def cases(models: list[Path]) -> Iterator[Case]:
    """The PUMA without and with clearance, a seven-axis arm, and what else is named."""
    zeros = "identification.zeros=true"
    yield Case("puma562", PUMA, (zeros, "excitation.clearance=off"))
    yield Case("puma562, clear", PUMA, (zeros, "excitation.starts=4"))
    yield Case("kuka_lwr4", SEVEN, ("excitation.starts=2",))
    for model in models:
        yield Case(model.stem, model, ("excitation.starts=2",))


def gain(case: Case, seeds: int, baseline: int) -> dict[str, Any]:
    """How many times smaller the relative sigma is than the median of random motions.

    Args:
        case: The robot.
        seeds: Designs.
        baseline: Random motions.
    """
    warm_up()
    gains, seconds = [], []
    experiment = tb.Experiment.of_model(case.model, [*PLATE, *case.settings])
    wish = wish_of(experiment, robot_of(experiment))
    random = float(np.median([criterion(wish, motion) for motion in allowed(wish, baseline)]))
    for seed in range(seeds):
        start = time.process_time()
        found = design(wish_of(experiment.model_copy(update={"seed": seed}), wish.rules.tree))
        seconds.append(time.process_time() - start)
        gains.append(float(np.exp((random - found.value) / 2)))
    return {
        "robot": case.name,
        "joints": wish.rules.tree.n,
        "seeds": seeds,
        "random": baseline,
        "gain": round(float(np.median(gains)), 2),
        "least": round(min(gains), 2),
        "cpu_seconds": round(float(np.median(seconds)), 1),
    }


def allowed(wish: Wish, count: int) -> list[Fourier]:
    """Random motions of 5 harmonics of 0.1 Hz that are proven."""
    rules, rng = wish.rules, np.random.default_rng(1996)
    found: list[Fourier] = []
    while len(found) < count:
        motion = random_motion(rules.tree, rules.limits, 0.1, 5, rng)
        smaller = (motion.scaled(float(share), motion.offset) for share in SHARES)
        good = (m for m in smaller if seems_to_hold(m, rules) and prove(m, rules).holds)
        kept = next(good, None)
        found += [] if kept is None else [kept]
    return found


def promises(seeds: int, seconds: float) -> dict[str, Any]:
    """Obtained over predicted sigma: errors of simulated runs against what was promised.

    Args:
        seeds: Of noise, each a run of the same motion.
        seconds: Of each run.
    """
    from tempfile import TemporaryDirectory

    from testbed.lab.experiment.excite import write_motion

    settings = [*PLATE, "identification.zeros=true", "excitation.starts=2"]
    settings += [f"motion.duration={seconds}", "excitation.clearance=off"]
    found = excite(tb.Experiment.of_model(PUMA, settings))
    truth = tb.minimal_set(found.tree, "reaction", zeros=True).values(tb.barycentric(found.tree))
    errors = []
    with TemporaryDirectory() as folder:
        file = Path(folder) / "motion.toml"
        write_motion(file, found)
        for seed in range(seeds):
            run = tb.Experiment.of_model(PUMA, [*settings, f'motion.file="{file}"', f"seed={seed}"])
            estimate = tb.identify(
                found.tree, tb.simulate(run), "external", settings=run.identification
            )
            errors.append(estimate.values - truth)
    ratio = np.sqrt(np.mean(np.square(errors), axis=0)) / found.predicted.sigma
    return {
        "robot": "puma562",
        "seeds": seeds,
        "seconds": seconds,
        "obtained_over_predicted": round(float(np.sqrt(np.mean(ratio**2))), 3),
        "least": round(float(ratio.min()), 2),
        "largest": round(float(ratio.max()), 2),
    }


def limit_sets(model: Path, count: int) -> dict[str, Any]:
    """Designs under random limits: proven, and nowhere violated on a fine grid.

    Args:
        model: The robot.
        count: Sets of limits.
    """
    rng = np.random.default_rng([count, *model.name.encode()])
    tree = tb.load_tree(model)
    done, refused, violated, unproven, in_the_loop, overspeed = 0, 0, 0, 0, 0, 0.0
    for number in range(count):
        speeds = {n: float(10 ** rng.uniform(-1, 0.5)) for n in tree.names}
        accelerations = {n: float(10 ** rng.uniform(-0.5, 1)) for n in tree.names}
        efforts = rng.choice([0.0, 1.0]) * 10 ** rng.uniform(-1, 1)
        settings = [*PLATE, f"seed={number}", "excitation.starts=1", "excitation.harmonics=4"]
        settings += [f"motion.max_velocity={_table(speeds)}"]
        settings += [f"motion.max_acceleration={_table(accelerations)}"]
        settings += [f"excitation.plate_range={(1e3 * 10 ** rng.uniform(-1, 1, 6)).tolist()}"]
        if efforts:
            needed = np.abs(tb.joint_forces(tree, _still(tree))).max() + 1.0
            size = float(efforts * needed)
            settings += [f"robot.joint.{name}.max_effort={size}" for name in tree.names]
        experiment = tb.Experiment.of_model(model, settings)
        try:
            wish = wish_of(experiment, robot_of(experiment))
            found = design(wish)
        except InfeasibleMotion:
            refused += 1
            continue
        done += 1
        unproven += not found.proof.holds
        violated += not _respected(found.motion, wish.rules)
        kept, faster = _in_the_loop(found.motion, wish.rules, experiment)
        in_the_loop, overspeed = in_the_loop + (not kept), max(overspeed, faster)
    return {
        "robot": model.stem,
        "sets": count,
        "designed": done,
        "refused": refused,
        "unproven": unproven,
        "violated": violated,
        "violated_in_the_loop": in_the_loop,
        "overspeed_in_the_loop": round(overspeed, 4),
    }


def _in_the_loop(motion: Fourier, rules: Rules, experiment: tb.Experiment) -> tuple[bool, float]:
    """What a simulated drive makes of it in one period, against all of each limit.

    Returns:
        Whether positions, efforts and distances are kept; and by how much the fastest joint is
        faster than it may be [rad/s or m/s]: dry friction makes slow joints jerk.
    """
    tree, limits = rules.tree, rules.limits
    plant = build_plant(
        model_of(experiment), tree, LOOP_STEP, changed=experiment.robot.joint, friction=True
    )
    sampling = Sampling(1 / LOOP_STEP, 1, averaged=False, warm_up=1.0)
    truth = simulate_motion(plant, tree, motion, motion.period, 60.0, sampling).truth
    inside = (truth.position >= limits.low).all() and (truth.position <= limits.high).all()
    strong = (np.abs(truth.torque) <= limits.effort).all()
    clear = True
    if rules.collision is not None:
        meter = DistanceMeter(rules.collision)
        clear = bool((meter.measure(truth.position[::20]).values > 0).all())
    faster = float((np.abs(truth.velocity) - limits.velocity).max())
    return bool(inside and strong and clear), max(faster, 0.0)


def _still(tree: tb.Tree) -> tb.Motion:
    nothing = np.zeros((1, tree.n))
    return tb.Motion(np.zeros(1), nothing, nothing, nothing)


def _table(values: dict[str, float]) -> str:
    return "{" + ", ".join(f'"{name}" = {value!r}' for name, value in values.items()) + "}"


def _respected(motion: Fourier, rules: Rules) -> bool:
    """At 10 kHz, by inverse dynamics."""
    tree, limits = rules.tree, rules.limits
    at = motion.at(np.arange(0, motion.period, 1e-4))
    inside = (at.q >= limits.low).all() and (at.q <= limits.high).all()
    slow = (np.abs(at.qd) <= limits.velocity).all()
    smooth = (np.abs(at.qdd) <= limits.acceleration).all()
    strong = (np.abs(motor_efforts(tree, at)) <= limits.effort).all()
    return bool(inside and slow and smooth and strong and seems_to_hold(motion, rules, 500))
