"""The plant: a compiled model on its plate, and the check that it is the robot we think it is."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from testbed.core.base.arrays import Array
from testbed.core.base.errors import ModelError, UnknownName, few
from testbed.core.base.transform import Transform
from testbed.core.dynamics.newton_euler import Motion, base_wrench, joint_forces
from testbed.core.robot.drive_torque import friction_torque
from testbed.core.robot.force_sensor import ForceSensor
from testbed.core.robot.formats.mjcf import MjcfModel
from testbed.core.robot.formats.mjcf_compile import (
    MASSLESS,
    compile_spec,
    no_mujoco_warnings,
)
from testbed.core.robot.friction import ROTOR
from testbed.core.robot.model_file import ModelFile
from testbed.core.robot.rotations import to_quaternion
from testbed.core.robot.tree import Tree
from testbed.lab.simulation.effect import Effect
from testbed.motion.limits import limits_of

SAME = 1e-9
"""Largest relative difference between the plant and the tree's own equations."""

_OWN = 1e-6
"""The same of what acts on a joint, in parts of the greatest that this joint has."""

_SPEED = (
    0.5  # of the joints in the self-check: well outside the band where friction is soft
)


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
        X_BS: Pose of the plate's sensor S in the bedplate frame B.
        sensors: Where those of the robot's force sensors stand, (6 S,).
        tare: Static wrench of what stands on the plate without moving, (6,) [N, N m],
            bedplate axes, about O^0.
    """

    model: mujoco.MjModel
    order: NDArray[np.int64]
    dofs: Array
    positions: NDArray[np.int64]
    velocities: NDArray[np.int64]
    plate: NDArray[np.int64]
    X_BS: Transform
    tare: Array
    sensors: NDArray[np.int64]


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
    even = np.arange(tree.n) % 2 == 0
    states = [
        _driven(plant, tree, path, moving) for moving in (np.ones(tree.n), even, ~even)
    ]
    own = np.max(
        [np.abs(state.motor) + np.abs(state.friction) for state in states], axis=0
    )
    for state in states:
        scale = max(np.abs(state.need).max(), np.abs(state.motor).max())
        scale += np.abs(state.wrench).max()
        # a light joint's are small beside others'
        allowed = np.minimum(SAME * scale, _OWN * own)
        wrong = np.flatnonzero(np.abs(state.other + state.friction) > allowed)
        said = [
            f"'{tree.names[k]}' ({state.other[k]:.4g} found, {-state.friction[k]:.4g} of friction "
            "expected)"
            for k in wrong
        ]
        if said:
            raise ModelError(
                f"{path}: besides motor and friction something else acts on {few(said)} [N m or "
                "N], which the robot that was read does not have"
            )
        felt = np.abs(state.expected_wrench - state.wrench).max()
        if (
            max(felt, np.abs(state.need - state.motor - state.other).max())
            > SAME * scale
        ):
            raise ModelError(
                f"{path}: the plate or the joints do not feel the robot that was read (off by "
                f"{felt:.3g} N or N m); does every arm stand on the sensor, is it unfiltered?"
            )


class _State(NamedTuple):
    """What acts in the plant, and what the tree expects, (n,) each [N m or N]."""

    motor: Array
    friction: Array  # what friction should take
    other: Array  # what acts besides the motors
    need: Array  # what the joints need for the acceleration that the plant has
    wrench: Array  # what the plate feels, bedplate axes, about O^0, (6,) [N, N m]
    expected_wrench: Array


def _driven(plant: Plant, tree: Tree, path: Path, moving: Array) -> _State:
    """Drive the plant through a state near the middle of all ranges."""
    rng, limits = np.random.default_rng(0), limits_of(tree)
    q = limits.middle + rng.uniform(-0.1, 0.1, tree.n) * (limits.high - limits.low)
    qd = (
        moving
        * _SPEED
        * rng.choice([-1.0, 1.0], tree.n)
        * rng.uniform(0.5, 1.0, tree.n)
    )
    qdd = moving * rng.uniform(-1.0, 1.0, tree.n)
    friction, rotor = friction_torque(tree, qd), ROTOR.coefficients(tree)
    wanted = Motion(np.zeros(1), q[None], qd[None], qdd[None])
    motor = joint_forces(tree, wanted)[0] + rotor * qdd + friction
    data = mujoco.MjData(plant.model)
    data.qpos[plant.order], data.qvel[plant.order], data.ctrl[:] = q, qd, motor
    mujoco.mj_forward(plant.model, data)
    found = data.qacc[plant.order]
    if not (np.abs(found) < 1e12).all():
        raise ModelError(
            f"{path}: MuJoCo finds no finite acceleration; a body may lack inertia"
        )
    motion = replace(wanted, qdd=found[None])
    return _State(
        motor=motor,
        friction=friction,
        other=(data.qfrc_passive + data.qfrc_constraint)[plant.order],
        need=joint_forces(tree, motion)[0] + rotor * found,
        wrench=plant.X_BS.wrench(data.sensordata[plant.plate]),
        expected_wrench=base_wrench(tree, motion)[0] + plant.tare,
    )


_OF_JOINTS = {
    "position": mujoco.mjtSensor.mjSENS_JOINTPOS,
    "velocity": mujoco.mjtSensor.mjSENS_JOINTVEL,
}
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
        ModelError: MuJoCo refuses the model, or it is not the robot that was read.
        UnknownName: A sensor is at a link that is not there.
    """
    if not friction or any(effect.owns_friction for effect in effects):
        tree = tree.without_friction()
    path, spec, prefix = model.path, robot_spec(model), ""
    with no_mujoco_warnings():  # attaching overrides timestep and camera, and says so
        if _plate_of(compile_spec(spec, path)) is None:
            spec, prefix = _on_plate(spec), _PREFIX
        _equip(spec, tree, step, prefix, changed)
        for effect in effects:
            effect.equip(spec, tree, prefix)
        for sensor in sensors:
            _add_sensor(spec, sensor, prefix)
        compiled = compile_spec(spec, path)
        plate = _plate_of(compiled)
        if plate is None:
            raise ModelError(
                f"{path}: the sensing bedplate was lost when MuJoCo compiled it"
            )
        plant = _plant_of(compiled, tree, plate, prefix, sensors)
        check_plant(plant, tree, path)
        for effect in effects:
            effect.disturb(spec, tree, prefix)
        return _plant_of(compile_spec(spec, path), tree, plate, prefix, sensors)


