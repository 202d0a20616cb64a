"""MuJoCo plant of the robot on its bedplate, checked against the robot's tree."""

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
from testbed.core.base.errors import ModelError, UnknownName, shortened_list
from testbed.core.base.transform import Transform
from testbed.core.dynamics.newton_euler import Motion, base_wrench, joint_forces
from testbed.core.robot.drive_torque import friction_torque
from testbed.core.robot.force_sensor import ForceSensor
from testbed.core.robot.formats.mjcf import MjcfModel
from testbed.core.robot.formats.mjcf_compile import (
    MIN_COMPILED_MASS,
    compile_spec,
    suppress_mujoco_warnings,
)
from testbed.core.robot.friction import ROTOR
from testbed.core.robot.model_file import ModelFile
from testbed.core.robot.rotations import matrix_to_quaternion
from testbed.core.robot.tree import Tree
from testbed.lab.simulation.effect import Effect
from testbed.motion.limits import joint_limits

RELATIVE_TOLERANCE = 1e-9
"""Largest relative difference between the plant and the tree's equations of motion."""

_JOINT_TOLERANCE = 1e-6
"""Largest other force on a joint, relative to the largest motor torque and friction of this
joint."""

_CHECK_SPEED = 0.5
"""Joint speed in the check [rad/s or m/s], well above the speeds of MuJoCo's soft dry friction."""


@dataclass(frozen=True, eq=False)
class Plant:
    """Compiled MuJoCo model with the indices needed to drive it and to read its sensors.

    Attributes:
        model: The MuJoCo model.
        velocity_index: Index of each joint of the tree among MuJoCo's velocities, (n,).
        velocity_ratios: Ratios of MuJoCo's velocities to the joints' velocities, (nv, n): 1 for the
            joint itself, the gear ratio for a degree of freedom coupled to it.
        position_index: Indices of the joint positions in the sensor data, (n,).
        velocity_sensor_index: Indices of the joint velocities in the sensor data, (n,).
        plate_index: Indices of the plate's force and moment in the sensor data, (6,).
        X_BS: Pose of the plate's sensor S in the bedplate frame B.
        force_sensor_index: Indices of the components of the S force sensors in the sensor data, (6
            S,).
        tare: Static wrench of the pedestal (the bodies that do not move), (6,) [N, N m], along the
            bedplate's axes and about its origin O^0.
    """

    model: mujoco.MjModel
    velocity_index: NDArray[np.int64]
    velocity_ratios: Array
    position_index: NDArray[np.int64]
    velocity_sensor_index: NDArray[np.int64]
    plate_index: NDArray[np.int64]
    X_BS: Transform
    tare: Array
    force_sensor_index: NDArray[np.int64]


def check_plant(plant: Plant, tree: Tree, path: Path) -> None:
    """Check that the plant obeys the tree's equations of motion in three states.

    The motors apply the torques of a motion of all joints, or of every other joint; without motors,
    a light link would not overcome its dry friction, and MuJoCo's dry friction equals Coulomb's
    only in motion. The check detects other influences on the robot in a model file: springs,
    tendons, fluid, gravity compensation, bodies that do not stand on the plate.

    Args:
        plant: The robot on its bedplate.
        tree: The robot as read; without friction if the plant has none.
        path: Path of the model file, for the error message.

    Raises:
        ModelError: Forces, accelerations or wrench differ; the message names the joints.
    """
    even = np.arange(tree.n) % 2 == 0
    states = [
        _driven_state(plant, tree, path, moving)
        for moving in (np.ones(tree.n), even, ~even)
    ]
    joint_scale = np.max(
        [np.abs(state.motor) + np.abs(state.friction) for state in states], axis=0
    )
    for state in states:
        scale = max(np.abs(state.required_torque).max(), np.abs(state.motor).max())
        scale += np.abs(state.wrench).max()
        # forces of a light joint are small beside the others'
        allowed = np.minimum(RELATIVE_TOLERANCE * scale, _JOINT_TOLERANCE * joint_scale)
        joints = np.flatnonzero(np.abs(state.other + state.friction) > allowed)
        lines = [
            f"'{tree.names[k]}' ({state.other[k]:.4g} found, {-state.friction[k]:.4g} of friction "
            "expected)"
            for k in joints
        ]
        if lines:
            raise ModelError(
                f"{path}: besides motor and friction something else acts on "
                f"{shortened_list(lines)} [N m or N], which the robot that was read does not have"
            )
        error = np.abs(state.expected_wrench - state.wrench).max()
        if (
            max(
                error,
                np.abs(state.required_torque - state.motor - state.other).max(),
            )
            > RELATIVE_TOLERANCE * scale
        ):
            raise ModelError(
                f"{path}: the plate or the joints do not feel the robot that was read (off by "
                f"{error:.3g} N or N m); does every arm stand on the sensor, is it unfiltered?"
            )


