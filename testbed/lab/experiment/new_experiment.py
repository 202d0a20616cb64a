"""Text of an experiment file for any robot model, with assumed values marked."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import tomli_w

from testbed.core.base.diagnostics import sentences
from testbed.core.base.errors import ModelError, count_with_noun, round_significant
from testbed.core.base.stages import ignore_progress
from testbed.core.estimation.settings import Settings
from testbed.core.parameters.minimal_set import minimal_set
from testbed.core.robot.friction import VISCOUS
from testbed.core.robot.grippers import finger_joints
from testbed.core.robot.locks import JointLocks, JointTravel
from testbed.core.robot.model_file import (
    ModelFile,
    nearest_consistent_bodies,
    readable_model,
)
from testbed.core.robot.placeholders import find_placeholders
from testbed.core.robot.repair import MAX_LISTED_FLAWS, InertiasByLink, Repair
from testbed.core.robot.tree import Tree
from testbed.lab.experiment.assumptions import (
    PLATE_NOISE,
    STEP_SIZES,
    TORQUE_NOISE,
    Assumptions,
    FeasibleSettings,
    assumptions,
    chain_length,
    moderate_speeds,
    tested_text,
)
from testbed.lab.experiment.experiment import run_name
from testbed.lab.experiment.experiment_tables import MAX_HARMONICS
from testbed.lab.experiment.robot_tables import BodyTable
from testbed.motion.limits import joint_limits

MAX_FRICTION_RATIO = 1e3
"""Ratio of viscous friction at a moderate speed to the robot's weight, above which a joint is
locked."""
MAX_SWING_RATE = 0.5
"""Largest speed of a usual motion, relative to half the joint's range [1/s]."""


@dataclass(frozen=True)
class ReadableRobot:
    """Robot of a model file, and the settings used to read the file.

    Attributes:
        tree: The robot.
        weld_root: True if a floating root is welded.
        lock_mimic: True if joints that mimic others are locked.
        lock: Positions of other locked joints [rad or m].
        repair: Nearest consistent bodies for those that are not physically consistent.
    """

    tree: Tree
    weld_root: bool
    lock_mimic: bool
    lock: Mapping[str, float]
    repair: Repair


def read_robot(
    model: Path, repair: InertiasByLink | None, lock: JointLocks | None = None
) -> ReadableRobot:
    """Read a model file, with its root welded and joints locked where needed.

    In addition to the joints in `lock`, the following are locked: joints that a kinematic tree
    cannot represent, finger joints of grippers, joints whose range is too short, and joints that
    viscous friction keeps from moving.

    Args:
        model: MJCF or URDF file.
        repair: Replacement bodies; None for the nearest consistent bodies.
        lock: Positions of joints to lock [rad or m]; None for a joint's rest position.

    Raises:
        ModelError: The file cannot be read, or no moving link has a mass.
        UnknownName: A joint to lock does not exist.
    """
    resting_joints = {name for name, place in (lock or {}).items() if place is None}
    positions = {
        name: place for name, place in (lock or {}).items() if place is not None
    }
    file, tree, followed = readable_model(
        ModelFile(model, repair=repair, lock=positions)
    )
    added_locks = _rest_positions(tree, map(tree.index, resting_joints))
    added_locks |= (
        _finger_joints(tree, followed) | _immobile_joints(tree) | _braked_joints(tree)
    )
    if added_locks:
        file = replace(file, lock={**file.lock, **added_locks})
        tree = file.tree()
    if not any(inertia.mass for inertia in tree.inertias):
        raise ModelError(
            f"{model}: no moving link has a mass; `testbed minimal` lists the base parameters"
        )
    nearest = nearest_consistent_bodies(model, weld_root=file.weld_root, lock=file.lock)
    known_positions = {
        name: place for name, place in file.lock.items() if place is not None
    }
    return ReadableRobot(tree, file.weld_root, bool(followed), known_positions, nearest)


def _immobile_joints(tree: Tree) -> dict[str, float]:
    """Rest positions of joints whose range is too short for identification.

    The speed of such a joint stays below the deadband of the identification, because of its range
    at the usual rate of motion (`MAX_SWING_RATE`) or because of its velocity limit, so that its
    torque identifies no parameter. The result is empty if this is true of all joints.
    """
    narrow_joints = [
        j
        for j, joint in enumerate(tree.joints)
        if min(np.ptp(joint.position_range) / 2 * MAX_SWING_RATE, joint.max_velocity)
        < Settings().deadband
    ]
    return _rest_positions(tree, narrow_joints) if len(narrow_joints) < tree.n else {}