def robot_spec(model: ModelFile) -> mujoco.MjSpec:
    """MuJoCo's editable model of a model file, nothing added.

    Args:
        model: The file, and how it is read.

    Raises:
        ModelError: MuJoCo refuses it.
    """
    source = model.read()
    if isinstance(source, MjcfModel):
        return source.spec
    root = source.root
    for tag, key in (("link", "name"), ("parent", "link"), ("child", "link")):
        for each in root.iter(tag):
            if each.get(key) == "world":
                each.set(key, _WORLD)
    options = {
        "fusestatic": "false",
        "balanceinertia": "false",
        "discardvisual": "true",
    }
    ET.SubElement(ET.SubElement(root, "mujoco"), "compiler", options)
    with no_mujoco_warnings():
        try:
            spec = mujoco.MjSpec.from_string(ET.tostring(root, encoding="unicode"))
        except ValueError as error:
            raise ModelError(f"{model.path}: {' '.join(str(error).split())}") from None
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
        # the drive limits itself
        joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
        known = tree.joints[tree.index(joint.name.removeprefix(prefix))]
        if known.name in changed:
            joint.frictionloss, joint.armature = known.coulomb, known.rotor_inertia
            joint.damping = np.concatenate(
                [[known.viscous], np.zeros(np.size(joint.damping) - 1)]
            )
        if not known.coulomb:
            joint.frictionloss = 0.0
        if not known.viscous:
            joint.damping = np.zeros_like(joint.damping)
        joint.solref_friction = [2 * step, 1]
        joint.solimp_friction = [0.9999, 0.9999, 0.001, 0.5, 2]
    for name in (prefix + name for name in tree.names):
        motor = spec.add_actuator(name=f"testbed/{name}", target=name)
        motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
        for signal, kind in _OF_JOINTS.items():
            at = {"objtype": mujoco.mjtObj.mjOBJ_JOINT, "objname": name}
            spec.add_sensor(name=_label(signal, name), type=kind, **at)


