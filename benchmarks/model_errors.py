"""Robots with real elasticity, stands, cables and backlash in MuJoCo: what `identify` says of them.

MuJoCo carries out Fourier motions with a second joint on springs behind each motor, a base on six
springs, a tendon between a link and the room, or play; no column of `testbed` is in it. An error is
harmful where more than a tenth of the true parameters is beyond three sigma of the estimate without
model errors.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import mujoco
import numpy as np
import typer
from scipy.signal import butter, sosfiltfilt

import testbed as tb
from benchmarks.lines import print_lines
from testbed.core.base.arrays import Array
from testbed.core.estimation.estimate import Estimate
from testbed.core.parameters.symbols import standard
from tests.helpers.paths import GOLDEN

ROBOTS = "ur5,puma560_6,stanford,kuka_lwr4"
STEP, RATE, DURATION, SETTLED = 5e-4, 250, 20.0, 1.5
"""Of the simulation [s], of the recording [Hz]; of both [s]; before the recording begins [s]."""

RIGHT = {
    "elastic": {"elastic_joint"},
    "stand": {"stand"},
    "cable": {"cable", "joint_spring"},
    "backlash": {"backlash"},
}
NEAR = {"elastic_joint", "stand", "backlash"}
"""Families of errors that displace links by forces."""

SPRING, STAND, CABLE, PLAY = 20.0, 15.0, 8.0, 5e-4
"""Frequencies of joints and base on their springs [Hz]; stiffness of a cable [N/m]; half the play
[rad or m]: of size one."""


@dataclass(frozen=True, eq=False)
class Plant:
    """A simulated robot.

    Attributes:
        model: Of MuJoCo.
        motors: Names of the joints that motors move.
        springs: Names of the joints behind them; () for none.
    """

    model: Any
    motors: tuple[str, ...]
    springs: tuple[str, ...] = ()

    def places(self, names: Sequence[str]) -> tuple[Array, Array]:
        """Places of joints among positions and velocities."""
        joints = [self.model.joint(name).id for name in names]
        return self.model.jnt_qposadr[joints], self.model.jnt_dofadr[joints]


def linear(before: Any, value: float) -> Any:
    """Value of a key that holds a polynomial in newer versions of MuJoCo."""
    return [value, *[0.0] * (np.size(before) - 1)] if np.size(before) > 1 else value


def plant(path: str, error: str, size: float, inertia: Array | None = None) -> Plant:
    """A robot with an error of a size.

    Args:
        path: Of its URDF file.
        error: One of RIGHT, or "clean".
        size: Over that which is plausible.
        inertia: Mean of the mass matrix's diagonal, (n,).
    """
    spec = mujoco.MjSpec.from_file(path)
    spec.option.timestep = STEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.compiler.inertiafromgeom = 0
    for geometry in list(spec.geoms):
        spec.delete(geometry)
    joints, springs = list(spec.joints), []
    for k, joint in enumerate(joints):
        joint.limited, joint.actfrclimited, joint.armature = 0, 0, 1e-5
        joint.damping, joint.frictionloss = linear(joint.damping, 0.0), 0
        if error in ("elastic", "backlash") and inertia is not None:
            own = max(float(inertia[k]), 1e-3)
            behind = joint.parent.add_joint(
                name=f"behind_{joint.name}", type=joint.type, axis=joint.axis, pos=joint.pos
            )
            joint.armature = 0.3 * own
            springs.append(behind.name)
            if error == "elastic":
                stiffness = own * (2 * np.pi * SPRING) ** 2 / size
                behind.stiffness = linear(behind.stiffness, stiffness)
                damping = 0.02 * np.sqrt(stiffness * own)
            else:
                behind.limited, behind.range = 1, [-PLAY * size, PLAY * size]
                behind.solref_limit, damping = [0.002, 1.0], 0.4 * own
            behind.damping = linear(behind.damping, damping)
    names = tuple(joint.name for joint in joints)
    if error == "cable":
        link = joints[max(len(joints) - 2, 1)].parent
        link.add_site(name="held", pos=[0.03, -0.04, 0.05])
        spec.worldbody.add_site(name="hook", pos=[0.8, 0.8, 1.0])
        tendon = spec.add_tendon(name="cable")
        tendon.stiffness, tendon.springlength = linear(tendon.stiffness, CABLE * size), [0, 0]
        tendon.wrap_site("held")
        tendon.wrap_site("hook")
    if error == "stand":
        spec = on_springs(spec, size)
    for name in names:
        spec.add_actuator(name=f"motor_{name}", target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    return Plant(spec.compile(), names, tuple(springs))


def on_springs(robot: Any, size: float) -> Any:
    """A robot on a base with six springs."""
    mass = sum(body.mass for body in robot.bodies)
    spec = mujoco.MjSpec()
    spec.option.timestep, spec.option.integrator = STEP, robot.option.integrator
    spec.compiler.inertiafromgeom = 0
    base = spec.worldbody.add_body(name="base_on_springs")
    base.mass, base.inertia, base.explicitinertial = mass, [0.09 * mass] * 3, True
    rate = 2 * np.pi * STAND
    for kind, inertia in (("SLIDE", mass), ("HINGE", 0.09 * mass)):
        for k, axis in enumerate(np.eye(3)):
            joint = base.add_joint(
                name=f"{kind}{k}", type=getattr(mujoco.mjtJoint, f"mjJNT_{kind}"), axis=axis
            )
            joint.stiffness = linear(joint.stiffness, inertia * rate**2 / size)
            joint.damping = linear(joint.damping, 0.06 * inertia * rate)
    spec.attach(robot, prefix="", frame=base.add_frame())
    return spec


def mean_inertia(rigid: Plant) -> Array:
    """Mean of the mass matrix's diagonal over poses, (n,)."""
    data, found = mujoco.MjData(rigid.model), []
    for seed in range(20):
        data.qpos[:] = np.random.default_rng(seed).uniform(-1, 1, rigid.model.nq)
        data.qvel[:] = 0.0
        columns = []
        for unit in np.eye(rigid.model.nv):  # M e = f(e) - f(0)
            forces = []
            for acceleration in (unit, 0 * unit):
                data.qacc[:] = acceleration
                mujoco.mj_inverse(rigid.model, data)
                forces.append(data.qfrc_inverse.copy())
            columns.append(forces[0] - forces[1])
        found.append(np.diagonal(np.stack(columns)))
    return np.asarray(np.mean(found, axis=0))


