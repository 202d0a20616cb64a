"""Read estimates from the output of `identify --json` or a run folder."""

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
from testbed.core.base.codec import from_json_values, parse_json
from testbed.core.base.contents import read_text, sha256_of_file
from testbed.core.base.errors import ExperimentError, count_with_noun
from testbed.core.base.file_kinds import explain_wrong_kind
from testbed.core.base.toml_text import (
    apply_settings,
    validate_tables,
    validation_message,
)
from testbed.core.estimation.estimate import Estimate, EstimateSummary, channel_names
from testbed.core.estimation.settings import Settings
from testbed.core.parameters.minimal_set import minimal_set
from testbed.core.parameters.rules import SIGNALS, Signal
from testbed.core.recordings.held import hold_still
from testbed.core.recordings.source import Source
from testbed.core.robot.model_file import ModelFile, model_file_of
from testbed.core.robot.tree import Tree
from testbed.lab.experiment.evaluate import perturbed_prior
from testbed.lab.experiment.experiment import Experiment
from testbed.lab.experiment.results import EXPERIMENT_FILE, RESULT_FILE, UsedModel
from testbed.lab.experiment.rig import robot_of
from testbed.lab.experiment.robot_tables import RecordingTables, StrictTable

AnyEstimate = TypeVar("AnyEstimate", EstimateSummary, Posterior)
"""Estimate by least squares, or with the model file as prior."""

MAX_RESULT_BYTES = 50_000_000
"""Largest size of a file with estimates [bytes]; a thousand parameters take less."""


@dataclass(frozen=True, eq=False)
class StoredResult:
    """Estimates stored in a file, with their robot and settings.

    Attributes:
        tree: The robot.
        settings: Filters and other settings of the estimates.
        prior: Robot with the prior bodies. These are the bodies of the model file, or, for a
            simulated run, whose model file is the truth, the perturbed bodies of its experiment.
        options: Options of the consistent bodies, with the prior error chosen from the data.
        estimates: Least-squares estimates, one per method.
        reported_estimates: Estimates reported to the user, one per method.
    """

    tree: Tree
    settings: Settings
    prior: Tree
    options: ConsistencyOptions
    estimates: tuple[EstimateSummary, ...] = ()
    reported_estimates: tuple[ReportedEstimate, ...] = ()

    @property
    def file(self) -> ModelFile:
        """Model file of the robot, with locked joints."""
        return model_file_of(self.tree)

    @property
    def full_estimates(self) -> list[Estimate]:
        """Least-squares estimates, with the minimal sets to which their parameters belong.

        Raises:
            SettingsError: The parameters do not match the robot and the settings.
        """
        settings = self.settings
        return [
            estimate_of_summary(self.tree, replace(each, settings=settings))
            for each in self.estimates
        ]

    def without_locked_joints(self, source: Source) -> Source:
        """Recording with the columns of locked joints removed.

        Args:
            source: Recording that may have these columns.

        Raises:
            RecordingError: A locked joint moves in the recording, or rests at another position.
        """
        return hold_still(self.file, source, lock_only=True)[1]


def read_result(
    path: Path, model: Path | None = None, settings: Sequence[str] = ()
) -> StoredResult:
    """Read the estimates of a file, with their robot and settings.

    Args:
        path: Output of `identify --json`, a run folder, or the result file in it.
        model: Current path of the model file; default the path stored in the file.
        settings: Overrides "table.key=value" of robot and identification.

    Raises:
        ExperimentError: The file contains no such result, or the model file has changed.
        OSError: The file cannot be read.
    """
    if path.is_dir():
        if not (path / RESULT_FILE).is_file():
            raise ExperimentError(
                f"'{path}' is no folder of a run that ended: no {RESULT_FILE} in it"
            )
        path = path / RESULT_FILE
    if not path.exists():
        raise ExperimentError(
            f"there is no result '{path}': name what `identify --json` printed, or a run folder"
        )
    with explain_wrong_kind(path, "result"):
        content = _json_object(path)
    least_squares, reported = _stored_estimates(content, path)
    result_from = _run_result if content.get("settings") is None else _recording_result
    result = result_from(content, path, model, settings)
    for each in (report.estimate for report in reported):
        count = len(channel_names(result.tree, each.method))
        if len(each.residual) != count:
            raise ExperimentError(
                f"{path}: {each.method}: residual has {len(each.residual)} numbers, the robot has "
                f"{count_with_noun(count, 'channel')}"
            )
    return replace(result, estimates=least_squares, reported_estimates=reported)


