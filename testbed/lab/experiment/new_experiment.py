"""An experiment file for any robot: welded, repaired, filled in from its model, commented."""

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
from testbed.core.base.errors import ModelError, plural, round_significant
from testbed.core.base.stages import unreported
from testbed.core.estimation.settings import Settings
from testbed.core.parameters.minimal_set import minimal_set
from testbed.core.robot.friction import VISCOUS
from testbed.core.robot.grippers import fingers
from testbed.core.robot.locks import Lock, Travel
from testbed.core.robot.model_file import ModelFile, expressible, nearest_bodies
from testbed.core.robot.placeholders import placeholders
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
from testbed.motion.limits import limits_of

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


def find_robot(
    model: Path, repair: Bodies | None, lock: Lock | None = None
) -> RobotFound:
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
        if min(np.ptp(joint.position_range) / 2 * SWING, joint.max_velocity)
        < Settings().deadband
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
    # else the robot is a gripper
    return _at_rest(tree, own) if len(own) < tree.n else {}


def _at_rest(tree: Tree, own: Iterable[int]) -> dict[str, float]:
    """Rest positions of some joints, by name [rad or m]."""
    joints = [tree.joints[j] for j in own]
    return {
        joint.name: round_significant(Travel(*joint.position_range).rest, 6)
        for joint in joints
    }


COLUMN = 56
"""Where comments begin."""
COMMENT = "\t# "
"""Mark in the template of a comment that begins in that column; values of TOML hold no tabs."""
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
    say: Callable[[str], None] = unreported,
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
    doubts = (*found.tree.diagnostics, *placeholders(found.tree).diagnostics)
    for line in (*sentences(doubts), *_flaws(found.repair)):
        say(line)
    assumed = assumptions(found.tree)
    place = Path(os.path.relpath(model.resolve(), folder.resolve())).as_posix()
    content = _content(found, assumed) | {
        "model": place,
        "name": run_name(model, found.tree.name),
    }
    template = _environment().get_template("new_experiment.toml.jinja")

    def text(needs: Needs) -> str:
        slow = (
            "" if needs.pace == 1 else ": so slow, since the robot went astray faster"
        )
        lines = template.render(content, needs=needs, slow=slow).split("\n")
        columns = (line.partition(COMMENT) for line in lines)
        return "\n".join(
            f"{key.ljust(COLUMN)}  # {comment}" if mark else key
            for key, mark, comment in columns
        )

    first = Needs(step=assumed.step)
    return tried_text(text, first, folder, say) if tried else text(first)


def _content(found: RobotFound, assumed: Assumptions) -> dict[str, Any]:
    """Values of the template that do not depend on trials."""
    tree = found.tree
    unknowns = minimal_set(tree, "reaction").count
    harmonics = max(
        FEWEST_HARMONICS, min(MOST_HARMONICS, -(-unknowns // UNKNOWNS_A_HARMONIC))
    )
    keys = {key for values in assumed.joints.values() for key in values}
    return {
        "found": found,
        "tree": tree,
        "assumed": assumed,
        "limits": limits_of(tree),
        "torques": minimal_set(tree, "dynamic").count,
        "unknowns": unknowns,
        "many": tree.n > MANY,
        "harmonics": harmonics,
        "fewest_harmonics": FEWEST_HARMONICS,
        "period": PERIOD * math.ceil(harmonics / (PERIOD * FASTEST)),
        "reasons": [reason for key, reason in _REASONS.items() if key in keys],
        "units": {
            name: [
                _UNITS[key][tree.joints[tree.index(name)].revolute] for key in values
            ]
            for name, values in assumed.joints.items()
        },
        "plate_noise": f"{PLATE_NOISE:.1%}",
        "torque_noise": f"{TORQUE_NOISE:.1%}",
        "largest_step": STEPS[0],
        "unlimited": math.inf,
    }


_REASONS = {
    "coulomb": "friction: the model file has none for these",
    "rotor_inertia": "rotors: these are too light without, in some posture or for their friction",
    "max_effort": "max_effort: the model file's holds the robot in no posture",
}
_UNITS = {
    "coulomb": ("N", "N m"),
    "viscous": ("N s/m", "N m s/rad"),
    "rotor_inertia": ("kg", "kg m^2"),
    "max_effort": ("N", "N m"),
}
"""Of sliding and of rotary joints."""


def _environment() -> jinja2.Environment:
    """Templates beside this module, with filters that write TOML in one line."""
    environment = jinja2.Environment(  # of TOML, no HTML
        loader=jinja2.PackageLoader("testbed.lab", "experiment"),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.globals["plural"] = plural
    environment.filters |= {
        "toml": _toml,
        "key": _key,
        "table": _table,
        "body_table": lambda body: _table(BodyTable.of(body).model_dump(mode="json")),
        "digits": round_significant,
    }
    return environment


def _flaws(repair: Repair) -> Iterator[str]:
    """What was wrong with bodies: the first few, and how many."""
    yield from (f"  {flaw}" for flaw in repair.flaws[:NAMED])
    if len(repair.flaws) > NAMED:
        yield f"  and {len(repair.flaws) - NAMED} more"


def _key(name: str) -> str:
    """Write a name as a key of TOML."""
    return tomli_w.dumps({name: 0}).rstrip().removesuffix(" = 0")


def _toml(value: Any) -> str:
    """Write a string, a number or lists of them."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _table(values: Mapping[str, Any]) -> str:
    """Write an inline table."""
    return f"{{ {', '.join(f'{_key(key)} = {_toml(value)}' for key, value in values.items())} }}"
