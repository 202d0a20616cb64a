"""Assumed friction, rotors, noise and step of a new experiment, tested by short simulations."""

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
    NoFeasibleMotion,
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
from testbed.motion.limits import DEFAULT_LIMITS, joint_limits
from testbed.motion.random_motion import least_effort_posture

STATE_COUNT = 200
"""Number of random states at which joint torques and base wrench are computed."""
COULOMB_SHARE, VISCOUS_SHARE = 0.05, 0.03
"""Assumed friction as shares of a joint's rms torque: Coulomb, and viscous at a moderate speed."""
MAX_COULOMB_EFFORT_SHARE = 0.05
"""Largest assumed Coulomb friction as a share of the motor's effort limit."""
PLATE_NOISE = 0.004
"""Assumed noise of forces and of moments, as a share of their rms."""
TORQUE_NOISE = 0.025
"""Assumed noise of joint torques, as a share of their rms."""
MIN_LEVER = 1e-3
"""Smallest ratio of moment noise to force noise [m]."""
MIN_INERTIA_RATIO = 1e-3
"""Smallest inertia of a joint with the other joints free, as a share of its rms inertia.

A joint below cannot be controlled: in some posture its axis coincides with another joint's, with
almost no inertia between them.
"""
ROTOR_SHARE = 0.01
"""Assumed rotor inertia of such a joint, as a share of its rms inertia."""
MAX_FRICTION_DEVIATION = 0.05
"""Largest position error by Coulomb friction under the joint controller [rad or m].

Forces of the controller are proportional to the inertia, so that a light joint needs a rotor to
overcome friction.
"""
MAX_HOLDING_SHARE = 0.9
"""Largest share of motor efforts that holding a posture may take."""
EFFORT_RATIO = 2.0
"""Ratio of assumed effort limit to holding effort, for motors that cannot hold the robot."""
STEP_SIZES = (5e-4, 2.5e-4, 1e-4, 5e-5, 2.5e-5, 1e-5)
"""Simulation steps to choose from [s]; all divide a millisecond."""
MAX_DECAY_PER_STEP = 1.0
"""Largest product of step and fastest decay rate by viscous friction; Runge-Kutta is stable up
to 2.8."""
CLEARANCE_SHARE = 0.05
"""Clearance of a small robot as a share of its size."""


@dataclass(frozen=True, eq=False)
class Assumptions:
    """Assumed values of a robot, its sensors and its simulation.

    Attributes:
        joints: Assumed settings keyed by joint name, in the robot's joint order: `coulomb` and
            `viscous` where the model file has no friction, `rotor_inertia` where the joint is too
            light to be controlled, and `max_effort` where the file's effort limits cannot hold the
            robot in any posture; units as in `Joint`.
        force_noise: Noise of the plate's forces [N].
        moment_noise: Noise of the plate's moments [N m].
        torque_noise: Noise of the joint torques [N m or N].
        step: Simulation step [s].
        clearance: Smallest distance between bodies for a small robot [m]; None for the default.
    """

    joints: Mapping[str, Mapping[str, float]]
    force_noise: float
    moment_noise: float
    torque_noise: float
    step: float
    clearance: float | None


def assumptions(tree: Tree) -> Assumptions:
    """Choose assumed friction, rotor inertias, effort limits, noise, step and clearance of a robot.

    Friction and noise are fixed fractions of the rms joint torques and of the rms base wrench over

    `STATE_COUNT` random states.

    Args:
        tree: Robot of the model file.
    """
    states = _random_motion(tree)
    torques, wrench = joint_forces(tree, states), base_wrench(tree, states)
    matrices, settings = (
        mass_matrices(tree, states.q),
        _assumed_friction(tree, _rms(torques)),
    )
    with_friction = tree.with_joints(settings)
    rotors = _assumed_rotors(with_friction, matrices)
    with_rotors = with_friction.with_joints(rotors)
    for additions in (rotors, _assumed_efforts(with_rotors)):
        settings = {
            name: settings.get(name, {}) | additions.get(name, {})
            for name in tree.names
        }
    force_noise = PLATE_NOISE * float(_rms(wrench[:, :3].ravel()))
    moment_noise = PLATE_NOISE * float(_rms(wrench[:, 3:].ravel()))
    return Assumptions(
        joints={name: values for name, values in settings.items() if values},
        force_noise=round_significant(force_noise, 1),
        moment_noise=round_significant(max(moment_noise, MIN_LEVER * force_noise), 1),
        torque_noise=round_significant(TORQUE_NOISE * float(_rms(torques.ravel())), 1),
        step=_stable_step(with_rotors, matrices),
        clearance=_small_clearance(tree),
    )


def moderate_speeds(tree: Tree) -> Array:
    """Moderate joint speeds within the velocity limits, (n,) [rad/s or m/s]."""
    moderate = np.array([DEFAULT_LIMITS[joint.kind][1] for joint in tree.joints])
    return np.asarray(np.minimum(joint_limits(tree).velocity, moderate))


