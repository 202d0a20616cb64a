"""The plant: a compiled model on its plate, and the check that it is the robot we think it is."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import Array
from testbed.core.base.errors import ModelError, UnknownName
from testbed.core.dynamics.newton_euler import Motion, base_wrench, joint_forces
from testbed.core.robot.force_sensor import ForceSensor
from testbed.core.robot.formats.mjcf import repaired_spec
from testbed.core.robot.formats.mjcf_compile import MASSLESS, compile_spec, no_mujoco_warnings
from testbed.core.robot.formats.urdf import repaired_xml
from testbed.core.robot.friction import ROTOR, friction_torque
from testbed.core.robot.model_file import ModelFile, model_format
from testbed.core.robot.tree import Tree
from testbed.lab.simulation.effect import PLATE_FREEDOM, Effect
from testbed.motion.limits import limits_of

SAME = 1e-9
"""Largest relative difference between the plant and the tree's own equations."""

_OWN = 1e-6
"""The same of what acts on a joint, in parts of the greatest that this joint has."""

_NAMED = 3  # joints in one line

_SPEED = 0.5  # of the joints in the self-check: well outside the band where friction is soft


@dataclass(frozen=True, eq=False)
class Plant:
    """A compiled model with what is needed to drive it and to read its plate.

    Attributes:
        model: The MuJoCo model.
        order: For each joint of the tree, its index among MuJoCo's velocities, (n,).
        dofs: How MuJoCo's positions and velocities go with the joints', (nv, n): one for each
            joint, a ratio for what a joint takes along.
        positions: Where its position stands among the sensor data, (n,).
        velocities: Likewise its velocity, (n,).
        plate: Where the plate's force and moment stand among the sensor data, (6,).
        plate_turn: Rotation from the sensor's axes to the bedplate's, (3, 3).
        plate_origin: The sensor's origin in the bedplate frame, (3,) [m].
        sensors: Where those of the robot's force sensors stand, (6 S,).
        tare: Static wrench of what stands on the plate without moving, (6,) [N, N m],
            bedplate axes, about O^0.
    """

    model: mujoco.MjModel
    order: NDArray[np.int64]
    dofs: Array
    positions: Array
    velocities: Array
    plate: Array
    plate_turn: Array
    plate_origin: Array
    tare: Array
    sensors: NDArray[np.int64]

    def bedplate_wrench(self, sensed: Array) -> Array:
        """From the sensor's axes and origin to the bedplate's, (..., 6) [N, N m]."""
        force = sensed[..., :3] @ self.plate_turn.T
        moment = sensed[..., 3:] @ self.plate_turn.T + np.cross(self.plate_origin, force)
        return np.concatenate([force, moment], axis=-1)


def check_plant(plant: Plant, tree: Tree, path: Path) -> None:
    """In a few states: does the plant feel and need what the tree's equations say?

    The motors drive it through each as they would in motion, all joints moving, or every other one
    at rest. MuJoCo's dry friction is Coulomb's only where it is overcome: without the motors a
    light link would not overcome it. Catches whatever else a model file holds that acts on the
    robot: springs, tendons, fluid, gravity compensation, a body that does not stand on the plate.

    Args:
        plant: The robot on its bedplate.
        tree: The robot as it was read, without friction where the plant has none.
        path: The file, for the message.

    Raises:
        ModelError: Says what differs.
    """
    states = [_state(plant, tree, path, moving) for moving in _moving(tree.n)]
    own = np.max([np.abs(state.motor) + np.abs(state.friction) for state in states], axis=0)
    for state in states:
        _check_forces(state, tree, own, path)
        felt = np.abs(state.expected_wrench - state.wrench).max()
        if max(felt, np.abs(state.need - state.motor - state.other).max()) > SAME * state.scale:
            raise ModelError(
                f"{path}: the plate or the joints do not feel the robot that was read (off by "
                f"{felt:.3g} N or N m); does every arm stand on the sensor, is it unfiltered?"
            )


@dataclass(frozen=True, eq=False)
class _State:
    """What acts in the plant, and what the tree expects, by joint [N m or N].

    Attributes:
        motor: What the motors do, (n,).
        friction: What friction takes, (n,).
        other: What acts besides the motors, (n,).
        need: What the joints need for the acceleration that the plant has, (n,).
        wrench: What the plate feels, bedplate axes, about O^0, (6,) [N, N m].
        expected_wrench: What it should, (6,).
    """

    motor: Array
    friction: Array
    other: Array
    need: Array
    wrench: Array
    expected_wrench: Array

    @property
    def scale(self) -> float:
        """The greatest of all that acts."""
        return float(
            np.abs(np.concatenate([self.need, self.motor])).max() + np.abs(self.wrench).max()
        )


