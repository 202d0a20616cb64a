"""An experiment file for any robot: welded, repaired, filled in from its model, commented."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tomli_w

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import sentences
from testbed.core.base.errors import (
    ModelError,
    plural,
    round_significant,
)
from testbed.core.estimation.settings import Settings
from testbed.core.parameters.minimal_set import minimal_set
from testbed.core.robot.friction import VISCOUS
from testbed.core.robot.grippers import fingers
from testbed.core.robot.inertia import Inertia
from testbed.core.robot.locks import Lock, Travel
from testbed.core.robot.model_file import ModelFile, expressible, nearest_bodies
from testbed.core.robot.repair import NAMED, Bodies, Repair
from testbed.core.robot.tree import Tree
from testbed.lab.experiment.assumptions import (
    PLATE_NOISE,
    STEPS,
    TORQUE_NOISE,
    Assumptions,
    Needs,
    assumptions,
    calm_speeds,
    size,
    tried_text,
)
from testbed.lab.experiment.experiment import run_name
from testbed.lab.experiment.experiment_tables import MOST_HARMONICS
from testbed.lab.experiment.robot_tables import BodyTable
from testbed.motion.limits import Limits, limits_of

HOLDING = 1e3
"""Times the robot's weight, at a usual speed, is more than viscous friction takes of a joint that
moves."""
SWING = 0.5
"""Fastest that a usual motion is, of half a joint's range [1/s]."""


@dataclass(frozen=True)
class RobotFound:
    """A robot, and how its model file had to be read.

    Attributes:
        tree: The robot.
        weld_root: Whether a floating root is welded.
        lock_mimic: Whether joints that follow others are held.
        lock: Other joints that are held, and where [rad or m].
        repair: Of bodies that cannot be.
    """

    tree: Tree
    weld_root: bool
    lock_mimic: bool
    lock: Mapping[str, float]
    repair: Repair


def find_robot(model: Path, repair: Bodies | None, lock: Lock | None = None) -> RobotFound:
    """Read the file; weld its root and hold what no tree can move, if that is what it takes.

    Args:
        model: MJCF or URDF.
        repair: Bodies in place of the file's; None for the nearest that can be.
        lock: Joints to be held, and where [rad or m]; None: where they rest.

    Raises:
        ModelError: The file cannot be read, or nothing in it moves that has a mass.
        UnknownName: A joint to be held is not there.
    """
    asked = {name for name, place in (lock or {}).items() if place is None}
    given = {name: place for name, place in (lock or {}).items() if place is not None}
    file, tree, followed = expressible(ModelFile(model, repair=repair, lock=given))
    further = _at_rest(tree, map(tree.index, asked))
    further |= _grippers(tree, followed) | _stuck(tree) | _held_by_friction(tree)
    if further:
        file = replace(file, lock={**file.lock, **further})
        tree = file.tree()
    if not any(inertia.mass for inertia in tree.inertias):
        raise ModelError(
            f"{model}: no moving link has a mass; `testbed minimal` lists the base parameters"
        )
    nearest = nearest_bodies(model, weld_root=file.weld_root, lock=file.lock)
    holding = {name: place for name, place in file.lock.items() if place is not None}
    return RobotFound(tree, file.weld_root, bool(followed), holding, nearest)


def _stuck(tree: Tree) -> dict[str, float]:
    """Joints without room, and where they rest; none if no other moves.

    Their range is one position, or so short that a motion is never faster than what counts as
    rest: no torque of theirs would identify anything, and none of the robot's without them.
    """
    narrow = [
        j
        for j, joint in enumerate(tree.joints)
        if min(np.ptp(joint.position_range) / 2 * SWING, joint.max_velocity) < Settings().deadband
    ]
    return _at_rest(tree, narrow) if len(narrow) < tree.n else {}