def _random_motion(tree: Tree) -> Motion:
    """Motion of independent random states within the limits, at up to moderate speeds."""
    limits, rng = joint_limits(tree), np.random.default_rng(0)
    position, velocity, acceleration = (
        rng.uniform(-1, 1, (STATE_COUNT, tree.n)) * size
        for size in (limits.half, moderate_speeds(tree), limits.acceleration)
    )
    time = np.arange(float(STATE_COUNT))
    return Motion(time, limits.middle + position, velocity, acceleration)


def _rms(values: Array) -> Array:
    """Root mean square of each column."""
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))


def _assumed_friction(tree: Tree, loads: Array) -> dict[str, dict[str, float]]:
    """Assumed friction, keyed by joint name, of joints without friction in the model file.

    At a moderate speed, Coulomb and viscous friction are the fractions `COULOMB_SHARE` and
    `VISCOUS_SHARE` of the joint's rms torque. Coulomb friction is at most
    `MAX_COULOMB_EFFORT_SHARE` of the effort limit, and viscous friction is reduced in proportion.

    Args:
        tree: The robot.
        loads: Rms torques of the joints, (n,) [N m or N].
    """
    friction = {}
    for joint, load, speed in zip(
        tree.joints, loads, moderate_speeds(tree), strict=True
    ):
        if not (joint.coulomb or joint.viscous):
            load_share = min(
                float(load), MAX_COULOMB_EFFORT_SHARE / COULOMB_SHARE * joint.max_effort
            )
            friction[joint.name] = {
                "coulomb": round_significant(COULOMB_SHARE * load_share, 2),
                "viscous": round_significant(VISCOUS_SHARE * load_share / speed, 2),
            }
    return friction


def _assumed_rotors(tree: Tree, matrices: Array) -> dict[str, dict[str, float]]:
    """Assumed rotor inertias, keyed by joint name, of joints too light to be controlled.

    A joint is too light if its inertia with the other joints free falls below the fraction
    `MIN_INERTIA_RATIO` of its rms inertia in some posture, or if Coulomb friction would cause a
    position error above `MAX_FRICTION_DEVIATION`.

    Args:
        tree: The robot with friction.
        matrices: Mass matrices in random states, (states, n, n).
    """
    diagonal = np.diagonal(matrices, axis1=1, axis2=2)
    rms_inertia, rotor = _rms(diagonal), ROTOR.coefficients(tree)
    with_rotor = matrices + np.diag(rotor + 1e-12 * rms_inertia.max())
    free_inertia = 1 / np.diagonal(np.linalg.inv(with_rotor), axis1=1, axis2=2)
    is_light = (free_inertia < MIN_INERTIA_RATIO * rms_inertia).any(axis=0)
    min_inertia = COULOMB.coefficients(tree) / (
        SimulationTable().bandwidth ** 2 * MAX_FRICTION_DEVIATION
    )
    assumed_inertia = np.maximum(
        is_light * ROTOR_SHARE * rms_inertia,
        (min_inertia > rms_inertia + rotor) * min_inertia,
    )
    return {
        name: {"rotor_inertia": round_significant(float(inertia), 2)}
        for name, inertia in zip(tree.names, assumed_inertia, strict=True)
        if inertia > rotor[tree.index(name)]
    }


def _assumed_efforts(tree: Tree) -> dict[str, dict[str, float]]:
    """Assumed effort limits, keyed by joint name, of motors that are too weak.

    A motor is too weak if holding the posture of least effort and overcoming Coulomb friction take
    more than the fraction `MAX_HOLDING_SHARE` of its effort limit.
    """
    posture = least_effort_posture(tree, joint_limits(tree))
    holding_effort = np.abs(joint_forces(tree, Motion.at_rest(posture[None]))[0])
    holding_effort += np.array([joint.coulomb for joint in tree.joints])
    return {
        joint.name: {"max_effort": round_significant(EFFORT_RATIO * float(effort), 2)}
        for joint, effort in zip(tree.joints, holding_effort, strict=True)
        if effort > MAX_HOLDING_SHARE * joint.max_effort
    }


def _stable_step(tree: Tree, matrices: Array) -> float:
    """Largest step of `STEP_SIZES` at which simulated viscous friction is stable [s].

    Args:
        tree: The robot with friction and rotors.
        matrices: Mass matrices without rotors, (states, n, n).
    """
    inertia = matrices + np.diag(ROTOR.coefficients(tree))
    damping = np.diag(VISCOUS.coefficients(tree))
    fastest_decay = float(
        np.abs(np.linalg.eigvals(np.linalg.solve(inertia, damping))).max()
    )
    return next(
        (step for step in STEP_SIZES if step * fastest_decay <= MAX_DECAY_PER_STEP),
        STEP_SIZES[-1],
    )


