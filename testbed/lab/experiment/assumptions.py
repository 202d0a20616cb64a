"""What `new` assumes where a model file says nothing, and a second of simulation to try it."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import compress
from pathlib import Path

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.errors import (
    ExperimentError,
    InfeasibleMotion,
    TestbedError,
    round_significant,
)
from testbed.core.dynamics.newton_euler import Motion, base_wrench, joint_forces
from testbed.core.robot.friction import COULOMB, ROTOR, VISCOUS
from testbed.core.robot.tree import Tree
from testbed.lab.experiment.experiment import Experiment
from testbed.lab.experiment.experiment_tables import ExcitationTable, SimulationTable
from testbed.lab.experiment.motions import rules_of
from testbed.lab.experiment.record import record
from testbed.lab.experiment.rig import robot_of
from testbed.lab.simulation.controller import mass_matrices
from testbed.lab.simulation.rollout import SimulationDiverged
from testbed.motion.clearance import DistanceMeter
from testbed.motion.limits import CALM, limits_of
from testbed.motion.random_motion import easiest_posture

POSTURES = 200
"""Random states in which joints and plate are loaded."""
DRY, VISCOUS_SHARE = 0.05, 0.03
"""Assumed friction, as shares of a joint's load: dry, and viscous at its velocity there."""
OF_MOTOR = 0.05
"""Most of the motor's effort that dry friction is assumed to take."""
PLATE_NOISE = 0.004
"""Assumed noise of forces and of moments, as a share of their rms."""
TORQUE_NOISE = 0.025
"""Assumed noise of joint torques, as a share of their rms."""
LEAST_LEVER = 1e-3
"""Noise of moments is at least that of forces at this lever [m]."""
LIGHT = 1e-3
"""A joint whose inertia falls below this share of its usual one, the others free to give way,
cannot be controlled: axes of joints fall into one there, with next to nothing between them."""
ROTOR_SHARE = 0.01
"""Assumed inertia of such a joint's rotor, as a share of its usual inertia."""
OFF_COURSE = 0.05
"""How far dry friction may hold a joint back from where its drive wants it [rad or m]: a drive
whose forces go by the inertia moves what is lighter only with a rotor."""
HELD = 0.9
"""Share of motor efforts that a posture may take, to be held."""
STRONGER = 2.0
"""Times what the easiest posture asks of them, motors that cannot hold it are assumed to give."""
STEPS = (5e-4, 2.5e-4, 1e-4, 5e-5, 2.5e-5, 1e-5)
"""Simulation steps to choose from [s]; all divide a millisecond."""
STABLE = 1.0
"""Step times the fastest decay by viscous friction: Runge-Kutta's method is stable up to 2.8."""
OF_SIZE = 0.05
"""Clearance kept by a robot that is small, as a share of its size."""


@dataclass(frozen=True, eq=False)
class Assumptions:
    """What is assumed of a robot.

    Attributes:
        joints: By joint, in their order: `coulomb` and `viscous` where the model file has no
            friction, `rotor_inertia` where the joint could not be controlled without, and
            `max_effort` where the file's holds the robot in no posture; units as in Joint.
        force_noise: Of the plate [N].
        moment_noise: Of the plate [N m].
        torque_noise: Of the drives [N m or N].
        step: Of the simulation [s].
        clearance: That a small robot keeps [m]; None for the usual one.
    """

    joints: Mapping[str, Mapping[str, float]]
    force_noise: float
    moment_noise: float
    torque_noise: float
    step: float
    clearance: float | None