def _held_by_friction(tree: Tree) -> dict[str, float]:
    """Joints that files hold by their damping, and where they rest; none if no other moves."""
    weight = 9.81 * sum(body.mass for body in tree.inertias)
    lever = np.where([joint.revolute for joint in tree.joints], size(tree), 1.0)
    brakes = VISCOUS.coefficients(tree) * calm_speeds(tree) > HOLDING * weight * lever
    return _at_rest(tree, np.flatnonzero(brakes).tolist()) if not brakes.all() else {}


def _grippers(tree: Tree, followed: Collection[str]) -> dict[str, float]:
    """Rest positions of finger joints that other joints follow [rad or m].

    The stroke of a gripper's fingers is too short for their masses to be identified.
    """
    own = fingers(tree, followed)
    return _at_rest(tree, own) if len(own) < tree.n else {}  # else the robot is a gripper


def _at_rest(tree: Tree, own: Iterable[int]) -> dict[str, float]:
    """Rest positions of some joints, by name [rad or m]."""
    joints = [tree.joints[j] for j in own]
    return {
        joint.name: round_significant(Travel(*joint.position_range).rest, 6) for joint in joints
    }


COLUMN = 56
"""Where comments begin."""
MANY = 12
"""Joints above which runs are kept short."""
FEWEST_HARMONICS = 5
"""Of any motion."""
UNKNOWNS_A_HARMONIC = 8
"""Unknowns that a harmonic is there for: what the plate says of a periodic motion are its harmonics
in six channels and no more, however long it goes on. Rows reach about twice as high as the motion,
so that three values come on each unknown."""
FASTEST = 1.5
"""Most that a harmonic may have: rows of faster ones are beyond the filter's cutoff [Hz]."""
PERIOD = 10.0
"""A motion's period is this or a multiple [s]."""


def new_experiment(
    model: Path,
    folder: Path,
    *,
    strict: bool = False,
    tried: bool = True,
    lock: Lock | None = None,
    say: Callable[[str], None] = lambda line: None,
) -> str:
    """The text of an experiment file that runs as it is.

    What the model file does not say is assumed, and marked so.

    Args:
        model: MJCF or URDF. A floating root is welded, joints that follow others are held, and
            grippers with them.
        folder: Where the file will be.
        strict: Refuse bodies that cannot be instead of taking the nearest that can.
        tried: Simulate a second of it, and assume more where it fails.
        lock: Joints to be held, and where [rad or m]; None: where they rest.
        say: Called with a line for what was repaired, or assumed after a trial.

    Raises:
        ModelError: The robot cannot be read.
    """
    found = find_robot(model, {} if strict else None, lock)
    for line in (*sentences(found.tree.diagnostics), *_flaws(found.repair)):
        say(line)
    assumed = assumptions(found.tree)

    def text(needs: Needs) -> str:
        parts = (
            _head(model, folder, found),
            _robot(found, assumed),
            _motion(found.tree, needs),
            _apart(found.tree, assumed, needs),
            [*_instrument(assumed), *_torque_constants(found.tree)],
            [*_further(needs), *_claims(), ""],
        )
        return "\n".join(line for part in parts for line in part)

    first = Needs(step=assumed.step)
    return tried_text(text, first, folder, say) if tried else text(first)


def _head(model: Path, folder: Path, found: RobotFound) -> list[str]:
    tree = found.tree
    torques, plate = (minimal_set(tree, kind).count for kind in ("dynamic", "reaction"))
    joints = plural(tree.n, "joint")
    place = Path(os.path.relpath(model.resolve(), folder.resolve())).as_posix()
    return [
        f"# {joints}: {torques} base parameters by joint torques, {plate} by the force plate.",
        "# It runs as it is: testbed run FILE. What the model file does not say is marked ASSUMED.",
        "# Lines that begin with # are defaults; every key is in docs/experiments.md.",
        "",
        _said("name", run_name(model, tree.name), "of the run folder"),
        _said("claim", "", "what the experiment shows, in a sentence"),
        _said("model", place, "relative to this file"),
        _said("seed", 0, "of the motion and of all noise"),
        *([_said("weld_root", True, "the model floats: held on the plate")] * found.weld_root),
        f"# gravity = {_list(tree.gravity)}".ljust(COLUMN) + "  # m/s^2, the model file's",
    ]


