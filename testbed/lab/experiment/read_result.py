"""Estimates read from `identify --json` or a run folder: for validation, for a design."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import ValidationError

from testbed.bodies.consistency.options import ConsistencyOptions
from testbed.bodies.estimate_summary import estimate_of_summary
from testbed.bodies.posterior import Posterior, ReportedEstimate, reported_estimate
from testbed.core.base.arrays import Array
from testbed.core.base.codec import decode, from_json
from testbed.core.base.contents import fingerprint, read_text
from testbed.core.base.errors import ExperimentError, plural
from testbed.core.base.file_kinds import expecting
from testbed.core.base.toml_text import checked, complaints, override
from testbed.core.estimation.estimate import (
    METHODS,
    Estimate,
    EstimateSummary,
    Method,
    channels_of,
)
from testbed.core.estimation.settings import Settings
from testbed.core.parameters.minimal_set import minimal_set
from testbed.core.parameters.rules import Model
from testbed.core.recordings.held import hold_still
from testbed.core.recordings.source import Source
from testbed.core.robot.model_file import ModelFile, file_of
from testbed.core.robot.tree import Tree
from testbed.lab.experiment.evaluate import wrong_prior
from testbed.lab.experiment.experiment import Experiment
from testbed.lab.experiment.results import EXPERIMENT, RESULT, UsedModel
from testbed.lab.experiment.rig import robot_of
from testbed.lab.experiment.robot_tables import RecordingTables, StrictTable

Part = TypeVar("Part", EstimateSummary, Posterior)

LARGEST_RESULT = 50_000_000
"""Bytes of a file with estimates; a thousand parameters have less."""


@dataclass(frozen=True, eq=False)
class KeptResult:
    """Estimates of a file, and what they are of.

    Attributes:
        tree: The robot.
        settings: How the signals were treated.
        prior: The robot with its bodies before the data: the file's; of a run, whose file is the
            truth, those that its experiment starts from.
        options: What is asked of consistent bodies, the prior error that which data chose.
        estimates: By least squares, one a method.
        answers: One a method.
    """

    tree: Tree
    settings: Settings
    prior: Tree
    options: ConsistencyOptions
    estimates: tuple[EstimateSummary, ...] = ()
    answers: tuple[ReportedEstimate, ...] = ()

    @property
    def file(self) -> ModelFile:
        """The robot's model file, with the joints that are held."""
        return file_of(self.tree)

    @property
    def whole_estimates(self) -> list[Estimate]:
        """The estimates with their structure.

        Raises:
            SettingsError: They are of other parameters.
        """
        settings = self.settings
        return [
            estimate_of_summary(self.tree, replace(each, settings=settings))
            for each in self.estimates
        ]

    def without_held(self, source: Source) -> Source:
        """A recording without the columns of the joints that are held.

        Raises:
            RecordingError: It has one of them elsewhere.
        """
        return hold_still(self.file, source, lock_only=True)[1]


def read_result(
    path: Path, model: Path | None = None, settings: Sequence[str] = ()
) -> KeptResult:
    """The estimates of a file, and the robot and settings that they are of.

    Args:
        path: What `identify --json` printed, a run folder, or the result in it.
        model: Where the model file is now; default where the file says.
        settings: Overrides "table.key=value" of robot and identification.

    Raises:
        ExperimentError: The file is no such result, or the model file is another.
        OSError: The file cannot be read.
    """
    if path.is_dir():
        if not (path / RESULT).is_file():
            raise ExperimentError(
                f"'{path}' is no folder of a run that ended: no {RESULT} in it"
            )
        path = path / RESULT
    if not path.exists():
        raise ExperimentError(
            f"there is no result '{path}': name what `identify --json` printed, or a run folder"
        )
    with expecting(path, "result"):
        content = _json(path)
    own, answers = _estimates(content, path)
    of = _of_run if content.get("settings") is None else _of_recording
    kept = of(content, path, model, settings)
    for each in (answer.estimate for answer in answers):
        count = len(channels_of(kept.tree, each.method))
        if len(each.residual) != count:
            raise ExperimentError(
                f"{path}: {each.method}: residual has {len(each.residual)} numbers, the robot has "
                f"{plural(count, 'channel')}"
            )
    return replace(kept, estimates=own, answers=answers)


def _estimates(
    content: dict[str, Any], path: Path
) -> tuple[tuple[EstimateSummary, ...], tuple[ReportedEstimate, ...]]:
    """Estimates by least squares, and those that count, one a method.

    Raises:
        ExperimentError: There is none, or one is not what it should be.
    """
    own = _by_method(EstimateSummary, content.get("estimates"), path)
    with_file = _by_method(Posterior, content.get("posterior"), path, ": posterior")
    there = [method for method in METHODS if method in own | with_file]
    if not there:
        raise ExperimentError(
            f"{path}: no result: it has no {' or '.join(METHODS)} estimate"
        )
    plain = bool(content.get("plain"))
    try:
        answers = [
            reported_estimate(own.get(m), with_file.get(m), plain=plain) for m in there
        ]
    except ValueError as error:
        raise ExperimentError(f"{path}: {error}") from None
    return tuple(own.values()), tuple(answers)