def _stored_estimates(
    content: dict[str, Any], path: Path
) -> tuple[tuple[EstimateSummary, ...], tuple[ReportedEstimate, ...]]:
    """Least-squares and reported estimates of a file, each with one estimate per method.

    Raises:
        ExperimentError: There is no estimate, or an estimate is not valid.
    """
    least_squares = _estimates_by_method(
        EstimateSummary, content.get("estimates"), path
    )
    posteriors = _estimates_by_method(
        Posterior, content.get("posterior"), path, ": posterior"
    )
    methods = [method for method in SIGNALS if method in least_squares | posteriors]
    if not methods:
        raise ExperimentError(
            f"{path}: no result: it has no {' or '.join(SIGNALS)} estimate"
        )
    plain = bool(content.get("plain"))
    try:
        reported = [
            reported_estimate(least_squares.get(m), posteriors.get(m), plain=plain)
            for m in methods
        ]
    except ValueError as error:
        raise ExperimentError(f"{path}: {error}") from None
    return tuple(least_squares.values()), tuple(reported)


def _estimates_by_method(
    kind: type[AnyEstimate], content: Any, path: Path, suffix: str = ""
) -> dict[Signal, AnyEstimate]:
    """Estimates of a JSON object keyed by method, in the order of `SIGNALS`.

    The result is empty if `content` is not an object.

    Args:
        kind: Class of the estimates.
        content: JSON values by method.
        path: Path of the file, for error messages.
        suffix: Position within the file, for error messages.

    Raises:
        ExperimentError: An estimate is not valid.
    """
    contents = content if isinstance(content, dict) else {}
    methods = [method for method in SIGNALS if method in contents]
    return {
        m: _decoded_estimate(kind, contents[m], f"{path}: {m}{suffix}") for m in methods
    }


def _decoded_estimate(
    kind: type[AnyEstimate], content: Any, source: str
) -> AnyEstimate:
    """Estimate from JSON values.

    Args:
        kind: Class of the estimate.
        content: JSON values.
        source: File name and position of the estimate, for error messages.

    Raises:
        ExperimentError: A field is missing, not valid or not finite, or a residual is negative.
    """
    try:
        estimate: AnyEstimate = from_json_values(
            kind, {**content, "settings": Settings()}, {}
        )
    except ValidationError as error:
        raise ExperimentError(
            f"{source}: {validation_message(error, StrictTable)}"
        ) from None
    except TypeError as error:
        raise ExperimentError(f"{source}: no estimate: {error}") from None
    arrays = [each for each in vars(estimate).values() if isinstance(each, np.ndarray)]
    if (
        not all(np.isfinite(each).all() for each in arrays)
        or (estimate.residual < 0).any()
    ):
        raise ExperimentError(
            f"{source}: its values, covariance, gravity and residual are finite numbers, the "
            "residual's none below zero"
        )
    return estimate


def _json_object(path: Path) -> dict[str, Any]:
    """Read the JSON object in a file.

    Raises:
        ExperimentError: The file is not JSON, or contains no object.
    """
    try:
        content = parse_json(read_text(path, MAX_RESULT_BYTES).encode())
    except ValueError as error:
        raise ExperimentError(f"{path}: no result: it is not JSON: {error}") from None
    if not isinstance(content, dict):
        raise ExperimentError(
            f"{path}: no result: it is JSON, but no object with estimates"
        )
    return content