def _robot(found: RobotFound, assumed: Assumptions) -> list[str]:
    """How the model file is read, and what is assumed of its joints."""
    tree = found.tree
    lines = ["", "[robot]"]
    if found.lock_mimic:
        lines.append(_said("lock_mimic", True, "joints that follow others are held"))
    if found.lock:
        held = ", ".join(f"{_key(name)} = {place!r}" for name, place in found.lock.items())
        lines.append(
            f"lock = {{ {held} }}".ljust(COLUMN)
            + "  # ASSUMED: held: grippers, loops, no room [rad or m]"
        )
    else:
        lines.append(
            "# lock = { JOINT = 0.0 }".ljust(COLUMN) + "  # joints that do not move [rad or m]"
        )
    lines += _joints(tree, assumed)
    if found.repair.bodies:
        lines += [
            "",
            "[robot.repair]  # ASSUMED: the nearest bodies to those that cannot be; kg, m, kg m^2",
        ]
        lines += [_body(name, body) for name, body in found.repair.bodies.items()]
    return lines


def _joints(tree: Tree, assumed: Assumptions) -> list[str]:
    """What is assumed of joints: friction, rotors, efforts."""
    said = {key for values in assumed.joints.values() for key in values}
    reasons = [reason for key, reason in _REASONS.items() if key in said]
    if not reasons:
        return []
    lines = ["", f"[robot.joint]  # ASSUMED {reasons[0]}"]
    lines += [f"# ASSUMED {reason}" for reason in reasons[1:]]
    for name, values in assumed.joints.items():
        words = ", ".join(f"{key} = {value!r}" for key, value in values.items())
        revolute = tree.joints[tree.index(name)].revolute
        units = ", ".join(_UNITS[key][0 if revolute else 1] for key in values)
        lines.append(f"{_key(name)} = {{ {words} }}".ljust(COLUMN) + f"  # {units}")
    return lines


_REASONS = {
    "coulomb": "friction: the model file has none for these",
    "rotor_inertia": "rotors: these are too light without, in some posture or for their friction",
    "max_effort": "max_effort: the model file's holds the robot in no posture",
}
_UNITS = {
    "coulomb": ("N m", "N"),
    "viscous": ("N m s/rad", "N s/m"),
    "rotor_inertia": ("kg m^2", "kg"),
    "max_effort": ("N m", "N"),
}


def _body(name: str, body: Inertia) -> str:
    said = BodyTable.of(body)
    lists = f"centre = {_list(said.centre)}, inertia = {_list(said.inertia)}"
    return f"{_key(name)} = {{ mass = {said.mass!r}, {lists} }}"


def _flaws(repair: Repair) -> Iterator[str]:
    """What was wrong with bodies: the first few, and how many."""
    yield from (f"  {flaw}" for flaw in repair.flaws[:NAMED])
    if len(repair.flaws) > NAMED:
        yield f"  and {len(repair.flaws) - NAMED} more"


