"""The robot on its sensing bedplate, as MuJoCo simulates it.

MuJoCo reads the model file itself, so that simulation and `Tree` meet only in the file.
Actuators of the file are replaced by one torque motor a joint. A force and a torque
sensor at a site that is welded to the world are taken as the plate; where the file has
none, the whole robot is put on a plate of its own.

Integration is by Runge-Kutta of fourth order: the positions that encoders see are then
those of the motion whose wrench the plate feels. MuJoCo's Euler methods treat velocities
half a step late or damping implicitly, and an identifier that differentiates positions
pays for it (docs/architecture.md).
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from testbed.arrays import Array
from testbed.errors import ModelError
from testbed.robot.formats.mjcf import repaired_spec
from testbed.robot.formats.mjcf_compile import MASSLESS, compile_spec, no_mujoco_warnings
from testbed.robot.formats.urdf import repaired_xml
from testbed.robot.model_file import ModelFile, model_format
from testbed.robot.tree import Tree
from testbed.simulation.effect import PLATE_FREEDOM, Effect
from testbed.simulation.plant import Plant, check_plant

_PLATE = "testbed/bedplate"
_PREFIX = "testbed/robot/"  # of the names in a robot that is put on a plate of its own


def build_plant(
    model: ModelFile,
    tree: Tree,
    step: float,
    *,
    changed: Collection[str] = (),
    friction: bool = True,
    effects: Sequence[Effect] = (),
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

    Raises:
        ModelError: MuJoCo refuses the model, or an effect departs from its law.
    """
    if not friction or any(effect.owns_friction for effect in effects):
        tree = tree.without_friction()
    path, spec = model.path, _robot(model)
    prefix = ""
    with no_mujoco_warnings():  # attaching overrides timestep and camera, and says so
        if _plate_of(compile_spec(spec, path)) is None:
            spec, prefix = _on_plate(spec), _PREFIX
        _equip(spec, tree, step, prefix, changed)
        for effect in effects:
            effect.equip(spec, tree, prefix)
        plant = _plant_of(compile_spec(spec, path), tree, path, prefix)
        check_plant(plant, tree, path)
        for effect in effects:
            effect.disturb(spec, tree, prefix)
        if effects:
            plant = _plant_of(compile_spec(spec, path), tree, path, prefix)
    for effect in effects:
        flaw = effect.flaw(plant, tree)
        if flaw:
            raise ModelError(f"{path}: {effect.kind}: {flaw}")
    return plant


def _robot(model: ModelFile) -> mujoco.MjSpec:
    path = model.path
    how: dict[str, Any] = {"weld_root": model.weld_root, "repair": model.repair, "lock": model.lock}
    if model_format(path) == "mjcf":
        return repaired_spec(path, **how).spec
    root, *_ = repaired_xml(path, **how)
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
    for name, kind in (
        ("force", mujoco.mjtSensor.mjSENS_FORCE),
        ("torque", mujoco.mjtSensor.mjSENS_TORQUE),
    ):
        at = {"objtype": mujoco.mjtObj.mjOBJ_SITE, "objname": _PLATE}
        spec.add_sensor(name=f"{_PLATE}/{name}", type=kind, **at)
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