def _braked_joints(tree: Tree) -> dict[str, float]:
    """Rest positions of joints with prohibitive viscous friction.

    At a moderate speed, the friction of such a joint exceeds `MAX_FRICTION_RATIO` times the robot's
    weight, multiplied for a revolute joint by the length of the chain. The result is empty if this
    is true of all joints.
    """
    weight = 9.81 * sum(body.mass for body in tree.inertias)
    lever = np.where([joint.revolute for joint in tree.joints], chain_length(tree), 1.0)
    is_braked = (
        VISCOUS.coefficients(tree) * moderate_speeds(tree)
        > MAX_FRICTION_RATIO * weight * lever
    )
    return (
        _rest_positions(tree, np.flatnonzero(is_braked).tolist())
        if not is_braked.all()
        else {}
    )


def _finger_joints(tree: Tree, followed: Collection[str]) -> dict[str, float]:
    """Rest positions of the finger joints that other joints follow [rad or m].

    Fingers move too little for their masses to be identified. The result is empty if the robot
    consists of a gripper only.
    """
    joints = finger_joints(tree, followed)
    # otherwise the robot is a gripper
    return _rest_positions(tree, joints) if len(joints) < tree.n else {}


def _rest_positions(tree: Tree, indices: Iterable[int]) -> dict[str, float]:
    """Rest positions keyed by joint name [rad or m], rounded to six digits.

    Args:
        tree: The robot.
        indices: Joint indices.
    """
    joints = [tree.joints[j] for j in indices]
    return {
        joint.name: round_significant(
            JointTravel(*joint.position_range).rest_position, 6
        )
        for joint in joints
    }


COMMENT_COLUMN = 56
"""Column where comments begin."""
COMMENT_MARK = "\t# "
"""Mark of a comment in the template, moved to that column; values of TOML contain no tabs."""
MAX_JOINTS_FULL_RUN = 12
"""Largest number of joints of a robot for runs of full length."""
MIN_HARMONICS = 5
"""Smallest number of harmonics of a motion."""
PARAMETERS_PER_HARMONIC = 8
"""Number of parameters per harmonic of the motion.

Along a periodic motion, the plate's six channels are determined by their harmonics, however long
the recording. Regressor rows reach about twice the highest frequency of the motion, which gives
three values per parameter.
"""
MAX_HARMONIC_FREQUENCY = 1.5
"""Largest frequency of a harmonic [Hz]; rows of faster harmonics are beyond the filter's cutoff."""
PERIOD_UNIT = 10.0
"""Unit of the period of a motion, which is a multiple of it [s]."""


def new_experiment(
    model: Path,
    folder: Path,
    *,
    strict: bool = False,
    run_trial: bool = True,
    lock: JointLocks | None = None,
    report_line: Callable[[str], None] = ignore_progress,
) -> str:
    """Text of an experiment file for a robot model, ready to run.

    Values that the model file lacks are assumed, and marked as such.

    Args:
        model: MJCF or URDF file. A floating root is welded; joints that mimic others and grippers
            are locked.
        folder: Folder of the future file.
        strict: Refuse bodies that are not physically consistent instead of repairing them.
        run_trial: Simulate one second of the experiment; if it fails, change step, speed or
            clearance until it runs (`tested_text`).
        lock: Positions of joints to lock [rad or m]; None for a joint's rest position.
        report_line: Called with a line for every repair, and every assumption after a failed trial.

    Raises:
        ModelError: The robot cannot be read.
        ExperimentError: The trial simulation fails even with all changes.
    """
    robot = read_robot(model, {} if strict else None, lock)
    diagnostics = (*robot.tree.diagnostics, *find_placeholders(robot.tree).diagnostics)
    for line in (*sentences(diagnostics), *_flaw_lines(robot.repair)):
        report_line(line)
    assumed = assumptions(robot.tree)
    relative_path = Path(os.path.relpath(model.resolve(), folder.resolve())).as_posix()
    content = _template_values(robot, assumed) | {
        "model": relative_path,
        "name": run_name(model, robot.tree.name),
    }
    template = _template_environment().get_template("new_experiment.toml.jinja")

    def text(needs: FeasibleSettings) -> str:
        slow = (
            "" if needs.pace == 1 else ": so slow, since the robot went astray faster"
        )
        lines = template.render(content, needs=needs, slow=slow).split("\n")
        columns = (line.partition(COMMENT_MARK) for line in lines)
        return "\n".join(
            f"{key.ljust(COMMENT_COLUMN)}  # {comment}" if mark else key
            for key, mark, comment in columns
        )

    initial_needs = FeasibleSettings(step=assumed.step)
    return (
        tested_text(text, initial_needs, folder, report_line)
        if run_trial
        else text(initial_needs)
    )