def _motion(tree: Tree, needs: Needs) -> list[str]:
    limits = limits_of(tree)
    many = tree.n > MANY
    unknowns = minimal_set(tree, "reaction").count
    harmonics = max(FEWEST_HARMONICS, min(MOST_HARMONICS, -(-unknowns // UNKNOWNS_A_HARMONIC)))
    period = PERIOD * np.ceil(harmonics / (PERIOD * FASTEST))
    usual = harmonics == FEWEST_HARMONICS
    enough = f"enough of them for {unknowns} parameters"
    lines = [
        "",
        "[motion]  # random Fourier series, proven to keep all limits; or a file of testbed excite",
        _said("duration", max(20.0 if many else 60.0, period), "s"),
        _said("fundamental", round_significant(1 / period, 6), "Hz; it repeats after its inverse"),
        *([] if usual else [_said("harmonics", harmonics, enough)]),
        _said("candidates", 5 if many else 20, "random motions tried; the best one is run"),
    ]
    return lines + _limits(tree, limits, needs.pace)


def _apart(tree: Tree, assumed: Assumptions, needs: Needs) -> list[str]:
    """What clearance is kept, where it is not the usual one."""
    if tree.n > MANY or needs.nothing_clear:
        return [
            "",
            "[excitation]",
            *(_MANY_JOINTS if tree.n > MANY else _NOTHING_CLEAR),
            'clearance = "off"',
        ]
    lines = []
    if assumed.clearance is not None:
        lines.append(_said("clearance", assumed.clearance, "m; ASSUMED: the robot is small"))
    if needs.exclude:
        lines.append("# ASSUMED: these touch, or come too near, in the posture that is freest")
        lines.append(f"exclude = {[list(pair) for pair in needs.exclude]}".replace("'", '"'))
    return ["", "[excitation]", *lines] if lines else []


_MANY_JOINTS = (
    "# ASSUMED: random motions of so many joints that keep clear of the robot are tiny. In the",
    "# simulation nothing collides; for a real robot take the line out, or use testbed excite.",
)
_NOTHING_CLEAR = (
    "# ASSUMED: no random motion keeps clear of the robot, whatever pairs are left out. In the",
    "# simulation nothing collides; for a real robot give limits of the joints.",
)


def _limits(tree: Tree, limits: Limits, pace: float) -> list[str]:
    """Velocities and accelerations by joint, said where they come from."""
    assumed = "ASSUMED" if pace == 1 else "ASSUMED: so slow, since the robot went astray faster"
    lines = ["", "[motion.max_velocity]  # rad/s or m/s"]
    for joint, speed in zip(tree.joints, pace * limits.velocity, strict=True):
        known = pace == 1 and np.isfinite(joint.max_velocity)
        lines.append(
            _said(joint.name, round_significant(speed, 6), "the model file's" if known else assumed)
        )
    lines += ["", "[motion.max_acceleration]  # rad/s^2 or m/s^2"]
    for joint, rate in zip(tree.joints, pace * limits.acceleration, strict=True):
        lines.append(_said(joint.name, round_significant(rate, 6), assumed))
    return lines


def _instrument(assumed: Assumptions) -> list[str]:
    """A cheap plate and encoder (docs/instruments.md)."""
    share = f"{PLATE_NOISE:.1%} of the robot's rms"
    return [
        "",
        "[measurement]  # ASSUMED: a cheap plate and encoder (docs/instruments.md); put your own",
        _said("rate", 1000.0, "Hz"),
        _said("encoder_resolution", 1e-4, "rad or m, joint side: 16 bits a turn"),
        _said("encoder_noise", 1e-4, "rad or m"),
        _said("force_noise", assumed.force_noise, f"N, of Fx Fy Fz; {share}"),
        _said("moment_noise", assumed.moment_noise, f"N m, of Mx My Mz; {share}"),
        _said(
            "torque_noise",
            assumed.torque_noise,
            f"N m or N; {TORQUE_NOISE:.1%} of the joints' rms",
        ),
    ]


def _torque_constants(tree: Tree) -> list[str]:
    return [
        "",
        "[measurement.torque_constant_error]  # ASSUMED, as data sheets allow: 0.05 shows 5 % more",
        *(
            _said(name, error, "")
            for name, error in zip(tree.names, _alternating(tree.n), strict=True)
        ),
    ]


def _further(needs: Needs) -> list[str]:
    """More faults, the simulation, the identification."""
    usual = "s; half of it halves the error and doubles the time"
    small = "s; ASSUMED: the robot is too light or rubs too much for a larger one"
    return [
        "",
        "# [[measurement.fault]]  # more that may be wrong: testbed list",
        '# kind = "plate_pose"',
        "",
        "[simulation]",
        _said("step", needs.step, usual if needs.step == STEPS[0] else small),
        "",
        "[identification]",
        _said("zeros", False, "true: what is zero in the model file is known to be zero"),
    ]


def _alternating(count: int) -> list[float]:
    return [0.05 if k % 2 == 0 else -0.05 for k in range(count)]


def _claims() -> list[str]:
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