class _CheckState(NamedTuple):
    """Forces in the plant, and expected forces from the tree, (n,) each [N m or N]."""

    motor: Array
    friction: Array  # expected friction torque
    other: Array  # passive and constraint forces of MuJoCo, friction included
    required_torque: Array  # inverse dynamics of the plant's acceleration
    wrench: Array  # measured by the plate, bedplate axes, about O^0, (6,) [N, N m]
    expected_wrench: Array


def _driven_state(plant: Plant, tree: Tree, path: Path, moving: Array) -> _CheckState:
    """Forces in the plant in a random state near the middle of the joint ranges.

    The motors apply the tree's inverse dynamics, including friction and rotors.

    Args:
        plant: The robot on its bedplate.
        tree: The robot as read.
        path: Path of the model file, for the error message.
        moving: 1 for each joint that moves, 0 for the others, (n,).

    Raises:
        ModelError: An acceleration is not finite.
    """
    rng, limits = np.random.default_rng(0), joint_limits(tree)
    q = limits.middle + rng.uniform(-0.1, 0.1, tree.n) * (limits.high - limits.low)
    qd = (
        moving
        * _CHECK_SPEED
        * rng.choice([-1.0, 1.0], tree.n)
        * rng.uniform(0.5, 1.0, tree.n)
    )
    qdd = moving * rng.uniform(-1.0, 1.0, tree.n)
    friction, rotor = friction_torque(tree, qd), ROTOR.coefficients(tree)
    nominal = Motion(np.zeros(1), q[None], qd[None], qdd[None])
    motor = joint_forces(tree, nominal)[0] + rotor * qdd + friction
    data = mujoco.MjData(plant.model)
    data.qpos[plant.velocity_index], data.qvel[plant.velocity_index], data.ctrl[:] = (
        q,
        qd,
        motor,
    )
    mujoco.mj_forward(plant.model, data)
    plant_qdd = data.qacc[plant.velocity_index]
    if not (np.abs(plant_qdd) < 1e12).all():
        raise ModelError(
            f"{path}: MuJoCo finds no finite acceleration; a body may lack inertia"
        )
    motion = replace(nominal, qdd=plant_qdd[None])
    return _CheckState(
        motor=motor,
        friction=friction,
        other=(data.qfrc_passive + data.qfrc_constraint)[plant.velocity_index],
        required_torque=joint_forces(tree, motion)[0] + rotor * plant_qdd,
        wrench=plant.X_BS.wrench(data.sensordata[plant.plate_index]),
        expected_wrench=base_wrench(tree, motion)[0] + plant.tare,
    )


_JOINT_SENSORS = {
    "position": mujoco.mjtSensor.mjSENS_JOINTPOS,
    "velocity": mujoco.mjtSensor.mjSENS_JOINTVEL,
}
_PLATE_NAME = "testbed/bedplate"
_SENSOR_PREFIX = "testbed/sensor/"
_WORLD_LINK = (
    "testbed/world"  # new name of a link "world", MuJoCo's name of the fixed world
)
_ROBOT_PREFIX = (
    "testbed/robot/"  # prefix of names in a robot that is attached to an added plate
)