def _template_values(robot: ReadableRobot, assumed: Assumptions) -> dict[str, Any]:
    """Template variables that do not depend on the trial simulations, by name.

    The motion has one harmonic per `PARAMETERS_PER_HARMONIC` parameters, and a period at which the
    frequency of the highest harmonic is at most `MAX_HARMONIC_FREQUENCY`.
    """
    tree = robot.tree
    unknowns = minimal_set(tree, "wrench").count
    harmonics = max(
        MIN_HARMONICS, min(MAX_HARMONICS, -(-unknowns // PARAMETERS_PER_HARMONIC))
    )
    keys = {key for values in assumed.joints.values() for key in values}
    return {
        "found": robot,
        "tree": tree,
        "assumed": assumed,
        "limits": joint_limits(tree),
        "torques": minimal_set(tree, "torque").count,
        "unknowns": unknowns,
        "many": tree.n > MAX_JOINTS_FULL_RUN,
        "harmonics": harmonics,
        "fewest_harmonics": MIN_HARMONICS,
        "period": PERIOD_UNIT
        * math.ceil(harmonics / (PERIOD_UNIT * MAX_HARMONIC_FREQUENCY)),
        "reasons": [reason for key, reason in _REASONS.items() if key in keys],
        "units": {
            name: [
                _UNITS[key][tree.joints[tree.index(name)].revolute] for key in values
            ]
            for name, values in assumed.joints.items()
        },
        "plate_noise": f"{PLATE_NOISE:.1%}",
        "torque_noise": f"{TORQUE_NOISE:.1%}",
        "largest_step": STEP_SIZES[0],
        "unlimited": math.inf,
    }


_REASONS = {
    "coulomb": "friction: the model file has none for these",
    "rotor_inertia": "rotors: these are too light without, in some posture or for their friction",
    "max_effort": "max_effort: the model file's holds the robot in no posture",
}
"""Comments on assumed joint settings, by key."""
_UNITS = {
    "coulomb": ("N", "N m"),
    "viscous": ("N s/m", "N m s/rad"),
    "rotor_inertia": ("kg", "kg m^2"),
    "max_effort": ("N", "N m"),
}
"""Units of joint settings for sliding and for rotary joints, by key."""


def _template_environment() -> jinja2.Environment:
    """Template environment of this package, with filters that format values as TOML."""
    environment = jinja2.Environment(  # for TOML, without escaping of HTML
        loader=jinja2.PackageLoader("testbed.lab", "experiment"),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.globals["plural"] = count_with_noun
    environment.filters |= {
        "toml": _toml_value,
        "key": _toml_key,
        "table": _inline_table,
        "body_table": lambda body: _inline_table(
            BodyTable.from_inertia(body).model_dump(mode="json")
        ),
        "digits": round_significant,
    }
    return environment


def _flaw_lines(repair: Repair) -> Iterator[str]:
    """Yield a line for each of the first `MAX_LISTED_FLAWS` inconsistent bodies.

    A last line has the number of further bodies.
    """
    yield from (f"  {flaw}" for flaw in repair.flaws[:MAX_LISTED_FLAWS])
    if len(repair.flaws) > MAX_LISTED_FLAWS:
        yield f"  and {len(repair.flaws) - MAX_LISTED_FLAWS} more"


def _toml_key(name: str) -> str:
    """TOML key for a name, in quotes where needed."""
    return tomli_w.dumps({name: 0}).rstrip().removesuffix(" = 0")


def _toml_value(value: Any) -> str:
    """TOML value of a string, a number or nested lists of such values."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _inline_table(values: Mapping[str, Any]) -> str:
    """Text of an inline TOML table."""
    return (
        "{ "
        f"{', '.join(f'{_toml_key(key)} = {_toml_value(value)}' for key, value in values.items())}"
        " }"
    )