def _add_sensor(spec: mujoco.MjSpec, sensor: ForceSensor, prefix: str) -> None:
    """A force and a torque sensor at the cut before a link, at its place and along its axes."""
    # not the world
    bodies = {each.name.removeprefix(prefix): each for each in spec.bodies[1:]}
    if sensor.link not in bodies:
        raise UnknownName("link", sensor.link, sorted(bodies))
    body = bodies[sensor.link]
    quaternion = to_quaternion(sensor.rotation)
    body.add_site(name=_SENSOR + sensor.name, pos=sensor.position, quat=quaternion)
    _add_sensors(spec, _SENSOR + sensor.name)


def _add_sensors(spec: mujoco.MjSpec, site: str) -> None:
    for name, kind in (
        ("force", mujoco.mjtSensor.mjSENS_FORCE),
        ("torque", mujoco.mjtSensor.mjSENS_TORQUE),
    ):
        at = {"objtype": mujoco.mjtObj.mjOBJ_SITE, "objname": site}
        spec.add_sensor(name=f"{site}/{name}", type=kind, **at)


def _plant_of(
    model: mujoco.MjModel,
    tree: Tree,
    plate: tuple[int, int],
    prefix: str,
    sensors: Sequence[ForceSensor],
) -> Plant:
    """The plant of a compiled model.

    Args:
        model: The robot on its plate.
        tree: The robot.
        plate: Numbers of the plate's force and torque sensor.
        prefix: Of the joints' names in `model`.
        sensors: In the robot, besides the bedplate's.
    """
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    site = int(model.sensor_objid[plate[0]])

    def addresses(names: Iterable[str], size: int) -> NDArray[np.int64]:
        """Where sensors stand among the sensor data, all their components one after the other."""
        first = np.array([model.sensor(name).adr[0] for name in names], dtype=np.int64)
        return (first[:, None] + np.arange(size)).ravel()

    order = np.array([model.joint(prefix + name).dofadr[0] for name in tree.names])
    wrists = [
        f"{_SENSOR}{each.name}/{what}"
        for each in sensors
        for what in ("force", "torque")
    ]
    return Plant(
        model=model,
        order=order,
        dofs=_dofs(model, order),
        positions=addresses(
            (_label("position", prefix + name) for name in tree.names), 1
        ),
        velocities=addresses(
            (_label("velocity", prefix + name) for name in tree.names), 1
        ),
        plate=np.concatenate([model.sensor_adr[s] + np.arange(3) for s in plate]),
        X_BS=Transform(data.site_xmat[site].reshape(3, 3), data.site_xpos[site]),
        tare=_tare(model, data, int(model.site_bodyid[site])),
        sensors=addresses(wrists, 3),
    )


def _label(signal: str, joint: str) -> str:
    """Name of a sensor of a joint."""
    return f"testbed/{signal}/{joint}"


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
    """Numbers of a force and a torque sensor at one site that is welded to the world."""
    sites = list(
        zip(model.sensor_type.tolist(), model.sensor_objid.tolist(), strict=True)
    )
    kinds = mujoco.mjtSensor.mjSENS_FORCE, mujoco.mjtSensor.mjSENS_TORQUE
    for site in np.flatnonzero(model.body_weldid[model.site_bodyid] == 0).tolist():
        force, torque = ((int(kind), site) for kind in kinds)
        if force in sites and torque in sites:
            return sites.index(force), sites.index(torque)
    return None


def _tare(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> Array:
    """Static wrench of the bodies above the sensor that do not move, (6,) [N, N m]."""
    still = [body]
    for other in range(body + 1, model.nbody):
        if model.body_parentid[other] in still and not model.body_dofnum[other]:
            still.append(other)
    mass, gravity = model.body_mass[still], model.opt.gravity
    return np.concatenate(
        [-mass.sum() * gravity, -np.cross(mass @ data.xipos[still], gravity)]
    )