def build_plant(
    model: ModelFile,
    tree: Tree,
    step: float,
    *,
    changed_joints: Collection[str] = (),
    with_friction: bool = True,
    effects: Sequence[Effect] = (),
    sensors: Sequence[ForceSensor] = (),
) -> Plant:
    """Build the plant: the robot of a model file on its sensing bedplate.

    Args:
        model: Model file, and the settings used to read it.
        tree: The robot with its effects; it gives joint names, joint order and gravity.
        step: Integration step [s].
        changed_joints: Names of joints whose friction and rotor inertia are the tree's, not the
            file's.
        with_friction: True to simulate the joints' friction.
        effects: Effects in the plant, adapted to this robot.
        sensors: Force sensors in the robot, in addition to the bedplate's.

    Raises:
        ModelError: MuJoCo refuses the model, or the plant differs from the tree.
        UnknownName: A sensor is mounted on an unknown link.
    """
    if not with_friction or any(effect.owns_friction for effect in effects):
        tree = tree.without_friction()
    path, spec, prefix = model.path, robot_spec(model), ""
    with (
        suppress_mujoco_warnings()
    ):  # attaching warns of the overridden timestep and camera
        if _plate_sensors(compile_spec(spec, path)) is None:
            spec, prefix = _robot_on_plate(spec), _ROBOT_PREFIX
        _configure(spec, tree, step, prefix, changed_joints)
        for effect in effects:
            effect.add_to_model(spec, tree, prefix)
        for sensor in sensors:
            _add_sensor(spec, sensor, prefix)
        compiled = compile_spec(spec, path)
        plate = _plate_sensors(compiled)
        if plate is None:
            raise ModelError(
                f"{path}: the sensing bedplate was lost when MuJoCo compiled it"
            )
        plant = _compiled_plant(compiled, tree, plate, prefix, sensors)
        check_plant(plant, tree, path)
        for effect in effects:
            effect.change_model(spec, tree, prefix)
        return _compiled_plant(compile_spec(spec, path), tree, plate, prefix, sensors)


def robot_spec(model: ModelFile) -> mujoco.MjSpec:
    """MuJoCo's editable model of an MJCF or URDF file, without additions.

    Links of a URDF file that are fixed to others remain separate bodies with unchanged inertias. A
    link with the name "world" is renamed.

    Args:
        model: Model file, and the settings used to read it.

    Raises:
        ModelError: MuJoCo refuses the file.
    """
    source = model.read()
    if isinstance(source, MjcfModel):
        return source.spec
    root = source.root
    for tag, key in (("link", "name"), ("parent", "link"), ("child", "link")):
        for element in root.iter(tag):
            if element.get(key) == "world":
                element.set(key, _WORLD_LINK)
    options = {
        "fusestatic": "false",
        "balanceinertia": "false",
        "discardvisual": "true",
    }
    ET.SubElement(ET.SubElement(root, "mujoco"), "compiler", options)
    with suppress_mujoco_warnings():
        try:
            spec = mujoco.MjSpec.from_string(ET.tostring(root, encoding="unicode"))
        except ValueError as error:
            raise ModelError(f"{model.path}: {' '.join(str(error).split())}") from None
    spec.compiler.boundmass = spec.compiler.boundinertia = MIN_COMPILED_MASS
    return spec


def _robot_on_plate(robot: mujoco.MjSpec) -> mujoco.MjSpec:
    """World that contains a plate at the origin, with the robot attached to it.

    The plate has a force and a torque sensor.
    """
    spec = mujoco.MjSpec()
    spec.compiler.boundmass = spec.compiler.boundinertia = MIN_COMPILED_MASS
    site = spec.worldbody.add_body(name=_PLATE_NAME).add_site(name=_PLATE_NAME)
    spec.attach(robot, site=site, prefix=_ROBOT_PREFIX)
    _add_sensors(spec, _PLATE_NAME)
    return spec