def _recording_result(
    content: dict[str, Any], path: Path, model: Path | None, overrides: Sequence[str]
) -> StoredResult:
    """Robot and settings of a result that contains both, as from `identify --json`.

    Unless overridden, the prior error of the consistent bodies is the smallest prior error of the
    posteriors in use.

    Args:
        content: JSON object of the result.
        path: Path of the result, for error messages.
        model: Current path of the model file; default the path in the result.
        overrides: Overrides "table.key=value".
    """
    used_model = validate_tables(UsedModel, content.get("model", {}), f"{path}: model")
    settings = content["settings"]
    if not isinstance(settings, dict):
        raise ExperimentError(f"{path}: no result: it has no settings")
    apply_settings(settings, overrides)
    tables = validate_tables(RecordingTables, settings, f"{path}: settings")
    model_path = _checked_model(model or Path(used_model.path), used_model.sha256, path)
    lock = used_model.lock | tables.robot.lock
    file = ModelFile(
        model_path,
        used_model.weld_root,
        tables.robot.replacement_inertias or None,
        lock,
    )
    tree, options = (
        tables.sensed_part(tables.robot.configured_robot(file.tree())),
        tables.consistent,
    )
    if not any(
        override_text.startswith("consistent.prior_error")
        for override_text in overrides
    ):
        posteriors = (content.get("posterior") or {}).values()
        prior_errors = [
            posterior["prior_error"]
            for posterior in posteriors
            if posterior.get("used")
        ]
        options = replace(
            options, prior_error=min(prior_errors, default=options.prior_error)
        )
    return StoredResult(tree, tables.identification, tree, options)


def _run_result(
    content: dict[str, Any], path: Path, model: Path | None, overrides: Sequence[str]
) -> StoredResult:
    """Robot and settings of a result in a run folder, read from its experiment file.

    Args:
        content: JSON object of the result.
        path: Path of the result.
        model: Current path of the model file; default the path in the experiment file.
        overrides: Overrides "table.key=value".
    """
    experiment_path = path.parent / EXPERIMENT_FILE
    if not experiment_path.is_file():
        raise ExperimentError(
            f"{path}: no result: it names no model, as `identify --json` does, and is in no run "
            f"folder, with {EXPERIMENT_FILE}"
        )
    experiment = Experiment.from_toml(experiment_path, overrides)
    used_model = content.get("model")
    sha256 = used_model.get("sha256") if isinstance(used_model, dict) else None
    model_path = _checked_model(model or Path(experiment.model), sha256, path)
    experiment = experiment.model_copy(update={"model": str(model_path)})
    options = experiment.consistent or ConsistencyOptions()
    tree = robot_of(experiment)
    prior = perturbed_prior(tree, experiment)
    return StoredResult(tree, experiment.identification, prior, options)


def _checked_model(model: Path, sha256: object, path: Path) -> Path:
    """Path of a model file whose SHA-256 equals the one in the result.

    Args:
        model: Path of the model file.
        sha256: SHA-256 in the result.
        path: Path of the result, for error messages.

    Raises:
        ExperimentError: The file does not exist or differs.
    """
    if "\0" in str(model) or not model.is_file():
        raise ExperimentError(
            f"{path}: its model file '{model}' is not there; --model names it"
        )
    if sha256_of_file(model) != sha256:
        raise ExperimentError(
            f"'{model}' is not the model of {path}: its SHA-256 is another"
        )
    return model


def prior_covariance(result: StoredResult, experiment: Experiment) -> Array:
    """Covariance of an earlier estimate, in an experiment's parameter order, (N, N).

    The N parameters are the base parameters of the experiment's robot. The first least-squares
    estimate by the selected method that has all of them is used.

    Args:
        result: Estimates of a file.
        experiment: Experiment whose `excitation.instrument` selects the method: joint torques for
            "joints", else the wrench.

    Raises:
        ExperimentError: The file has no estimate of all N parameters.
    """
    by_torque = experiment.excitation.instrument == "joints"
    method = "torque" if by_torque else "wrench"
    signal: Signal = "torque" if by_torque else "wrench"
    zeros = experiment.identification.zeros
    names = minimal_set(robot_of(experiment), signal, zeros=zeros).names
    for estimate in result.estimates:
        if estimate.method == method and set(names) <= set(estimate.names):
            return estimate.marginal(names).covariance
    raise ExperimentError(
        f"the earlier result has no {method} estimate of {', '.join(names)}: it must be of the "
        "same robot, with the same identification.zeros"
    )