def _moving(n: int) -> tuple[Array, ...]:
    """Which joints move, state by state: all, and every other one, (n,) each."""
    even = np.arange(n) % 2 == 0
    return np.ones(n, dtype=bool), even, ~even


def _state(plant: Plant, tree: Tree, path: Path, moving: Array) -> _State:
    """Drive the plant through a state near the middle of all ranges."""
    rng, limits = np.random.default_rng(0), limits_of(tree)
    q = limits.middle + rng.uniform(-0.1, 0.1, tree.n) * (limits.high - limits.low)
    qd = moving * _SPEED * rng.choice([-1.0, 1.0], tree.n) * rng.uniform(0.5, 1.0, tree.n)
    qdd = moving * rng.uniform(-1.0, 1.0, tree.n)
    friction = friction_torque(tree, qd)

    def need(acceleration: Array) -> tuple[Array, Motion]:
        motion = Motion(np.zeros(1), q[None], qd[None], acceleration[None])
        return joint_forces(tree, motion)[0] + ROTOR.coefficients(tree) * acceleration, motion

    motor = need(qdd)[0] + friction
    data = mujoco.MjData(plant.model)
    data.qpos[plant.order], data.qvel[plant.order], data.ctrl[:] = q, qd, motor
    mujoco.mj_forward(plant.model, data)
    found = data.qacc[plant.order]
    if not (np.abs(found) < 1e12).all():
        raise ModelError(f"{path}: MuJoCo finds no finite acceleration; a body may lack inertia")
    needed, motion = need(found)
    return _State(
        motor=motor,
        friction=friction,
        other=(data.qfrc_passive + data.qfrc_constraint)[plant.order],
        need=needed,
        wrench=plant.bedplate_wrench(data.sensordata[plant.plate]),
        expected_wrench=base_wrench(tree, motion)[0] + plant.tare,
    )


def _check_forces(state: _State, tree: Tree, own: Array, path: Path) -> None:
    """Whether friction is all that acts besides the motors.

    Args:
        state: Of the plant.
        tree: The robot.
        own: The greatest forces of each joint, (n,): a light one's are small beside others'.
        path: The file, for the message.

    Raises:
        ModelError: Names the joints, and how much acts there.
    """
    allowed = np.minimum(SAME * state.scale, _OWN * own)
    wrong = np.flatnonzero(np.abs(state.other + state.friction) > allowed)
    if not wrong.size:
        return
    said = [
        f"'{tree.names[k]}' ({state.other[k]:.4g} {_unit(tree, int(k))} found, "
        f"{-state.friction[k]:.4g} of friction expected)"
        for k in wrong[:_NAMED]
    ]
    more = f" and {wrong.size - _NAMED} more" if wrong.size > _NAMED else ""
    raise ModelError(
        f"{path}: besides motor and friction something else acts on {', '.join(said)}{more}, "
        "which the robot that was read does not have"
    )


def _unit(tree: Tree, joint: int) -> str:
    return "N m" if tree.joints[joint].revolute else "N"


_PLATE = "testbed/bedplate"
_SENSOR = "testbed/sensor/"
_WORLD = "testbed/world"  # of a link called "world", which MuJoCo would take for its own world
_PREFIX = "testbed/robot/"  # of the names in a robot that is put on a plate of its own


def build_plant(
    model: ModelFile,
    tree: Tree,
    step: float,
    *,
    changed: Collection[str] = (),
    friction: bool = True,
    effects: Sequence[Effect] = (),
    sensors: Sequence[ForceSensor] = (),
) -> Plant:
    """Put the robot of a model file on its sensing bedplate.

    Args:
        model: The model file, and how it is read.
        tree: The tree read from it, with what effects add to it; gives joint names, their order
            and gravity.
        step: Simulation step [s].
        changed: Joints whose friction and rotor inertia are the tree's, not the file's.
        friction: Keep the joints' friction.
        effects: What else is in the plant, on the robot.
        sensors: In the robot, besides the bedplate's.

    Raises:
        ModelError: MuJoCo refuses the model, or an effect departs from its law.
        UnknownName: A sensor is at a link that is not there.
    """
    if not friction or any(effect.owns_friction for effect in effects):
        tree = tree.without_friction()
    path, spec = model.path, robot_spec(model)
    prefix = ""
    with no_mujoco_warnings():  # attaching overrides timestep and camera, and says so
        if _plate_of(compile_spec(spec, path)) is None:
            spec, prefix = _on_plate(spec), _PREFIX
        _equip(spec, tree, step, prefix, changed)
        for effect in effects:
            effect.equip(spec, tree, prefix)
        for sensor in sensors:
            _add_sensor(spec, sensor, prefix)
        plant = _plant_of(compile_spec(spec, path), tree, path, prefix)
        check_plant(plant, tree, path)
        for effect in effects:
            effect.disturb(spec, tree, prefix)
        if effects:
            plant = _plant_of(compile_spec(spec, path), tree, path, prefix)
        plant = replace(plant, sensors=_addresses(plant.model, sensors))
    for effect in effects:
        flaw = effect.flaw(plant, tree)
        if flaw:
            raise ModelError(f"{path}: {effect.kind}: {flaw}")
    return plant