def _configure(
    spec: mujoco.MjSpec, tree: Tree, step: float, prefix: str, changed: Collection[str]
) -> None:
    """Set integrator, gravity, friction and armature; add motors and joint sensors.

    The integrator is Runge-Kutta of fourth order, without contacts and torque limits. Dry and
    viscous friction are zero where they are zero in the tree. Dry friction is constant at speeds
    above 0.01 rad/s.

    Args:
        spec: MuJoCo's editable model, modified.
        tree: The robot.
        step: Integration step [s].
        prefix: Prefix of the joints' names in `spec`.
        changed: Names of joints whose friction and rotor inertia are taken from the tree.
    """
    option = spec.option
    option.timestep, option.gravity = step, tree.gravity
    option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    option.tolerance, option.iterations = 1e-14, 50
    flags = mujoco.mjtDisableBit  # a diverged state must stay, to be detected
    option.disableflags = int(flags.mjDSBL_CONTACT) | int(flags.mjDSBL_AUTORESET)
    option.enableflags = 0
    for joint in spec.joints:
        # the controller limits the torque
        joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
        tree_joint = tree.joints[tree.index(joint.name.removeprefix(prefix))]
        if tree_joint.name in changed:
            joint.frictionloss, joint.armature = (
                tree_joint.coulomb,
                tree_joint.rotor_inertia,
            )
            joint.damping = np.concatenate(
                [[tree_joint.viscous], np.zeros(np.size(joint.damping) - 1)]
            )
        if not tree_joint.coulomb:
            joint.frictionloss = 0.0
        if not tree_joint.viscous:
            joint.damping = np.zeros_like(joint.damping)
        joint.solref_friction = [2 * step, 1]
        joint.solimp_friction = [0.9999, 0.9999, 0.001, 0.5, 2]
    for name in (prefix + name for name in tree.names):
        motor = spec.add_actuator(name=f"testbed/{name}", target=name)
        motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
        for signal, kind in _JOINT_SENSORS.items():
            target = {"objtype": mujoco.mjtObj.mjOBJ_JOINT, "objname": name}
            spec.add_sensor(name=_sensor_name(signal, name), type=kind, **target)


def _add_sensor(spec: mujoco.MjSpec, sensor: ForceSensor, prefix: str) -> None:
    """Add force and torque sensors between a link and its parent, in the sensor's frame.

    Raises:
        UnknownName: The model has no such link.
    """
    # without the world
    bodies = {each.name.removeprefix(prefix): each for each in spec.bodies[1:]}
    if sensor.link not in bodies:
        raise UnknownName("link", sensor.link, sorted(bodies))
    body = bodies[sensor.link]
    quaternion = matrix_to_quaternion(sensor.rotation)
    body.add_site(
        name=_SENSOR_PREFIX + sensor.name, pos=sensor.position, quat=quaternion
    )
    _add_sensors(spec, _SENSOR_PREFIX + sensor.name)


def _add_sensors(spec: mujoco.MjSpec, site: str) -> None:
    """Add a force and a torque sensor at a site."""
    for name, kind in (
        ("force", mujoco.mjtSensor.mjSENS_FORCE),
        ("torque", mujoco.mjtSensor.mjSENS_TORQUE),
    ):
        target = {"objtype": mujoco.mjtObj.mjOBJ_SITE, "objname": site}
        spec.add_sensor(name=f"{site}/{name}", type=kind, **target)


