"""What a run is known by: a hash of all that determines its result."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from functools import cache, lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import testbed
from testbed.experiment.experiment import Experiment
from testbed.experiment.versions import versions
from testbed.files import fingerprint
from testbed.robot.model_file import held_files, model_format

LENGTH = 32
"""Hexadecimal digits of a hash."""

ONLY_SHOWN = ("cli", "reporting", "viewer", "symbolic")
"""Rooms that no result depends on."""

_MODELS = (".xml", ".mjcf", ".urdf")


def run_hash(experiment: Experiment, methods: Sequence[str]) -> str:
    """The hash of a run: its experiment, its model files (meshes aside), the version of the code.

    Args:
        experiment: Of the run, resolved.
        methods: Which estimates are made.

    Raises:
        ModelError: There is no such model file.
    """
    left_out: Any = {"model": True, "name": True, "claim": True, "motion": {"file"}}
    said = [experiment.model_dump_json(exclude=left_out), ",".join(methods), code_version()]
    said.append(_model_digest(experiment.model, _stamp(experiment.model)))
    if experiment.motion.file:
        said.append(_digest(experiment.motion.file, _stamp(experiment.motion.file)))
    return hashlib.sha256("\n".join(said).encode()).hexdigest()[:LENGTH]


@cache
def code_version() -> str:
    """A digest of the modules that make results, and of the packages that they use."""
    home = Path(testbed.__file__).parent
    made_by = versions() | {"numba": version("numba")}
    digest = hashlib.sha256(repr(sorted(made_by.items())).encode())
    for path in sorted(home.rglob("*.py")):
        place = path.relative_to(home)
        if place.parts[0] not in ONLY_SHOWN:
            digest.update(place.as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def _stamp(path: str) -> tuple[int, int]:
    """What tells that a file has changed."""
    try:
        found = Path(path).stat()
    except OSError:
        return 0, 0
    return found.st_mtime_ns, found.st_size


@lru_cache(maxsize=256)
def _model_digest(path: str, stamp: tuple[int, int]) -> str:
    del stamp
    model = Path(path)
    parts = [model_format(model), fingerprint(model)]
    held = sorted(file for file in held_files(model) if file.suffix.lower() in _MODELS)
    parts += [fingerprint(file) for file in held if file != model.resolve()]
    return hashlib.sha256(" ".join(parts).encode()).hexdigest()


@lru_cache(maxsize=256)
def _digest(path: str, stamp: tuple[int, int]) -> str:
    del stamp
    return fingerprint(Path(path))