def robot_spec(model: ModelFile) -> mujoco.MjSpec:
    """MuJoCo's editable model of a model file, nothing added.

    Args:
        model: The file, and how it is read.

    Raises:
        ModelError: MuJoCo refuses it.
    """
    path = model.path
    how: dict[str, Any] = {"weld_root": model.weld_root, "repair": model.repair, "lock": model.lock}
    if model_format(path) == "mjcf":
        return repaired_spec(path, **how).spec
    root, *_ = repaired_xml(path, **how)
    for tag, key in (("link", "name"), ("parent", "link"), ("child", "link")):
        for each in root.iter(tag):
            if each.get(key) == "world":
                each.set(key, _WORLD)
    options = {"fusestatic": "false", "balanceinertia": "false", "discardvisual": "true"}
    ET.SubElement(ET.SubElement(root, "mujoco"), "compiler", options)
    with no_mujoco_warnings():
        try:
            spec = mujoco.MjSpec.from_string(ET.tostring(root, encoding="unicode"))
        except ValueError as error:
            raise ModelError(f"{path}: {' '.join(str(error).split())}") from None
    spec.compiler.boundmass = spec.compiler.boundinertia = MASSLESS
    return spec


def _on_plate(robot: mujoco.MjSpec) -> mujoco.MjSpec:
    """A world with one plate at its origin, and the robot on it."""
    spec = mujoco.MjSpec()
    spec.compiler.boundmass = spec.compiler.boundinertia = MASSLESS
    site = spec.worldbody.add_body(name=_PLATE).add_site(name=_PLATE)
    spec.attach(robot, site=site, prefix=_PREFIX)
    _add_sensors(spec, _PLATE)
    return spec


def _equip(
    spec: mujoco.MjSpec, tree: Tree, step: float, prefix: str, changed: Collection[str]
) -> None:
    """Options, motors, joint sensors; friction that is Coulomb's down to 0.01 rad/s."""
    option = spec.option
    option.timestep, option.gravity = step, tree.gravity
    option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    option.tolerance, option.iterations = 1e-14, 50
    off = mujoco.mjtDisableBit  # a state that blew up must stay so, to be seen
    option.disableflags = int(off.mjDSBL_CONTACT) | int(off.mjDSBL_AUTORESET)
    option.enableflags = 0
    for joint in spec.joints:
        joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE  # the drive limits itself
        known = tree.joints[tree.index(joint.name.removeprefix(prefix))]
        if known.name in changed:
            joint.frictionloss, joint.armature = known.coulomb, known.rotor_inertia
            joint.damping = np.concatenate([[known.viscous], np.zeros(np.size(joint.damping) - 1)])
        if not known.coulomb:
            joint.frictionloss = 0.0
        if not known.viscous:
            joint.damping = np.zeros_like(joint.damping)
        joint.solref_friction = [2 * step, 1]
        joint.solimp_friction = [0.9999, 0.9999, 0.001, 0.5, 2]
    for name in (prefix + name for name in tree.names):
        motor = spec.add_actuator(name=f"testbed/{name}", target=name)
        motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
        for kind in (mujoco.mjtSensor.mjSENS_JOINTPOS, mujoco.mjtSensor.mjSENS_JOINTVEL):
            label = f"testbed/{kind.name}/{name}"
            spec.add_sensor(name=label, type=kind, objtype=mujoco.mjtObj.mjOBJ_JOINT, objname=name)


def _add_sensor(spec: mujoco.MjSpec, sensor: ForceSensor, prefix: str) -> None:
    """A force and a torque sensor at the cut before a link, at its place and along its axes."""
    bodies = {each.name.removeprefix(prefix): each for each in spec.bodies[1:]}  # not the world
    if sensor.link not in bodies:
        raise UnknownName("link", sensor.link, sorted(bodies))
    body = bodies[sensor.link]
    turn = np.zeros(4)
    mujoco.mju_mat2Quat(turn, sensor.rotation.ravel())
    body.add_site(name=_SENSOR + sensor.name, pos=sensor.position, quat=turn)
    _add_sensors(spec, _SENSOR + sensor.name)


