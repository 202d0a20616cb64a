"""An experiment file for any robot: commented, filled in from its model, ready to run."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tomli_w

from testbed.arrays import Array
from testbed.dynamics.inverse_dynamics import joint_forces
from testbed.dynamics.motion import Motion
from testbed.errors import FreeRootError, MimicError
from testbed.excitation.limits import CALM, Limits, limits_of
from testbed.experiment.experiment import run_name
from testbed.parameters.minimal_set import minimal_set
from testbed.robot.load import mimic_joints
from testbed.robot.locks import Travel
from testbed.robot.model_file import ModelFile
from testbed.robot.tree import Joint, Tree

POSTURES = 200
"""Random postures in which joints are loaded."""
DRY, VISCOUS = 0.05, 0.03
"""Assumed friction, as shares of a joint's load: dry, and viscous at its velocity there."""
OF_MOTOR = 0.05
"""Most of the motor's effort that dry friction is assumed to take."""
COLUMN = 56
"""Where comments begin."""
NAMELESS = ("robot", "model", "scene")
"""Names of files that are no robot's; a run is then named for the robot."""
MANY = 12
"""Joints above which runs are kept short."""


@dataclass(frozen=True)
class _Reading:
    """A robot, and how its model file had to be read."""

    tree: Tree
    weld_root: bool
    lock_mimic: bool
    lock: Mapping[str, float]


def new_experiment(model: Path, folder: Path) -> str:
    """The text of an experiment file that runs as it is.

    What the model file does not say is assumed, and marked so.

    Args:
        model: MJCF or URDF. A floating root is welded, joints that follow others are held, and
            grippers with them.
        folder: Where the file will be.

    Raises:
        ModelError: The robot cannot be read.
    """
    found = _read(model)
    tree = found.tree
    lines = [*_head(model, folder, found), *_robot(found), *_motion(tree), *_instrument(tree)]
    return "\n".join([*lines, *_claims(tree), ""])


def _read(model: Path) -> _Reading:
    """Read the file; weld its root and hold what follows others if that is what it takes."""
    weld, masters = False, set[str]()
    while True:
        try:
            held: dict[str, float | None] = dict.fromkeys(mimic_joints(model)) if masters else {}
            tree = ModelFile(model, weld_root=weld, lock=held).tree()
            break
        except FreeRootError:
            if weld:
                raise
            weld = True
        except MimicError as error:
            if masters:
                raise
            masters = set(error.masters.values())
    lock = _grippers(tree, masters)
    if lock:
        tree = ModelFile(model, weld_root=weld, lock=held | lock).tree()
    return _Reading(tree, weld, bool(masters), lock)


def _grippers(tree: Tree, masters: set[str]) -> dict[str, float]:
    """Joints that others follow and that carry none, and where they rest: a gripper's fingers.

    Their stroke is too short for their masses to be told.
    """
    carrying = {joint.parent for joint in tree.joints}
    own = [j for j, name in enumerate(tree.names) if name in masters and j not in carrying]
    if len(own) == tree.n:  # the robot is a gripper
        return {}
    joints = [tree.joints[j] for j in own]
    return {joint.name: _float(Travel(*joint.position_range).rest) for joint in joints}


def _head(model: Path, folder: Path, found: _Reading) -> list[str]:
    tree = found.tree
    torques, plate = (minimal_set(tree, kind).count for kind in ("dynamic", "reaction"))
    joints = "1 joint" if tree.n == 1 else f"{tree.n} joints"
    place = Path(os.path.relpath(model.resolve(), folder.resolve())).as_posix()
    return [
        f"# {joints}: joint torques tell {torques} minimal parameters, the bedplate {plate}.",
        "# It runs as it is: testbed run FILE. What the model file does not say is marked ASSUMED.",
        "# Lines that begin with # are defaults; every key is in docs/experiments.md.",
        "",
        _said("name", run_name(_named(model, found.tree)), "of the run folder"),
        _said("claim", "", "what the experiment shows, in a sentence"),
        _said("model", place, "relative to this file"),
        _said("seed", 0, "of the motion and of all noise"),
        *([_said("weld_root", True, "the model floats: held on the plate")] * found.weld_root),
        f"# gravity = {_list(tree.gravity)}".ljust(COLUMN) + "  # m/s^2, the model file's",
    ]


def _named(model: Path, tree: Tree) -> Path:
    """The model file, or one of the robot's name where the file's name says nothing."""
    return Path(f"{tree.name}{model.suffix}") if model.stem in NAMELESS else model


def _robot(found: _Reading) -> list[str]:
    """Friction where the model file has none, and how it is read."""
    tree = found.tree
    lines = ["", "[robot]"]
    if found.lock_mimic:
        lines.append(_said("lock_mimic", True, "joints that follow others are held"))
    if found.lock:
        held = ", ".join(f"{_key(name)} = {place!r}" for name, place in found.lock.items())
        lines.append(
            f"lock = {{ {held} }}".ljust(COLUMN) + "  # ASSUMED: a gripper, held [rad or m]"
        )
    else:
        lines.append(
            "# lock = { JOINT = 0.0 }".ljust(COLUMN) + "  # joints that do not move [rad or m]"
        )
    bare = [j for j in range(tree.n) if not (tree.joints[j].coulomb or tree.joints[j].viscous)]
    if bare:
        calm = _calm(tree)
        load = _load(tree, calm)
        lines += ["", "[robot.joint]  # ASSUMED friction: the model file has none for these"]
        lines += [_friction(tree.joints[j], load[j], calm[j]) for j in bare]
    return lines


