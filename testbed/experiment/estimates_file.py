"""All that came of a run, in one file: who looks at the run folder computes nothing again.

Compressed JSON: fields by name, arrays with their shapes. Minimal sets and laws are names there,
and are made again. What a field may be is what its class says: nothing in such a file is code, or
becomes the name of a file.
"""

from __future__ import annotations

import gzip
import json
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from types import UnionType
from typing import Any, Literal, cast, get_args, get_origin, get_type_hints

import numpy as np

from testbed.dynamics.drive_set import drive_set
from testbed.experiment.run import Run
from testbed.files import replacing
from testbed.identification.estimate import METHODS, MODEL_OF
from testbed.identification.nuisances.all_nuisances import NUISANCES, TESTED
from testbed.identification.nuisances.nuisance import Nuisance
from testbed.identification.problem import set_of
from testbed.identification.term_choice import as_settled
from testbed.parameters.joint_terms import DriveSet
from testbed.parameters.minimal_set import MinimalSet
from testbed.robot.friction import JointLaw, joint_law

FIELDS = (
    "estimates", "failures", "score", "validation", "drives", "consistent", "diagnostics",
)  # fmt: skip
"""Of a run, that are in its file."""

LARGEST = 500_000_000
"""Bytes of the JSON; a humanoid's has a tenth."""

LEAVES: Mapping[type, type | UnionType] = {bool: bool, float: float | int, int: int, str: str}
"""What JSON may say for plain values."""

Made = Mapping[Any, Callable[[Any], Any]]

PLAIN: Made = {
    np.ndarray: lambda array: [array.shape, array.ravel().tolist()],
    MinimalSet: lambda found: found.model,
    DriveSet: lambda found: [term.name(found.tree) for term in found.asked],
    JointLaw: lambda law: law.kind,
    Nuisance: lambda nuisance: nuisance.kind,
}
"""What stands in a file for values that have no fields there."""


def write_estimates(run: Run, path: Path, source: Mapping[str, str]) -> None:
    """Write what came of a run.

    Args:
        run: The run.
        path: Where to; what stands there is replaced.
        source: What it came of.
    """
    content = {"source": source, "run": {name: _plain(getattr(run, name)) for name in FIELDS}}
    with replacing(path) as fresh:
        fresh.write_bytes(gzip.compress(json.dumps(content).encode(), mtime=0))


def read_estimates(run: Run, path: Path, source: Mapping[str, str]) -> Run | None:
    """A run with what came of it.

    Args:
        run: The same without estimates.
        path: The file.
        source: What the run comes of.

    Returns:
        None where there is no such file, or what it holds came of something else.
    """
    try:
        with gzip.open(path) as file:
            content = json.loads(file.read(LARGEST))
        if content["source"] != source:
            return None
        hints, made = get_type_hints(Run), _made_again(run)
        found = {name: _value(hints[name], content["run"][name], made) for name in FIELDS}
        for each in found["estimates"].values():
            if each.names != (each.drives or each.minimal).names:
                return None
    except Exception:  # a file that was damaged may be wrong in any way
        return None
    settings = as_settled(run.settings, found["estimates"].values())
    return replace(run, settings=settings, **found)


def _plain(value: Any) -> Any:
    """A value as JSON takes it."""
    if type(value) in PLAIN:
        return PLAIN[type(value)](value)
    if is_dataclass(value):
        return {each.name: _plain(getattr(value, each.name)) for each in fields(value)}
    if isinstance(value, Mapping):
        return [[key, _plain(each)] for key, each in value.items()]
    return [_plain(each) for each in value] if isinstance(value, tuple) else value


def _made_again(run: Run) -> Made:
    """What makes values of what `PLAIN` says of them."""
    tree, settings = run.tree, run.settings
    sets = {MODEL_OF[method]: set_of(tree, method, settings) for method in METHODS}
    return {
        np.ndarray: lambda said: np.array(said[1], dtype=np.float64).reshape(said[0]),
        MinimalSet: sets.__getitem__,
        DriveSet: lambda words: drive_set(tree, sets["dynamic"], words),
        JointLaw: joint_law,
        Nuisance: {each.kind: each for each in (*NUISANCES, *TESTED)}.__getitem__,
    }


def _value(kind: Any, said: Any, made: Made) -> Any:
    """What JSON says, as a value of a kind."""
    origin, args = get_origin(kind), get_args(kind)
    if origin is UnionType:
        return None if said is None else _value(args[0], said, made)
    if origin is tuple:
        return tuple(_value(args[0], each, made) for each in said)
    if origin is Mapping:
        return {key: _value(args[1], each, made) for key, each in said}
    if (origin or kind) in made:
        return made[origin or kind](said)
    if is_dataclass(kind):
        hints, make = get_type_hints(kind), cast(Any, kind)
        return make(**{f.name: _value(hints[f.name], said[f.name], made) for f in fields(kind)})
    if not (said in args if origin is Literal else isinstance(said, LEAVES[kind])):
        raise ValueError(f"{said!r} is none of {kind}")
    return said