def _by_method(
    kind: type[Part], content: Any, path: Path, part: str = ""
) -> dict[Method, Part]:
    """Read the estimates of a JSON object by method; {} where the content is no object."""
    every = content if isinstance(content, dict) else {}
    there = [method for method in METHODS if method in every]
    return {m: _decoded(kind, every[m], f"{path}: {m}{part}") for m in there}


def _decoded(kind: type[Part], content: Any, source: str) -> Part:
    """Read one estimate of a file.

    Raises:
        ExperimentError: A part is missing, or is not what it should be.
    """
    try:
        found: Part = decode(kind, {**content, "settings": Settings()}, {})
    except ValidationError as error:
        raise ExperimentError(f"{source}: {complaints(error, StrictTable)}") from None
    except TypeError as error:
        raise ExperimentError(f"{source}: no estimate: {error}") from None
    numbers = [each for each in vars(found).values() if isinstance(each, np.ndarray)]
    if (
        not all(np.isfinite(each).all() for each in numbers)
        or (found.residual < 0).any()
    ):
        raise ExperimentError(
            f"{source}: its values, covariance, gravity and residual are finite numbers, the "
            "residual's none below zero"
        )
    return found


def _json(path: Path) -> dict[str, Any]:
    """What a file says.

    Raises:
        ExperimentError: It is not JSON, or no object.
    """
    try:
        content = from_json(read_text(path, LARGEST_RESULT).encode())
    except ValueError as error:
        raise ExperimentError(f"{path}: no result: it is not JSON: {error}") from None
    if not isinstance(content, dict):
        raise ExperimentError(
            f"{path}: no result: it is JSON, but no object with estimates"
        )
    return content


def _of_recording(
    content: dict[str, Any], path: Path, model: Path | None, words: Sequence[str]
) -> KeptResult:
    """What a recording's estimates are of."""
    kept = checked(UsedModel, content.get("model", {}), f"{path}: model")
    said = content["settings"]
    if not isinstance(said, dict):
        raise ExperimentError(f"{path}: no result: it has no settings")
    override(said, words)
    tables = checked(RecordingTables, said, f"{path}: settings")
    place = _checked_model(model or Path(kept.path), kept.sha256, path)
    held = kept.lock | tables.robot.lock
    file = ModelFile(place, kept.weld_root, tables.robot.bodies or None, held)
    tree, options = tables.sensed(tables.robot.on(file.tree())), tables.consistent
    if not any(word.startswith("consistent.prior_error") for word in words):
        parts = (content.get("posterior") or {}).values()
        chosen = [part["prior_error"] for part in parts if part.get("used")]
        options = replace(options, prior_error=min(chosen, default=options.prior_error))
    return KeptResult(tree, tables.identification, tree, options)


def _of_run(
    content: dict[str, Any], path: Path, model: Path | None, words: Sequence[str]
) -> KeptResult:
    """What a run's estimates are of, by the files beside them."""
    beside = path.parent / EXPERIMENT
    if not beside.is_file():
        raise ExperimentError(
            f"{path}: no result: it names no model, as `identify --json` does, and is in no run "
            f"folder, with {EXPERIMENT}"
        )
    experiment = Experiment.from_toml(beside, words)
    used = content.get("model")
    sha256 = used.get("sha256") if isinstance(used, dict) else None
    place = _checked_model(model or Path(experiment.model), sha256, path)
    experiment = experiment.model_copy(update={"model": str(place)})
    options = experiment.consistent or ConsistencyOptions()
    tree = robot_of(experiment)
    prior = wrong_prior(tree, experiment)
    return KeptResult(tree, experiment.identification, prior, options)


def _checked_model(place: Path, sha256: object, path: Path) -> Path:
    """A model file, if it is the one that a result is of.

    Raises:
        ExperimentError: It is not there, or is another.
    """
    if "\0" in str(place) or not place.is_file():
        raise ExperimentError(
            f"{path}: its model file '{place}' is not there; --model names it"
        )
    if fingerprint(place) != sha256:
        raise ExperimentError(
            f"'{place}' is not the model of {path}: its SHA-256 is another"
        )
    return place


def prior_covariance(kept: KeptResult, experiment: Experiment) -> Array:
    """The covariance of an earlier estimate in the order of an experiment's parameters, (N, N).

    Args:
        kept: The estimates of a file.
        experiment: Says which parameters are wanted.

    Raises:
        ExperimentError: The file's estimates are of other parameters.
    """
    joints = experiment.excitation.instrument == "joints"
    wanted = "internal" if joints else "external"
    model: Model = "dynamic" if joints else "reaction"
    zeros = experiment.identification.zeros
    names = minimal_set(robot_of(experiment), model, zeros=zeros).names
    for estimate in kept.estimates:
        if estimate.method == wanted and set(names) <= set(estimate.names):
            return estimate.marginal(names).covariance
    raise ExperimentError(
        f"the earlier result has no {wanted} estimate of {', '.join(names)}: it must be of the "
        "same robot, with the same identification.zeros"
    )
