"""All that came of a run, in one file: who looks at the run folder computes nothing again.

A ZIP archive of two members: JSON, in which an array is its shape, and the arrays' numbers one
after the other. Minimal sets and laws are names there, and are made again. What a field may be
is what its class says: nothing in such a file is code, or becomes the name of a file.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from types import UnionType
from typing import Any, Literal, cast, get_args, get_origin, get_type_hints
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

import numpy as np

from testbed.arrays import Array
from testbed.dynamics.drive_set import drive_set
from testbed.experiment.run import Run
from testbed.files import replacing
from testbed.identification.estimate import METHODS, MODEL_OF
from testbed.identification.identify import set_of
from testbed.identification.nuisances.all_nuisances import NUISANCES, TESTED
from testbed.identification.nuisances.nuisance import Nuisance
from testbed.identification.term_choice import as_settled
from testbed.parameters.joint_terms import DriveSet
from testbed.parameters.minimal_set import MinimalSet
from testbed.robot.friction import JointLaw, joint_law

FIELDS = (
    "estimates", "failures", "score", "warnings", "validation", "drives", "consistent", "findings",
)  # fmt: skip
"""Of a run, that are in its file."""

TEXT, NUMBERS = "run.json", "numbers"
"""The archive's members."""

NAMES: Mapping[type, Callable[[Any], Any]] = {
    MinimalSet: lambda found: found.model,
    DriveSet: lambda found: [term.name(found.tree) for term in found.asked],
    JointLaw: lambda law: law.kind,
    Nuisance: lambda nuisance: nuisance.kind,
}
"""What stands for values that are made again."""

LEAVES: Mapping[type, type | UnionType] = {bool: bool, float: float | int, int: int, str: str}
"""What JSON may say for plain values."""

LARGEST = 2_000_000_000
"""Bytes of both; a humanoid's have a tenth."""


def write_estimates(run: Run, path: Path, source: Mapping[str, str]) -> None:
    """Write what came of a run.

    Args:
        run: The run.
        path: Where to; what stands there is replaced.
        source: What it came of.
    """
    arrays: list[Array] = [np.zeros(0)]
    said = {name: _plain(getattr(run, name), arrays) for name in FIELDS}
    text = json.dumps({"source": source, "run": said})
    with replacing(path) as fresh, ZipFile(fresh, "w", ZIP_DEFLATED) as file:
        file.writestr(_member(TEXT), text)
        file.writestr(_member(NUMBERS), np.concatenate(arrays).tobytes())


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
        with ZipFile(path) as file:
            if sum(member.file_size for member in file.infolist()) > LARGEST:
                return None
            content = json.loads(file.read(TEXT))
            if content["source"] != source:
                return None
            reader = _Reader(run, np.frombuffer(file.read(NUMBERS)))
        hints = get_type_hints(Run)
        found = {name: reader.read(hints[name], content["run"][name]) for name in FIELDS}
        for each in found["estimates"].values():
            if each.names != (each.drives or each.minimal).names:
                return None
    except Exception:  # a file that was damaged may be wrong in any way
        return None
    settings = as_settled(run.settings, found["estimates"].values())
    return replace(run, settings=settings, **found)


def _member(name: str) -> ZipInfo:
    """Of an archive that is the same whenever it is written."""
    member = ZipInfo(name)
    member.compress_type = ZIP_DEFLATED
    return member


def _plain(value: Any, arrays: list[Array]) -> Any:
    """A value as JSON takes it, its arrays put aside."""
    if isinstance(value, np.ndarray):
        arrays.append(np.asarray(value, dtype=np.float64).ravel())
        return value.shape
    if type(value) in NAMES:
        return NAMES[type(value)](value)
    if is_dataclass(value):
        return {each.name: _plain(getattr(value, each.name), arrays) for each in fields(value)}
    if isinstance(value, Mapping):
        return [[key, _plain(each, arrays)] for key, each in value.items()]
    if isinstance(value, tuple):
        return [_plain(each, arrays) for each in value]
    return value


class _Reader:
    """Values of what `_plain` made, in the same order."""

    def __init__(self, run: Run, numbers: Array) -> None:
        tree, settings = run.tree, run.settings
        sets = {MODEL_OF[method]: set_of(tree, method, settings) for method in METHODS}
        nuisances = {each.kind: each for each in (*NUISANCES, *TESTED)}
        self._numbers, self._at = numbers, 0
        self._named: dict[Any, Callable[[Any], Any]] = {
            MinimalSet: sets.__getitem__,
            DriveSet: lambda words: drive_set(tree, sets["dynamic"], words),
            JointLaw: joint_law,
            Nuisance: nuisances.__getitem__,
            np.ndarray: self._array,
        }

    def read(self, kind: Any, value: Any) -> Any:
        """What JSON says, as a value of that kind."""
        origin, args = get_origin(kind), get_args(kind)
        if origin is UnionType:
            return None if value is None else self.read(args[0], value)
        if origin is tuple:
            return tuple(self.read(args[0], each) for each in value)
        if origin is Mapping:
            return {key: self.read(args[1], each) for key, each in value}
        if (origin or kind) in self._named:
            return self._named[origin or kind](value)
        if is_dataclass(kind):
            hints, make = get_type_hints(kind), cast(Any, kind)
            return make(**{f.name: self.read(hints[f.name], value[f.name]) for f in fields(kind)})
        there = value in args if origin is Literal else isinstance(value, LEAVES[kind])
        if not there:
            raise ValueError(f"{value!r} is none of {kind}")
        return value

    def _array(self, shape: list[int]) -> Array:
        first, self._at = self._at, self._at + int(np.prod(shape))
        return self._numbers[first : self._at].reshape(shape)