def _small_clearance(tree: Tree) -> float | None:
    """Clearance of a small robot, the fraction `CLEARANCE_SHARE` of its length [m].

    The result is None if this clearance is not below the default clearance.
    """
    default = ExcitationTable().clearance
    assert not isinstance(default, str)
    clearance = round_significant(CLEARANCE_SHARE * chain_length(tree), 1)
    return clearance if clearance < default else None


def chain_length(tree: Tree) -> float:
    """Length of the longest path over link offsets to a link's centre of mass [m]."""
    distance = np.zeros(tree.n)
    for j, joint in enumerate(tree.joints):
        if joint.parent >= 0:
            distance[j] = distance[joint.parent] + np.linalg.norm(joint.offset)
    return float(
        np.max(distance + [np.linalg.norm(body.com) for body in tree.inertias])
    )


TRIAL_SETTINGS = ("motion.duration=1", "motion.candidates=1", "simulation.warm_up=0.2")
"""Settings of a trial: a simulation of one second."""
SLOW_PACE = 0.3
"""Share of the usual speed at which a motion is tried again after the simulation diverged."""


@dataclass(frozen=True)
class FeasibleSettings:
    """Settings with which a new experiment can be simulated.

    Attributes:
        step: Simulation step [s].
        pace: Factor on the usual velocities and accelerations.
        exclude: Pairs of body names whose distance is not limited.
        nothing_clear: True if no motion keeps the clearance, even with pairs of bodies excluded.
    """

    step: float
    pace: float = 1.0
    exclude: tuple[tuple[str, str], ...] = ()
    nothing_clear: bool = False


def tested_text(
    text: Callable[[FeasibleSettings], str],
    needs: FeasibleSettings,
    folder: Path,
    report_line: Callable[[str], None],
) -> str:
    """Text of an experiment file that has passed a simulation of one second.

    After a failed simulation, a smaller step, a slower motion, excluded pairs of bodies, and no
    clearance are tried in turn.

    Args:
        text: Function that writes the text for given settings.
        needs: Settings of the first trial.
        folder: Folder of the future file.
        report_line: Called with a line for every assumption after a failed trial.

    Raises:
        ExperimentError: No change makes the experiment run; the message lists the changes tried.
    """
    changes: list[str] = []
    while True:
        content = tomllib.loads(text(needs))
        experiment = Experiment.of_content(
            content, folder / "new.toml", settings=TRIAL_SETTINGS
        )
        try:
            record(experiment)
            break
        except TestbedError as error:
            change = _changed_needs(error, experiment, needs)
            if change is None:
                tried = f" (tried: {'; '.join(changes)})" if changes else ""
                raise ExperimentError(
                    f"no experiment is written: {error}{tried}"
                ) from None
            needs = change[0]
            changes.append(change[1])
    for line in changes:
        report_line(f"ASSUMED, since a second of it did not run: {line}")
    return text(needs)


def _changed_needs(
    error: TestbedError, experiment: Experiment, needs: FeasibleSettings
) -> tuple[FeasibleSettings, str] | None:
    """Settings changed to avoid a failure, and a description of the change.

    If the simulation diverged, the step is reduced, then the motion is slowed down. If no motion is
    feasible, pairs of close bodies are excluded, then the clearance is dropped. The result is None
    if these changes are used up, and for other errors.
    """
    if isinstance(error, SimulationDiverged):
        smaller = [step for step in STEP_SIZES if step < needs.step][:2]
        if smaller:
            return replace(
                needs, step=smaller[-1]
            ), f"simulation.step = {smaller[-1]:g} s"
        if needs.pace == 1:
            return replace(
                needs, step=STEP_SIZES[2], pace=SLOW_PACE
            ), f"motion at {SLOW_PACE:g} of its pace"
    if isinstance(error, NoFeasibleMotion) and experiment.excitation.clearance != "off":
        pairs = () if needs.exclude else _close_pairs(experiment)
        if not pairs:
            return replace(needs, exclude=(), nothing_clear=True), "no clearance"
        listed = ", ".join(f"'{a}' to '{b}'" for a, b in pairs[:5])
        rest = f" and {len(pairs) - 5} more" if len(pairs) > 5 else ""
        return replace(needs, exclude=pairs), f"clearance leaves out {listed}{rest}"
    return None


def _close_pairs(experiment: Experiment) -> tuple[tuple[str, str], ...]:
    """Pairs of bodies closer than the clearance, in the random posture with the fewest."""
    tree = robot_of(experiment)
    rules = rules_of(experiment, tree, designed=False)
    if rules.collision is None:
        return ()
    meter = DistanceMeter(rules.collision, 2 * rules.clearance)
    is_close = meter.measure(rules.limits.postures).values <= rules.clearance
    pairs = is_close[is_close.sum(axis=1).argmin()]
    return tuple(compress(rules.collision.bodies, pairs))
