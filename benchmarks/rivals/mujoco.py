"""mujoco.sysid: rollouts as its documentation has them, and inverse dynamics as an expert would.

Its optimizer takes any residual. An expert puts filtered motions through mj_inverse, on a free
base, whose forces are the plate's: no rollout, no start values, no chaos. Bodies are its
log-Cholesky ones, which start at the model file's.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from importlib import import_module
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
from scipy.signal import butter, filtfilt

from benchmarks.rivals.case import Answer, Array, Case, answer

sysid: Any = import_module("mujoco.sysid")  # typed, in a package that is not

CUTOFF, RATE, EDGE = 5.0, 25.0, 0.5
"""Of all filters [Hz]; rows a second; left out at both ends [s]."""

WINDOWS, LENGTH, ITERATIONS = 12, 0.3, 25
"""Rollouts, how long each [s], and steps of their optimizer: more take minutes each."""

STEPS = 12
"""Of the optimizer of inverse dynamics: it has converged to 1e-6."""


# the user's lines
def specification(case: Case, base: str) -> mujoco.MjSpec:
    """The URDF on a base that is "floating" or "fixed"."""
    robot = ElementTree.parse(case.urdf).getroot()
    children = {str(each.get("link")) for each in robot.iterfind("joint/child")}
    root = next(link for link in robot.iterfind("link") if link.get("name") not in children)
    root.append(ElementTree.fromstring(
        '<inertial><mass value="1e-3"/><inertia ixx="1e-6" iyy="1e-6" izz="1e-6" ixy="0" ixz="0" '
        'iyz="0"/></inertial>'))  # fmt: skip
    robot.append(ElementTree.fromstring('<link name="ground"/>'))
    root.set("name", "plate")
    for parent in robot.iterfind("joint/parent"):
        if parent.get("link") not in children:
            parent.set("link", "plate")
    robot.append(ElementTree.fromstring(
        f'<joint name="base" type="{base}"><parent link="ground"/><child link="plate"/></joint>'
    ))  # fmt: skip
    fused = str(base == "floating").lower()
    robot.append(ElementTree.fromstring(
        f'<mujoco><compiler fusestatic="{fused}" balanceinertia="true"/></mujoco>'))  # fmt: skip
    spec = mujoco.MjSpec.from_string(ElementTree.tostring(robot, encoding="unicode"))
    for joint in spec.joints:
        joint.damping[:] = joint.frictionloss = 0.0  # parameters of their own
    return spec


def bodies(spec: mujoco.MjSpec, case: Case) -> Any:
    """A body of each joint, log-Cholesky."""
    model, found = spec.compile(), {}
    for name in case.joints:
        body = model.body(model.joint(name).bodyid[0]).name

        def modify(spec: mujoco.MjSpec, param: Any, body: str = body) -> None:
            sysid.apply_body_inertia(spec, body, param)
            spec.body(body).iquat = [1, 0, 0, 0]  # version 4.0.0 leaves it nan: does not compile

        found[body] = sysid.body_inertia_param(
            spec, model, body, sysid.InertiaType.Pseudo, modifier=modify
        )
    return sysid.ParameterDict(found)


# end


def inverse(model: mujoco.MjModel, joints: tuple[str, ...], states: tuple[Array, ...]) -> Array:
    """Forces of the base, (M, 6), then of the joints, (M, n)."""
    # the user's lines
    data = mujoco.MjData(model)
    q, v = ([getattr(model.joint(j), at)[0] for j in joints] for at in ("qposadr", "dofadr"))
    forces = np.empty((len(states[0]), model.nv))
    for k, (position, velocity, acceleration) in enumerate(zip(*states, strict=True)):
        data.qpos[q], data.qvel[v], data.qacc[v] = position, velocity, acceleration
        mujoco.mj_inverse(model, data)
        forces[k] = data.qfrc_inverse
    return forces[:, [*range(6), *v]]
    # end


def expert(case: Case, signal: str) -> Answer:
    """By inverse dynamics of filtered motions, channels weighted by their noise."""
    start = time.process_time()
    # the user's lines: expert
    b, a = butter(4, CUTOFF, fs=case.rate)
    raw = case.wrench if signal == "wrench" else case.torque
    q, wanted = (filtfilt(b, a, s, axis=0) for s in (case.q, raw))
    weight = 1 / (raw - wanted).std(axis=0)
    qd = np.gradient(q, 1 / case.rate, axis=0)
    qdd = np.gradient(qd, 1 / case.rate, axis=0)
    edge, every = round(EDGE * case.rate), round(case.rate / RATE)
    states = tuple(each[edge:-edge:every] for each in (q, qd, qdd))
    wanted = wanted[edge:-edge:every]
    used = np.ones(wanted.shape, dtype=bool)
    if signal == "torque":
        used = case.away(qd, 0.75 / CUTOFF)[edge:-edge:every]
    spec = specification(case, "floating")
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    params = bodies(spec, case)
    if signal == "torque":
        size = np.abs(wanted).max(axis=0)
        params.add(sysid.Parameter("dry", 0.05 * size, 0 * size, size))
        params.add(sysid.Parameter("viscous", 0.05 * size, 0 * size, size))

    def residual(x: Array, params: Any) -> tuple[list[Array], list[None], list[None]]:
        columns = x if x.ndim == 2 else x[:, None]
        found = []
        for each in columns.T:
            params.update_from_vector(each)
            forces = inverse(sysid.apply_param_modifiers(params, spec), case.joints, states)
            forces = forces[:, :6] if signal == "wrench" else forces[:, 6:]
            if signal == "torque":
                qd = states[1]
                forces = forces + params["dry"].value * np.sign(qd) + params["viscous"].value * qd
            off = (forces - wanted) * weight * used
            found.append(off.ravel())
        return [np.array(found).T if x.ndim == 2 else found[0]], [None], [None]

    params, _ = sysid.optimize(params, residual, verbose=False, max_iters=STEPS)
    # end
    cpu = time.process_time() - start
    return {"prediction": predicted(params, spec, case, signal), "cpu": cpu}


def rollouts(case: Case, signal: str) -> Answer:
    """By rollouts from measured torques, against positions, and the plate's sensors."""
    start = time.process_time()
    # the user's lines: plain
    spec = specification(case, "fixed")
    spec.option.timestep = 1 / case.rate
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for name in case.joints:
        spec.add_actuator(name=f"motor_{name}", target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        spec.add_sensor(name=f"q_{name}", type=mujoco.mjtSensor.mjSENS_JOINTPOS,
                        objtype=mujoco.mjtObj.mjOBJ_JOINT, objname=name)  # fmt: skip
    measured = [case.q]
    if signal == "wrench":
        spec.body("plate").add_site(name="plate")
        for kind in ("FORCE", "TORQUE"):
            spec.add_sensor(name=kind, type=getattr(mujoco.mjtSensor, f"mjSENS_{kind}"),
                            objtype=mujoco.mjtObj.mjOBJ_SITE, objname="plate")  # fmt: skip
        measured.append(case.wrench)
    params = bodies(spec, case)
    for name, most in zip(case.joints, np.abs(case.torque).max(axis=0), strict=True):

        def dry(spec: mujoco.MjSpec, param: Any, name: str = name) -> None:
            spec.joint(name).frictionloss = param.value[0]

        def viscous(spec: mujoco.MjSpec, param: Any, name: str = name) -> None:
            spec.joint(name).damping[0] = param.value[0]

        for kind, modifier in (("dry", dry), ("viscous", viscous)):
            params.add(sysid.Parameter(f"{kind}_{name}", 0.05 * most, 0.0, most, modifier=modifier))
    model, signals = spec.compile(), np.hstack(measured)
    b, a = butter(4, CUTOFF, fs=case.rate)
    q = filtfilt(b, a, case.q, axis=0)
    qd = np.gradient(q, 1 / case.rate, axis=0)
    size = round(LENGTH * case.rate)
    order = np.argsort([model.joint(name).dofadr[0] for name in case.joints])
    states, controls, sensors = [], [], []
    for first in np.linspace(0.5, case.t[-1] - 1, WINDOWS) * case.rate:
        part = slice(int(first), int(first) + size)
        t = case.t[part] - case.t[part][0]
        states.append(sysid.create_initial_state(model, q[part][0][order], qd[part][0][order]))
        motors = [f"motor_{name}" for name in case.joints]
        controls.append(sysid.TimeSeries.from_control_names(t, case.torque[part], model, motors))
        sensors.append(sysid.TimeSeries.from_names(t, signals[part], model))
    names = [f"window {k}" for k in range(WINDOWS)]
    sequences = sysid.ModelSequences("robot", spec, names, states, controls, sensors)
    residual = sysid.build_residual_fn(models_sequences=[sequences])
    params, _ = sysid.optimize(params, residual, verbose=False, max_iters=ITERATIONS)
    # end
    cpu = time.process_time() - start
    return {
        "prediction": predicted(params, specification(case, "floating"), case, signal),
        "cpu": cpu,
        "model": sysid.apply_param_modifiers_spec(params, spec).to_xml(),
    }


def predicted(params: Any, spec: mujoco.MjSpec, case: Case, signal: str) -> Array:
    """Along the unseen motion, without friction."""
    model = sysid.apply_param_modifiers(params, spec)
    model.dof_damping[:] = model.dof_frictionloss[:] = 0.0
    forces = inverse(model, case.joints, case.unseen)
    return forces[:, :6] if signal == "wrench" else forces[:, 6:]


SETTINGS: dict[str, Callable[[Case, str], Answer]] = {"expert": expert, "plain": rollouts}

if __name__ == "__main__":
    answer(SETTINGS, mujoco.__version__)