def _add_sensors(spec: mujoco.MjSpec, site: str) -> None:
    for name, kind in (
        ("force", mujoco.mjtSensor.mjSENS_FORCE),
        ("torque", mujoco.mjtSensor.mjSENS_TORQUE),
    ):
        at = {"objtype": mujoco.mjtObj.mjOBJ_SITE, "objname": site}
        spec.add_sensor(name=f"{site}/{name}", type=kind, **at)


def _addresses(model: mujoco.MjModel, sensors: Sequence[ForceSensor]) -> NDArray[np.int64]:
    """Where the force and moment of each stand among the sensor data, (6 S,)."""
    parts = [f"{_SENSOR}{each.name}/{what}" for each in sensors for what in ("force", "torque")]
    first = np.array([model.sensor(name).adr[0] for name in parts], dtype=np.int64)
    return (first[:, None] + np.arange(3)).ravel()


def _plant_of(model: mujoco.MjModel, tree: Tree, path: Path, prefix: str) -> Plant:
    plate = _plate_of(model)
    if plate is None:
        raise ModelError(f"{path}: the sensing bedplate was lost when MuJoCo compiled the model")
    force, torque = plate
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    site = int(model.sensor_objid[force])

    def sensors(kind: mujoco.mjtSensor) -> Array:
        found = [model.sensor(f"testbed/{kind.name}/{prefix}{n}").adr[0] for n in tree.names]
        return np.array(found)

    order = np.array([model.joint(prefix + name).dofadr[0] for name in tree.names])
    return Plant(
        model=model,
        order=order,
        dofs=_dofs(model, order),
        positions=sensors(mujoco.mjtSensor.mjSENS_JOINTPOS),
        velocities=sensors(mujoco.mjtSensor.mjSENS_JOINTVEL),
        plate=np.concatenate([model.sensor_adr[s] + np.arange(3) for s in (force, torque)]),
        plate_turn=data.site_xmat[site].reshape(3, 3).copy(),
        plate_origin=data.site_xpos[site].copy(),
        tare=_tare(model, data, int(model.site_bodyid[site]), model.opt.gravity),
        sensors=np.zeros(0, dtype=np.int64),
    )


def _dofs(model: mujoco.MjModel, order: Array) -> Array:
    """How MuJoCo's velocities go with those of the joints, (nv, n)."""
    found = np.zeros((model.nv, len(order)))
    found[order, np.arange(len(order))] = 1.0
    for gear in np.flatnonzero(model.eq_type == int(mujoco.mjtEq.mjEQ_JOINT)):
        led, leader = int(model.eq_obj1id[gear]), int(model.eq_obj2id[gear])
        if leader >= 0:
            with_it = found[model.jnt_dofadr[leader]]
            found[model.jnt_dofadr[led]] = model.eq_data[gear, 1] * with_it
    return found


def _plate_of(model: mujoco.MjModel) -> tuple[int, int] | None:
    """A force and a torque sensor at one site that is welded to the world."""
    found: dict[tuple[int, int], int] = {}
    for s in range(model.nsensor):
        found[(int(model.sensor_type[s]), int(model.sensor_objid[s]))] = s
    for site in range(model.nsite):
        force = found.get((int(mujoco.mjtSensor.mjSENS_FORCE), site))
        torque = found.get((int(mujoco.mjtSensor.mjSENS_TORQUE), site))
        if force is not None and torque is not None and _stands(model, model.site_bodyid[site]):
            return force, torque
    return None


def _stands(model: mujoco.MjModel, body: int) -> bool:
    """Whether a body is the world's, or moves with the plate alone."""
    first = int(model.body_weldid[body])
    joints = range(model.body_jntadr[first], model.body_jntadr[first] + model.body_jntnum[first])
    ours = all(model.joint(k).name.startswith(PLATE_FREEDOM) for k in joints)
    return first == 0 or (ours and model.body_weldid[model.body_parentid[first]] == 0)


def _tare(model: mujoco.MjModel, data: mujoco.MjData, body: int, gravity: Array) -> Array:
    """Static wrench of the bodies above the sensor that do not move."""
    mass, moment = 0.0, np.zeros(3)
    for b in range(body, model.nbody):
        chain = b
        while chain > body:
            chain = model.body_parentid[chain]
        if chain == body and model.body_weldid[b] == model.body_weldid[body]:
            mass += model.body_mass[b]
            moment += model.body_mass[b] * data.xipos[b]
    return np.concatenate([-mass * gravity, -np.cross(moment, gravity)])