def _friction(joint: Joint, load: float, speed: float) -> str:
    load = min(load, OF_MOTOR / DRY * joint.max_effort)
    dry, viscous = _short(DRY * load), _short(VISCOUS * load / speed)
    units = "N m, N m s/rad" if joint.revolute else "N, N s/m"
    said = f"{_key(joint.name)} = {{ coulomb = {dry}, viscous = {viscous} }}"
    return f"{said.ljust(COLUMN)}  # {units}"


def _calm(tree: Tree) -> Array:
    """Velocities of a calm motion inside the limits, (n,) [rad/s or m/s]."""
    usual = np.array([CALM[joint.kind][1] for joint in tree.joints])
    return np.asarray(np.minimum(limits_of(tree).velocity, usual))


def _load(tree: Tree, speed: Array) -> Array:
    """Rms of the joint forces in random motion up to a speed, (n,) [N m or N]."""
    limits, rng = limits_of(tree), np.random.default_rng(0)

    def within(size: Array) -> Array:
        return rng.uniform(-1, 1, (POSTURES, tree.n)) * size

    motion = Motion(
        np.arange(float(POSTURES)),
        limits.middle + within(limits.half),
        within(speed),
        within(limits.acceleration),
    )
    return np.asarray(np.sqrt(np.mean(joint_forces(tree, motion) ** 2, axis=0)))


def _motion(tree: Tree) -> list[str]:
    limits = limits_of(tree)
    many = tree.n > MANY
    lines = [
        "",
        "[motion]  # random Fourier series, proven to keep all limits; or a file of testbed excite",
        _said("duration", 20.0 if many else 60.0, "s"),
        _said("fundamental", 0.1, "Hz; it repeats after its inverse"),
        _said("candidates", 5 if many else 20, "random motions tried; the best one is run"),
    ]
    return lines + _limits(tree, limits) + (_APART if many else [])


_APART = [
    "",
    "[excitation]",
    "# ASSUMED: random motions of so many joints that keep clear of the robot are tiny. In the",
    "# simulation nothing collides; for a real robot take the line out, or use testbed excite.",
    'clearance = "off"',
]


def _limits(tree: Tree, limits: Limits) -> list[str]:
    """Velocities and accelerations by joint, said where they come from."""
    lines = ["", "[motion.max_velocity]  # rad/s or m/s"]
    for joint, speed in zip(tree.joints, limits.velocity, strict=True):
        known = np.isfinite(joint.max_velocity)
        lines.append(_said(joint.name, _float(speed), "the model file's" if known else "ASSUMED"))
    lines += ["", "[motion.max_acceleration]  # rad/s^2 or m/s^2"]
    for joint, rate in zip(tree.joints, limits.acceleration, strict=True):
        lines.append(_said(joint.name, _float(rate), "ASSUMED"))
    return lines


def _instrument(tree: Tree) -> list[str]:
    """A cheap plate and encoder (docs/instruments.md)."""
    return [
        "",
        "[measurement]  # ASSUMED: a cheap plate and encoder (docs/instruments.md); put your own",
        _said("rate", 1000.0, "Hz"),
        _said("encoder_resolution", 1e-4, "rad or m, joint side: 16 bits a turn"),
        _said("encoder_noise", 1e-4, "rad or m"),
        _said("force_noise", 0.5, "N, of Fx Fy Fz"),
        _said("moment_noise", 0.1, "N m, of Mx My Mz"),
        _said("torque_noise", 0.5, "N m or N"),
        "",
        "[measurement.torque_constant_error]  # ASSUMED, as data sheets allow: 0.05 shows 5 % more",
        *(
            _said(name, error, "")
            for name, error in zip(tree.names, _alternating(tree.n), strict=True)
        ),
        "",
        "# [[measurement.fault]]  # more that may be wrong: testbed faults",
        '# kind = "plate_pose"',
        "",
        "[simulation]",
        _said("step", 5e-4, "s; half of it is twice as exact and half as fast"),
        "",
        "[identification]",
        _said("zeros", False, "true: what is zero in the model file is known to be zero"),
    ]


def _alternating(count: int) -> list[float]:
    return [0.05 if k % 2 == 0 else -0.05 for k in range(count)]


def _claims(tree: Tree) -> list[str]:
    return [
        "",
        "[expect]  # the claim; exit code 1 if a bound fails. Take the # off and put your own",
        "# external_rms_relative_error = { at_most = 1e-2 }",
        "# external_max_z = { at_most = 4.0 }",
        "# internal_to_external = { at_least = 1.0 }",
    ]


def _said(key: str, value: object, comment: str) -> str:
    line = tomli_w.dumps({key: value}).rstrip("\n")
    return f"{line.ljust(COLUMN)}  # {comment}" if comment else line


def _key(name: str) -> str:
    """A joint's name as a key of TOML."""
    return tomli_w.dumps({name: 0}).rstrip().removesuffix(" = 0")


def _list(numbers: Sequence[float] | Array) -> str:
    return f"[{', '.join(repr(float(x)) for x in numbers)}]"


def _short(value: float) -> str:
    return repr(float(f"{value:.2g}"))


def _float(value: float) -> float:
    return float(f"{value:.6g}")
