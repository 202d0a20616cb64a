"""Validation of an estimate by the residuals of another recording.

The regressor rows of the other recording are formed as for identification. The rms residual is
compared with its expected size: the noise in the estimate's own recording, and the errors that the
covariance of the parameters causes along the other motion.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from testbed.applications.prediction import covariance_without_correction
from testbed.bodies.estimate_summary import check_parameters
from testbed.bodies.prediction_errors import (
    LEAST_SQUARES,
    REFITTED,
    PredictionErrors,
    errors_on_recording,
)
from testbed.core.base.arrays import Array, freeze_arrays
from testbed.core.base.blas import one_blas_thread
from testbed.core.base.codec import schema_with_properties
from testbed.core.base.diagnostics import (
    Diagnosed,
    Diagnostic,
    make_diagnostic,
    sentences,
)
from testbed.core.base.errors import RecordingError
from testbed.core.base.stages import Progress, ignore_progress
from testbed.core.base.summary_table import Summarized, SummaryTable
from testbed.core.estimation.estimate import (
    Estimate,
    EstimateSummary,
    channel_label,
    channel_units,
    non_negligible_residuals,
)
from testbed.core.estimation.model_errors.model_errors import ModelErrorFreeSource
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.normal_equations import matrix_square_root
from testbed.core.estimation.selection.chosen import completed_by_estimates
from testbed.core.estimation.settings import Settings
from testbed.core.parameters.rules import Signal
from testbed.core.recordings.source import RecordingLike, Source
from testbed.core.robot.friction import OFFSET_DRIFT
from testbed.core.robot.tree import Tree
from testbed.sensors.corrected import corrected

Z_95_PERCENT = 1.96
"""Half width of the 95 % interval of a normal distribution, in standard deviations."""

MAX_ERROR_RATIO = 2.0
"""Ratio of residual to expected error above which a warning is given."""


@dataclass(frozen=True, eq=False, repr=False)
class Validation(Diagnosed, Summarized):
    """Residuals of an estimate on another recording, with their expected sizes.

    Attributes:
        method: Signal of the estimate.
        channels: Names of the C measured channels.
        units: Unit of each channel, N or N m.
        rows: Number of rows used in each channel; without rows all statistics are nan.
        signal: Rms of the measured rows, (C,) [N, N m].
        residual: Rms residual, (C,) [N, N m].
        mean: Mean residual, (C,) [N, N m]; it reveals a zero offset that changed between the
            recordings.
        noise: Rms residual of the estimate on its own recording, (C,) [N, N m].
        spread: Rms error expected from the parameters' covariance and the model errors, (C,) [N, N
            m].
        within: Fraction of rows inside the 95 % band of noise, parameter errors and model errors,
            (C,).
        zero_unknown: True if the plate's zero offset is unknown, so that mean residuals are not
            errors.
        errors: Prediction errors of all candidate models, including the estimate; None without
            other candidates.
        held: Name of the estimate among the candidate models: "plain" or "posterior".
    """

    method: Signal
    channels: tuple[str, ...]
    units: tuple[str, ...]
    rows: tuple[int, ...]
    signal: Array
    residual: Array
    mean: Array
    noise: Array
    spread: Array
    within: Array
    zero_unknown: bool = False
    errors: PredictionErrors | None = None
    held: str = LEAST_SQUARES

    __get_pydantic_core_schema__ = schema_with_properties(
        "relative_residual", "ratio", "diagnostics"
    )

    def __post_init__(self) -> None:
        c = len(self.channels)
        freeze_arrays(
            self,
            signal=(c,),
            residual=(c,),
            mean=(c,),
            noise=(c,),
            spread=(c,),
            within=(c,),
        )

    @property
    def summary(self) -> SummaryTable:
        """Table of rms residuals by channel, relative to the signal and the expected error."""
        parts = zip(
            self.residual,
            self.units,
            self.relative_residual,
            self.ratio,
            self.within,
            strict=True,
        )
        cells = [
            (f"{r:.3g}", unit, f"{s:.2%}", f"{ratio:.2g}", f"{within:.0%}")
            for r, unit, s, ratio, within in parts
        ]
        rows = [(name, *cell) for name, cell in zip(self.channels, cells, strict=True)]
        heads = (
            "channel",
            "rms residual",
            "unit",
            "of the signal",
            "over expected error",
            "in band",
        )
        warnings = tuple(f"warning: {line}" for line in sentences(self.diagnostics))
        return SummaryTable("estimate on another recording", (heads, *rows), warnings)

    @property
    def relative_residual(self) -> Array:
        """Ratio of rms residual to rms signal, (C,); nan for a channel without signal."""
        return _quotient(self.residual, self.signal)

    @property
    def expected_error(self) -> Array:
        """Rms error expected from noise and parameter covariance, (C,) [N, N m]."""
        return np.hypot(self.noise, self.spread)

    @property
    def ratio(self) -> Array:
        """Ratio of error to expected error, (C,); about 1 or less for a valid estimate."""
        return _quotient(self.error, self.expected_error)

    @property
    def error(self) -> Array:
        """Rms residual, or standard deviation if the plate's zero is unknown, (C,) [N, N m]."""
        return self.scatter if self.zero_unknown else self.residual

    @property
    def scatter(self) -> Array:
        """Standard deviation of the residual about its mean, (C,) [N, N m]."""
        return np.sqrt(np.maximum(self.residual**2 - self.mean**2, 0.0))

    @property
    def matters(self) -> tuple[bool, ...]:
        """Flags of channels whose error is not negligible.

        An error is negligible if it is below the fraction `NEGLIGIBLE_FRACTION` of the largest
        signal among the channels of the same unit.
        """
        return non_negligible_residuals(self.error, self.signal, self.units)

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Diagnostics of channels predicted worse than by rival models, or worse than expected.

        The rival models are "plain" and "refitted", if there are `errors`. An error is worse than
        expected if it exceeds `MAX_ERROR_RATIO` times the expected error and is not negligible.
        """
        worse: list[Diagnostic] = []
        if self.errors is not None:
            worse = [
                d
                for rival in (LEAST_SQUARES, REFITTED)
                for d in self.errors.worse_channels(self.held, rival)
            ]
        return (*worse, *_diagnostics(self))


def validate(
    tree: Tree,
    recording: RecordingLike,
    estimate: EstimateSummary,
    *,
    gravity: ArrayLike | None = None,
    settings: Settings | None = None,
    threads: int | None = None,
    progress: Progress = ignore_progress,
    models: Mapping[str, Array] | None = None,
    held: str = LEAST_SQUARES,
) -> Validation:
    """Compute an estimate's residuals on a recording that was not used to make it.

    Rows are formed as in `identify`, with the same filters, tare and gravity. Estimated sensor
    errors are removed first, except those of a single recording (zero and drift of the plate). No
    mean is subtracted; see `Validation.mean`. Model errors that the estimate contains and that
    apply to other motions are subtracted, and their variance is part of the expected error.

    Args:
        tree: The robot; its inertias are not used, except for `settings.zeros`.
        recording: Another recording of the same robot and sensors, as for `identify`.
        estimate: Estimate to be validated.
        gravity: Gravity, (3,) [m/s^2], bedplate frame; default the recording's, if present,
            otherwise the estimate's.
        settings: Settings of the signal processing; default those of the estimate. If joint terms
            are to be selected, those selected in the estimate are used.
        threads: Number of threads; default one per processor.
        progress: Called with the numbers of processed samples and of all samples.
        models: Parameter values of rival models (`Posterior.models`), (p,), by name; their
            prediction errors become `Validation.errors`.
        held: Name of the estimate among the models: "plain" or "posterior".

    Raises:
        RecordingError: The recording cannot be used for the estimate's signal.
        SettingsError: Robot and settings lead to other parameters than those of the estimate.
    """
    if settings is None:
        settings = estimate.settings
    elif isinstance(estimate, Estimate):
        settings = completed_by_estimates(settings, [estimate])
    problem = Problem.from_recording(
        tree.with_gravity(estimate.gravity),
        recording,
        estimate.method,
        settings,
        gravity=gravity,
        threads=threads,
        progress=progress,
    )
    check_parameters(problem, estimate)
    source = corrected(problem.source, problem.tree, estimate.sensor_errors)
    with one_blas_thread():
        validation = _validation(problem, source, estimate)
        if models:
            errors = errors_on_recording(
                problem, source, {**models, held: estimate.values}
            )
            validation = replace(validation, errors=errors, held=held)
    return validation


def _validation(
    problem: Problem, source: Source, estimate: EstimateSummary
) -> Validation:
    """Statistics of the residuals on another recording.

    Model errors in the estimate's correction, if there is one, are subtracted. The drift of joint
    offsets is not included.

    Args:
        problem: Identification problem of the other recording.
        source: The other recording, with sensor errors removed.
        estimate: Estimate to be validated.

    Raises:
        RecordingError: Values are too large to be summed.
    """
    model_variance = np.zeros(len(problem.channels))
    covariance = covariance_without_correction(estimate)
    if estimate.correction is not None:
        source = ModelErrorFreeSource(
            problem, source, estimate.values, estimate.correction
        )
        model_variance = source.doubt
    passes = problem.passes(2, source, whole=True)
    equations = problem.equations(passes)
    is_drift = [name.startswith(OFFSET_DRIFT.kind + "/") for name in estimate.names]
    # the drift of offsets is one recording's
    values = np.where(is_drift, 0.0, estimate.values)
    sums, squares, in_band = np.zeros((3, len(problem.channels)))
    fixed_variance = (estimate.residual**2 + model_variance)[:, None]
    combined = np.column_stack([values, matrix_square_root(covariance)])
    for columns, measured in passes.rows(combined):
        residual = measured - columns[..., 0]
        sums += residual.sum(axis=1)
        squares += (residual**2).sum(axis=1)
        variance = fixed_variance + (columns[..., 1:] ** 2).sum(axis=2)
        counts = columns[..., 1:].any(axis=2)
        in_band += (counts & (residual**2 <= Z_95_PERCENT**2 * variance)).sum(axis=1)
    used = np.where(equations.used > 0, equations.used, np.nan)
    squared_spread = np.maximum(
        np.einsum("cij,ij->c", equations.normal, covariance), 0.0
    )
    validation = Validation(
        method=estimate.method,
        channels=equations.channels,
        units=channel_units(problem.tree, estimate.method),
        rows=tuple(int(n) for n in equations.used),
        signal=np.sqrt(equations.squares / used),
        residual=np.sqrt(squares / used),
        mean=sums / used,
        noise=np.where(np.isnan(used), np.nan, estimate.residual),
        spread=np.sqrt(squared_spread / used + model_variance),
        within=in_band / used,
        zero_unknown=bool(estimate.unidentifiable),
    )
    statistics = [
        validation.signal,
        validation.residual,
        validation.mean,
        validation.spread,
    ]
    if not np.isfinite(statistics)[:, equations.used > 0].all():
        raise RecordingError(
            "the recording or the estimate holds numbers too large for sums"
        )
    return validation


def _diagnostics(validation: Validation) -> Iterator[Diagnostic]:
    """Yield diagnostics of channels with errors above `MAX_ERROR_RATIO` times the expected error.

    Negligible errors are skipped. The code is "estimate.prediction-offset" if only the mean makes
    the residual exceed the limit, and "estimate.prediction" otherwise.
    """
    # never true where the zero offset is unknown
    is_constant = (
        _quotient(validation.scatter, validation.expected_error) <= MAX_ERROR_RATIO
    )
    for c, (name, ratio) in enumerate(
        zip(validation.channels, validation.ratio, strict=True)
    ):
        if ratio > MAX_ERROR_RATIO and validation.matters[c]:
            yield make_diagnostic(
                "estimate.prediction-offset"
                if is_constant[c]
                else "estimate.prediction",
                channel_label(validation.method, name),
                float(ratio),
                method=validation.method,
                residual=validation.residual[c],
                expected_error=validation.expected_error[c],
                mean=validation.mean[c],
                unit=validation.units[c],
            )


def _quotient(numerator: Array, denominator: Array) -> Array:
    """Quotient of two arrays; nan for zero over zero, inf for other divisions by zero."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return numerator / denominator