def _compiled_plant(
    model: mujoco.MjModel,
    tree: Tree,
    plate: tuple[int, int],
    prefix: str,
    sensors: Sequence[ForceSensor],
) -> Plant:
    """Plant for a compiled model.

    Args:
        model: The robot on its plate.
        tree: The robot.
        plate: Indices of the plate's force and torque sensors.
        prefix: Prefix of the joints' names in `model`.
        sensors: Force sensors in the robot, in addition to the bedplate's.
    """
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    site = int(model.sensor_objid[plate[0]])

    def addresses(names: Iterable[str], size: int) -> NDArray[np.int64]:
        """Indices of all components of the named sensors in the sensor data."""
        first = np.array([model.sensor(name).adr[0] for name in names], dtype=np.int64)
        return (first[:, None] + np.arange(size)).ravel()

    order = np.array([model.joint(prefix + name).dofadr[0] for name in tree.names])
    sensor_names = [
        f"{_SENSOR_PREFIX}{each.name}/{what}"
        for each in sensors
        for what in ("force", "torque")
    ]
    return Plant(
        model=model,
        velocity_index=order,
        velocity_ratios=_velocity_ratios(model, order),
        position_index=addresses(
            (_sensor_name("position", prefix + name) for name in tree.names), 1
        ),
        velocity_sensor_index=addresses(
            (_sensor_name("velocity", prefix + name) for name in tree.names), 1
        ),
        plate_index=np.concatenate([model.sensor_adr[s] + np.arange(3) for s in plate]),
        X_BS=Transform(data.site_xmat[site].reshape(3, 3), data.site_xpos[site]),
        tare=_static_wrench(model, data, int(model.site_bodyid[site])),
        force_sensor_index=addresses(sensor_names, 3),
    )


def _sensor_name(signal: str, joint: str) -> str:
    """Name of a joint's sensor in MuJoCo's model."""
    return f"testbed/{signal}/{joint}"


def _velocity_ratios(model: mujoco.MjModel, order: Array) -> Array:
    """Ratios of MuJoCo's velocities to the joints' velocities, (nv, n).

    A joint's own velocity has the ratio 1. The row of a follower in a joint equality is the
    equality's linear coefficient times the row of the leading joint.

    Args:
        model: The compiled model.
        order: Index of each joint among MuJoCo's velocities, (n,).
    """
    ratios = np.zeros((model.nv, len(order)))
    ratios[order, np.arange(len(order))] = 1.0
    for gear in np.flatnonzero(model.eq_type == int(mujoco.mjtEq.mjEQ_JOINT)):
        follower, leader = int(model.eq_obj1id[gear]), int(model.eq_obj2id[gear])
        if leader >= 0:
            leader_row = ratios[model.jnt_dofadr[leader]]
            ratios[model.jnt_dofadr[follower]] = model.eq_data[gear, 1] * leader_row
    return ratios


def _plate_sensors(model: mujoco.MjModel) -> tuple[int, int] | None:
    """Indices of the plate's force and torque sensors among MuJoCo's sensors.

    The plate is the first site that is welded to the world and has both sensors. The result is None
    if there is no such site.
    """
    sites = list(
        zip(model.sensor_type.tolist(), model.sensor_objid.tolist(), strict=True)
    )
    kinds = mujoco.mjtSensor.mjSENS_FORCE, mujoco.mjtSensor.mjSENS_TORQUE
    for site in np.flatnonzero(model.body_weldid[model.site_bodyid] == 0).tolist():
        force, torque = ((int(kind), site) for kind in kinds)
        if force in sites and torque in sites:
            return sites.index(force), sites.index(torque)
    return None


def _static_wrench(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> Array:
    """Static wrench on the plate's sensor that supports the fixed bodies, (6,) [N, N m].

    The wrench is along the world's axes and about the world's origin.

    Args:
        model: The compiled model.
        data: State of the model.
        body: Index of the body that carries the sensor.
    """
    fixed_bodies = [body]
    for candidate in range(body + 1, model.nbody):
        if (
            model.body_parentid[candidate] in fixed_bodies
            and not model.body_dofnum[candidate]
        ):
            fixed_bodies.append(candidate)
    mass, gravity = model.body_mass[fixed_bodies], model.opt.gravity
    return np.concatenate(
        [-mass.sum() * gravity, -np.cross(mass @ data.xipos[fixed_bodies], gravity)]
    )
