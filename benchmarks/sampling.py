"""Are robots that are drawn as likely as the one that was measured?

Truth is drawn from the prior around a model file; every seed is another one, another motion and
other noise. If draws are right, truth's rank among them is uniform [TBM18].
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
import typer
from scipy import stats

import testbed as tb
from benchmarks.lines import print_lines
from benchmarks.random_recordings import ROBOTS
from testbed.bodies.consistency.options import ConsistencyOptions
from testbed.bodies.consistency.robots import (
    BODY_PARAMETER_COUNT,
    RobotSamples,
    robots,
    sample_file_losses,
)
from testbed.bodies.prior import PriorBodies, prior_of
from testbed.core.base.arrays import Array
from testbed.core.dynamics.newton_euler import Motion, linear_inverse_dynamics
from testbed.core.parameters.pseudo_inertia import UPPER_ENTRIES, pseudo_inertia_coordinates
from testbed.core.parameters.rules import SIGNALS
from testbed.core.parameters.symbols import barycentric_from_standard
from tests.helpers.measured import measured, random_fourier

DRAWS, BINS, STATES = 99, 20, 30
"""Draws, so that ranks are 0 to 99; bins of ranks; instants of an unseen motion."""

ERROR = 0.3
"""Of the model file."""

FRICTION = {"coulomb": 2.0, "viscous": 1.0}
"""Of the file's joints [N m, N m s/rad]."""


def ranks(robot: str, seeds: range, seconds: float) -> dict[str, Any]:
    """Truth's rank among draws, and coverage of bands of torque.

    Args:
        robot: One of ROBOTS.
        seeds: One an experiment.
        seconds: Of each recording.
    """
    file = tb.load_tree(ROBOTS[robot])
    file = file.with_joints(dict.fromkeys(file.names, FRICTION))
    prior, options = prior_of(file), ConsistencyOptions(prior_error=ERROR)
    of_one, of_each, inside = [], [], []
    for seed in seeds:
        rng = np.random.default_rng([seed, 39])
        drawn = prior_robots(file, prior, ERROR, 1, rng)
        truth = drawn.tree(0, file)
        recording = measured(truth, seed, duration=seconds).blind()
        estimates = [tb.identify(file, recording, method, threads=1) for method in SIGNALS]
        found = robots(file, estimates, prior, DRAWS, rng, options)
        free = found.sigma > 0
        values, true = found.values[:, free], drawn.values[0, free]
        of_each.append((values < true).sum(axis=0))
        along = rng.normal(size=free.sum()) / found.sigma[free]
        of_one.append(int((values @ along < true @ along).sum()))
        motion = random_fourier(file, rng, 1.0).at(rng.uniform(0, 10, STATES))
        torque = torques(file, motion, found.values)
        rank = (torque < torques(file, motion, drawn.values)).sum(axis=-1)
        inside.append(((rank >= 2) & (rank <= 96)).mean())  # 95 of 100 ranks
    each = [uniform(ranks) for ranks in np.array(of_each).T]
    return {
        "robot": robot,
        "p of a random combination": float(f"{uniform(np.array(of_one)):.2g}"),
        "p of the worst parameter, times their number": float(f"{min(each) * len(each):.2g}"),
        "coverage of 95 % torque bands": round(float(np.mean(inside)), 3),
    }


def factors(logs: Array) -> Array:
    """L, upper triangular, (..., 4, 4), of coordinates that are zero for the file's body.

    Each of them changes one coordinate of Y by as much, to first order.

    Args:
        logs: In the order UPPER, (..., 10).
    """
    found = np.zeros((*logs.shape[:-1], 4, 4))
    for k, (a, b) in enumerate(UPPER_ENTRIES):
        found[..., a, b] = np.exp(logs[..., k] / 2) if a == b else logs[..., k] / np.sqrt(2)
    return found


def prior_robots(
    tree: tb.Tree, prior: PriorBodies, error: float, count: int, rng: np.random.Generator
) -> RobotSamples:
    """Robots as the model file alone has them.

    Args:
        tree: The robot; friction that its joints state is the file's.
        prior: Bodies and rotors.
        error: Of these, in parts of themselves.
        count: How many.
        rng: Draws the numbers.
    """
    massive = list(prior.massive_bodies)
    roots = factors(error * rng.normal(size=(count, len(massive), BODY_PARAMETER_COUNT)))
    z = np.zeros((count, tree.n, BODY_PARAMETER_COUNT))
    z[:, massive] = pseudo_inertia_coordinates(roots @ np.swapaxes(roots, -1, -2))
    bodies = (z.reshape(count, -1) @ prior.standard_from_coordinates.T).reshape(z.shape)
    values = np.concatenate([bodies, sample_file_losses(tree, prior, error, count, rng)], axis=-1)
    links = tuple(joint.body for joint in tree.joints)
    return RobotSamples(tree.names, links, values, np.zeros(values.shape[1:]), error)


def uniform(found: Array) -> float:
    """Chance of counts at least as uneven in bins, if ranks from 0 to DRAWS are uniform."""
    counts, _ = np.histogram(found, BINS, (0, DRAWS + 1))
    return float(stats.chisquare(counts).pvalue)


def torques(tree: tb.Tree, motion: Motion, values: Array) -> Array:
    """What drives deliver, (M, n, N), by draws, (N, n, 13)."""
    theta = barycentric_from_standard(tree, np.moveaxis(values[..., :BODY_PARAMETER_COUNT], 0, -1))
    bodies = linear_inverse_dynamics(tree, motion, theta)[0]
    dry, wet, rotor = np.moveaxis(values[..., BODY_PARAMETER_COUNT:], 0, -1).swapaxes(0, 1)
    speed = motion.qd[..., None]
    return np.asarray(bodies + dry * np.sign(speed) + wet * speed + rotor * motion.qdd[..., None])


def main(
    robots: Annotated[list[str] | None, typer.Option("--robot", help="Default three.")] = None,
    seeds: Annotated[int, typer.Option(help="Experiments with each robot.")] = 200,
    first: Annotated[int, typer.Option(help="The first seed.")] = 0,
    seconds: Annotated[float, typer.Option(help="Of each recording.")] = 20.0,
) -> None:
    """Truth's rank among robots that `sample` draws, and bands of torque that they predict."""
    for robot in robots or ["puma", "ur5", "gantry_ppp_rrr"]:
        print_lines([ranks(robot, range(first, first + seeds), seconds)])