def assumptions(tree: Tree) -> Assumptions:
    """What is assumed of a robot.

    Args:
        tree: As its model file has it.
    """
    states = _random_states(tree)
    torques, wrench = joint_forces(tree, states), base_wrench(tree, states)
    matrices, settings = mass_matrices(tree, states.q), _friction(tree, _rms(torques))
    rubbing = tree.with_joints(settings)
    rotors = _rotors(rubbing, matrices)
    whole = rubbing.with_joints(rotors)
    for more in (rotors, _efforts(whole)):
        settings = {
            name: settings.get(name, {}) | more.get(name, {}) for name in tree.names
        }
    force_noise = PLATE_NOISE * float(_rms(wrench[:, :3].ravel()))
    moment_noise = PLATE_NOISE * float(_rms(wrench[:, 3:].ravel()))
    return Assumptions(
        joints={name: values for name, values in settings.items() if values},
        force_noise=round_significant(force_noise, 1),
        moment_noise=round_significant(max(moment_noise, LEAST_LEVER * force_noise), 1),
        torque_noise=round_significant(TORQUE_NOISE * float(_rms(torques.ravel())), 1),
        step=_step(whole, matrices),
        clearance=_clearance(tree),
    )


def calm_speeds(tree: Tree) -> Array:
    """Velocities of a calm motion inside the limits, (n,) [rad/s or m/s]."""
    usual = np.array([CALM[joint.kind][1] for joint in tree.joints])
    return np.asarray(np.minimum(limits_of(tree).velocity, usual))


def _random_states(tree: Tree) -> Motion:
    """Random motion up to calm speeds."""
    limits, rng = limits_of(tree), np.random.default_rng(0)
    position, velocity, acceleration = (
        rng.uniform(-1, 1, (POSTURES, tree.n)) * size
        for size in (limits.half, calm_speeds(tree), limits.acceleration)
    )
    time = np.arange(float(POSTURES))
    return Motion(time, limits.middle + position, velocity, acceleration)


def _rms(values: Array) -> Array:
    """Column by column."""
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))


def _friction(tree: Tree, loads: Array) -> dict[str, dict[str, float]]:
    """Of the joints that have none, in proportion to their loads, (n,) [N m or N]."""
    found = {}
    for joint, load, speed in zip(tree.joints, loads, calm_speeds(tree), strict=True):
        if not (joint.coulomb or joint.viscous):
            rubs = min(float(load), OF_MOTOR / DRY * joint.max_effort)
            found[joint.name] = {
                "coulomb": round_significant(DRY * rubs, 2),
                "viscous": round_significant(VISCOUS_SHARE * rubs / speed, 2),
            }
    return found


def _rotors(tree: Tree, matrices: Array) -> dict[str, dict[str, float]]:
    """Rotors of joints that are too light, in some posture or for their friction."""
    diagonal = np.diagonal(matrices, axis1=1, axis2=2)
    usual, own = _rms(diagonal), ROTOR.coefficients(tree)
    whole = matrices + np.diag(own + 1e-12 * usual.max())
    free = 1 / np.diagonal(np.linalg.inv(whole), axis1=1, axis2=2)
    light = (free < LIGHT * usual).any(axis=0)
    moved = COULOMB.coefficients(tree) / (SimulationTable().bandwidth ** 2 * OFF_COURSE)
    wanted = np.maximum(light * ROTOR_SHARE * usual, (moved > usual + own) * moved)
    return {
        name: {"rotor_inertia": round_significant(float(inertia), 2)}
        for name, inertia in zip(tree.names, wanted, strict=True)
        if inertia > own[tree.index(name)]
    }


def _efforts(tree: Tree) -> dict[str, dict[str, float]]:
    """Efforts of motors that do not hold the robot even where that asks least of them."""
    posture = easiest_posture(tree, limits_of(tree))
    asked = np.abs(joint_forces(tree, Motion.at_rest(posture[None]))[0])
    asked += np.array([joint.coulomb for joint in tree.joints])
    return {
        joint.name: {"max_effort": round_significant(STRONGER * float(need), 2)}
        for joint, need in zip(tree.joints, asked, strict=True)
        if need > HELD * joint.max_effort
    }


def _step(tree: Tree, matrices: Array) -> float:
    """The largest step in which what friction brakes is followed [s]."""
    inertia = matrices + np.diag(ROTOR.coefficients(tree))
    brakes = np.diag(VISCOUS.coefficients(tree))
    fastest = float(np.abs(np.linalg.eigvals(np.linalg.solve(inertia, brakes))).max())
    return next((step for step in STEPS if step * fastest <= STABLE), STEPS[-1])