def motion(joints: int, seed: int) -> tuple[Array, Array, Array]:
    """Positions, velocities and accelerations of sines at random frequencies, (M, n) each."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(DURATION / STEP)) * STEP
    rate = 2 * np.pi * rng.uniform(0.05, 0.5, (joints, 5))
    size, phase = rng.normal(size=(joints, 5)) / rate, rng.uniform(0, 2 * np.pi, (joints, 5))
    angle = rate * t[:, None, None] + phase
    q, qd = (size * np.sin(angle)).sum(axis=2), (size * rate * np.cos(angle)).sum(axis=2)
    qdd = -(size * rate**2 * np.sin(angle)).sum(axis=2)
    scale = np.minimum(1.5 / np.abs(qd).max(axis=0), 2.4 / np.ptp(q, axis=0))
    return q * scale + rng.uniform(-0.6, 0.6, joints), qd * scale, qdd * scale


def recorded(path: str, error: str, size: float, seed: int, names: Sequence[str]) -> tb.Recording:
    """What encoders and torque sensors of a simulated robot show."""
    rigid = plant(path, "clean", 1.0)
    inertia = mean_inertia(rigid)
    made = plant(path, error, size, inertia)
    q, qd, qdd = motion(len(made.motors), seed)
    model, data, inverse = made.model, mujoco.MjData(made.model), mujoco.MjData(rigid.model)
    at, rate = made.places(made.motors)
    behind = made.places(made.springs) if error == "elastic" else None
    rest, _ = rigid.places(rigid.motors)
    stiffness, damping = (inertia * (4 * np.pi * 8) ** 2, 4 * inertia * (2 * np.pi * 8))
    data.qpos[at], data.qvel[rate] = q[0], qd[0]
    shown, torque = np.zeros((2, *q.shape))
    for k in range(len(q)):
        inverse.qpos[rest], inverse.qvel[rest], inverse.qacc[rest] = q[k], qd[k], qdd[k]
        mujoco.mj_inverse(rigid.model, inverse)
        feedback = stiffness * (q[k] - data.qpos[at]) + damping * (qd[k] - data.qvel[rate])
        data.ctrl[:] = inverse.qfrc_inverse[rest] + feedback
        mujoco.mj_forward(model, data)
        shown[k] = data.qpos[at]
        # what goes through the joint; of rigid ones the motor's torque but for its rotor
        torque[k] = data.actuator_force - model.dof_armature[rate] * data.qacc[rate]
        if behind is not None:
            torque[k] = data.qfrc_passive[behind[1]]
        mujoco.mj_step(model, data)
    order = [made.motors.index(name) for name in names]
    return with_noise(shown[:, order], torque[:, order], names, seed)


def with_noise(q: Array, torque: Array, names: Sequence[str], seed: int) -> tb.Recording:
    """Recording of filtered signals with friction and noise."""
    low_pass = butter(4, 80 * 2 * STEP, output="sos")
    q, torque = (sosfiltfilt(low_pass, each, axis=0) for each in (q, torque))
    qd = np.gradient(q, STEP, axis=0)
    keep = slice(round(SETTLED / STEP), None, round(1 / RATE / STEP))
    q, qd, torque = q[keep], qd[keep], torque[keep]
    rng, scale = np.random.default_rng(seed + 1000), np.abs(torque).max(axis=0)
    friction = 0.06 * scale * (np.sign(qd) + qd / np.abs(qd).max(axis=0))
    noise = 0.01 * scale * rng.normal(size=torque.shape)
    return tb.Recording(
        tuple(names),
        np.arange(len(q)) / RATE,
        q + 2e-5 * rng.normal(size=q.shape),
        torque=torque + friction + noise,
    )


def scores(estimate: Estimate, tree: tb.Tree) -> Array:
    """Errors of the minimal parameters in sigmas, (p,)."""
    base = estimate.base
    truth = estimate.minimal.standard_matrix @ standard(tree).ravel()
    return np.asarray((base.values - truth) / base.sigma)


def judged(path: str, error: str, size: float, seed: int) -> dict[str, Any]:
    """What is said of one recording, and how sigma holds."""
    tree = tb.load_tree(path)
    recording = recorded(path, error, size, seed, tree.names)
    plain = tb.identify(tree, recording, "torque", settings=tb.Settings(model_errors=False))
    found = tb.identify(tree, recording, "torque")
    before, after = scores(plain, tree), scores(found, tree)
    families = {each.family: round(each.gain) for each in found.model_errors}
    known = [each for each in families if not each.startswith("unknown")]
    said = "silent"
    if families:
        first = known[0] if known else "unknown"
        near = first in NEAR and error in ("elastic", "stand", "backlash")
        said = "right" if first in RIGHT.get(error, ()) else "near" if near else "wrong"
        said = "not explained" if first == "unknown" else said
    return {
        "robot": tree.name,
        "error": error,
        "size": size,
        "seed": seed,
        "harmful": bool(np.mean(np.abs(before) > 3) > 0.1),
        "said": said,
        "families": families,
        "covered_without": round(float(np.mean(np.abs(before) < 1.96)), 3),
        "covered": round(float(np.mean(np.abs(after) < 1.96)), 3),
        "width": round(float(np.median(found.base.sigma / plain.base.sigma)), 2),
    }


def totals(lines: Sequence[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """What is said of harmful errors, alarms of clean recordings, and coverage."""
    clean = [line for line in lines if line["error"] == "clean"]
    others = [line for line in lines if line["error"] != "clean"]
    for name, some in (("harmful", True), ("harmless", False)):
        own = [line for line in others if line["harmful"] == some]
        yield {
            name: len(own),
            "said": dict(Counter(line["said"] for line in own)),
            "covered_without": round(float(np.mean([x["covered_without"] for x in own])), 3),
            "covered": round(float(np.mean([x["covered"] for x in own])), 3),
        }
    yield {"clean": len(clean), "alarms": sum(bool(line["families"]) for line in clean)}


def main(
    robots: Annotated[str, typer.Option(help="Names of golden robots, or paths.")] = ROBOTS,
    seeds: Annotated[str, typer.Option(help="Of motion and noise.")] = "1,2",
    sizes: Annotated[str, typer.Option(help="Over what is plausible.")] = "1,3",
) -> None:
    """Errors that MuJoCo makes: named or not, and sigma; exit code 1 if harm goes unnoticed."""
    paths = [
        name if "/" in name else str(GOLDEN / f"robots/{name}.urdf") for name in robots.split(",")
    ]
    cases = (
        (path, error, float(size), int(seed))
        for path in paths
        for seed in seeds.split(",")
        for size in sizes.split(",")
        for error in ("clean", *RIGHT)
    )
    lines = print_lines(judged(*case) for case in cases)
    found = list(print_lines(totals(lines)))
    missed = found[0]["said"].get("silent", 0) + found[0]["said"].get("wrong", 0)
    raise typer.Exit(int(missed > 0 or found[-1]["alarms"] > 0))