def _clearance(tree: Tree) -> float | None:
    """What a robot keeps for which the usual clearance is much of its own size [m]."""
    usual = ExcitationTable().clearance
    assert not isinstance(usual, str)
    kept = round_significant(OF_SIZE * size(tree), 1)
    return kept if kept < usual else None


def size(tree: Tree) -> float:
    """How far bodies reach from the first joint that carries them [m]."""
    away = np.zeros(tree.n)
    for j, joint in enumerate(tree.joints):
        if joint.parent >= 0:
            away[j] = away[joint.parent] + np.linalg.norm(joint.offset)
    return float(np.max(away + [np.linalg.norm(body.com) for body in tree.inertias]))


SECOND = ("motion.duration=1", "motion.candidates=1", "simulation.warm_up=0.2")
"""What is tried of an experiment."""
SLOWER = 0.3
"""Pace at which a motion that goes astray is tried once more."""


@dataclass(frozen=True)
class Needs:
    """What an experiment needs to run.

    Attributes:
        step: Of the simulation [s].
        pace: Share of usual velocities and accelerations.
        exclude: Pairs of bodies that cannot be kept apart, by name.
        nothing_clear: Whether no motion keeps clear, whatever pairs are left out.
    """

    step: float
    pace: float = 1.0
    exclude: tuple[tuple[str, str], ...] = ()
    nothing_clear: bool = False


def tried_text(
    text: Callable[[Needs], str], needs: Needs, folder: Path, say: Callable[[str], None]
) -> str:
    """The text of an experiment of which a second has been simulated.

    Args:
        text: Of an experiment with these needs.
        needs: To begin with.
        folder: Where the file will be.
        say: Called with a line for each thing that is assumed because a trial failed.

    Raises:
        ExperimentError: Nothing that can be assumed makes it run; says what was tried.
    """
    done: list[str] = []
    while True:
        content = tomllib.loads(text(needs))
        experiment = Experiment.of_content(
            content, folder / "new.toml", settings=SECOND
        )
        try:
            record(experiment)
            break
        except TestbedError as error:
            more = _needs_after(error, experiment, needs)
            if more is None:
                tried = f" (tried: {'; '.join(done)})" if done else ""
                raise ExperimentError(
                    f"no experiment is written: {error}{tried}"
                ) from None
            needs = more[0]
            done.append(more[1])
    for line in done:
        say(f"ASSUMED, since a second of it did not run: {line}")
    return text(needs)


def _needs_after(
    error: TestbedError, experiment: Experiment, needs: Needs
) -> tuple[Needs, str] | None:
    """What may help after a failure, and that in words; None where nothing is known to."""
    if isinstance(error, SimulationDiverged):
        smaller = [step for step in STEPS if step < needs.step][:2]
        if smaller:
            return replace(
                needs, step=smaller[-1]
            ), f"simulation.step = {smaller[-1]:g} s"
        if needs.pace == 1:
            return replace(
                needs, step=STEPS[2], pace=SLOWER
            ), f"motion at {SLOWER:g} of its pace"
    if isinstance(error, InfeasibleMotion) and experiment.excitation.clearance != "off":
        pairs = () if needs.exclude else _touching(experiment)
        if not pairs:
            return replace(needs, exclude=(), nothing_clear=True), "no clearance"
        shown = ", ".join(f"'{a}' to '{b}'" for a, b in pairs[:5])
        more = f" and {len(pairs) - 5} more" if len(pairs) > 5 else ""
        return replace(needs, exclude=pairs), f"clearance leaves out {shown}{more}"
    return None


def _touching(experiment: Experiment) -> tuple[tuple[str, str], ...]:
    """Pairs of bodies that are too near in the posture where the fewest are."""
    tree = robot_of(experiment)
    rules = rules_of(experiment, tree, designed=False)
    if rules.collision is None:
        return ()
    meter = DistanceMeter(rules.collision, 2 * rules.clearance)
    near = meter.measure(rules.limits.postures).values <= rules.clearance
    fewest = near[near.sum(axis=1).argmin()]
    return tuple(compress(rules.collision.bodies, fewest))
