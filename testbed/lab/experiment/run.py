"""A run: recording of a robot with estimates, their scores and diagnostics."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from testbed.applications.analysis import analyse
from testbed.applications.drives.identify_drives import (
    DriveIdentification,
    identify_drives,
)
from testbed.applications.prediction import longest_segment_motion
from testbed.applications.validate import Validation
from testbed.bodies.consistency.consistent import Consistent
from testbed.bodies.consistency.options import ConsistencyOptions
from testbed.bodies.posterior import Posterior
from testbed.bodies.prior import PriorBodies
from testbed.bodies.verdict import WELL_CODE, verdict_of
from testbed.core.base.diagnostics import (
    Diagnosed,
    Diagnostic,
    make_diagnostic,
    ordered_diagnostics,
    sentences,
    worded_for_sensor,
)
from testbed.core.base.errors import (
    RecordingError,
    SettingsError,
    TestbedError,
    count_with_noun,
)
from testbed.core.base.stages import Progress, ignore_progress
from testbed.core.base.summary_table import Summarized, SummaryTable
from testbed.core.dynamics.newton_euler import Motion
from testbed.core.estimation.diagnostics.torques import diagnostics_of_estimates
from testbed.core.estimation.estimate import METHOD_LABELS, Estimate, robot_sensor_label
from testbed.core.estimation.selection.chosen import completed_by_estimates
from testbed.core.estimation.sensor.correction import CalibrationCovariance
from testbed.core.estimation.settings import DEFAULTS, Settings
from testbed.core.parameters.rules import SIGNALS, Signal
from testbed.core.recordings.geometry import with_recorded_gravity
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.source import longest_segment
from testbed.core.recordings.views import adapt_to_robot, with_gear_shafts
from testbed.core.robot.model_file import ModelFile
from testbed.core.robot.tree import Tree
from testbed.lab.experiment.experiment import Experiment
from testbed.lab.experiment.score import Errors, Score, drive_metrics, score


def recorded_motion(recording: Recording, settings: Settings) -> tuple[Motion, slice]:
    """Motion of a recording's longest segment without gaps, and the slice of its samples.

    If the segment is too short for the filters, derivatives are finite differences of unfiltered
    positions.

    Args:
        recording: Recording of at least two samples.
        settings: Settings with the filter of positions.
    """
    try:
        return longest_segment_motion(recording, settings)
    except RecordingError:
        first, last = longest_segment(recording)
        segment = recording.part(first, last)
        velocity = np.gradient(segment.position, 1 / segment.rate, axis=0)
        rates = velocity, np.gradient(velocity, 1 / segment.rate, axis=0)
        return Motion(segment.time, segment.position, *rates), slice(first, last)


MIN_CORRELATION = 0.9
"""Smallest absolute correlation of two parameters that is reported."""

MAX_PAIRS = 5
"""Largest number of correlated pairs in a message."""

Z_THRESHOLD = 5.0
"""Smallest error in sigmas that counts as systematic."""

BIAS_CAUSES: Mapping[Signal, tuple[str, ...]] = {
    "torque": ("torque-constant", "friction-law", "rotor"),
    "wrench": ("plate-errors", "encoder_delays"),
}
"""Likely causes of systematic errors, by method."""

RELATIVE_TOLERANCE = 1e-6
"""Relative error up to which a parameter counts as exact, however small sigma is."""


def correlation_diagnostics(estimate: Estimate) -> Iterator[Diagnostic]:
    """Yield a diagnostic of parameter pairs correlated above `MIN_CORRELATION`.

    The diagnostic lists the `MAX_PAIRS` largest correlations. Nothing is yielded if there is no
    such pair.

    Args:
        estimate: Estimate of one method.
    """
    scale = np.sqrt(np.maximum(np.diagonal(estimate.covariance), 1e-300))
    correlation = np.triu(estimate.covariance / np.outer(scale, scale), 1)
    pairs = np.argwhere(np.abs(correlation) > MIN_CORRELATION).tolist()
    pairs.sort(key=lambda pair: -abs(correlation[*pair]))
    descriptions = [
        f"{estimate.names[a]} and {estimate.names[b]} (correlation {correlation[a, b]:.2f})"
        for a, b in pairs
    ]
    omitted = len(pairs) - MAX_PAIRS
    if pairs:
        yield make_diagnostic(
            "estimate.correlated",
            f"the {estimate.method} estimate",
            correlation[*pairs[0]],
            method=estimate.method,
            pairs=", ".join(descriptions[:MAX_PAIRS])
            + (f" and {omitted} more pairs" if omitted > 0 else ""),
        )


def bias_diagnostics(estimate: Estimate, errors: Errors) -> Iterator[Diagnostic]:
    """Yield a diagnostic of errors larger than `Z_THRESHOLD` standard deviations.

    The diagnostic contains the parameter with the largest z and the number of other such
    parameters. Relative errors below `RELATIVE_TOLERANCE` are ignored. Nothing is yielded if there
    is no such error.

    Args:
        estimate: Estimate of one method.
        errors: Errors of the estimate against the truth.
    """
    error = np.abs(estimate.values - errors.truth)
    # for parameters without a scale of relative errors
    rounding = RELATIVE_TOLERANCE * np.abs(errors.truth).max(initial=0.0)
    exact = np.where(
        np.isnan(errors.relative),
        error < rounding,
        np.abs(errors.relative) < RELATIVE_TOLERANCE,
    )
    z = np.where(exact, 0.0, np.nan_to_num(np.abs(errors.z), posinf=np.inf))
    other_count = int((z > Z_THRESHOLD).sum()) - 1
    if other_count < 0:
        return
    worst_index = int(z.argmax())
    rest = (
        f" and of {count_with_noun(other_count, 'more parameter')}"
        if other_count
        else ""
    )
    yield make_diagnostic(
        "estimate.bias",
        f"the {estimate.method} estimate of {estimate.names[worst_index]}{rest}",
        float(z[worst_index]),
        method=estimate.method,
        causes=BIAS_CAUSES[estimate.method],
        limit=Z_THRESHOLD,
    )


@dataclass(frozen=True, eq=False, repr=False)
class Run(Diagnosed, Summarized):
    """Recording of a robot with its estimates, their scores and diagnostics.

    Attributes:
        name: Name of the run.
        tree: The robot, under the recording's gravity.
        recording: Measured signals; joint columns in the order of `tree.names`.
        estimates: Estimates by method; a failed method is absent.
        failures: Reason of failure by method.
        settings: Filters and other settings of the estimates.
        experiment: Simulated experiment; None for a recording of another source.
        score: Errors of the estimates against the truth; None without known truth.
        diagnostics: Warnings about robot, recording and estimates, in order.
        validation: Residuals of the estimates on another recording, by method; {} without
            validation.
        unseen: Recording of the validation; None without validation.
        drives: Torque constants and friction identified with the plate; None if not identified.
        consistent: Physically consistent bodies; None if not estimated.
        posterior: Estimates with the model file as prior, for an imported recording, by method; {}
            for other recordings.
        verdict: Reservations about the estimates, or one line of their prediction errors.
    """

    name: str
    tree: Tree
    recording: Recording
    estimates: Mapping[Signal, Estimate]
    failures: Mapping[Signal, str] = field(default_factory=dict)
    settings: Settings = field(default_factory=Settings)
    experiment: Experiment | None = None
    score: Score | None = None
    diagnostics: tuple[Diagnostic, ...] = ()
    validation: Mapping[Signal, Validation] = field(default_factory=dict)
    unseen: Recording | None = None
    drives: DriveIdentification | None = None
    consistent: Consistent | None = None
    posterior: Mapping[Signal, Posterior] = field(default_factory=dict)
    verdict: tuple[Diagnostic, ...] = ()

    @property
    def model(self) -> ModelFile | None:
        """Model file of the robot; None if the robot was not read from a file."""
        return self.tree.file if isinstance(self.tree.file, ModelFile) else None

    @property
    def summary(self) -> SummaryTable:
        """Table with the number of parameters of each estimate, the metrics, and the warnings."""
        counts = {
            self.instruments[m]: str(len(e.names)) for m, e in self.estimates.items()
        }
        figures = {name: f"{value:.4g}" for name, value in self.metrics.items()}
        warnings = tuple(f"warning: {line}" for line in sentences(self.diagnostics))
        return SummaryTable(
            f"run '{self.name}'", tuple((counts | figures).items()), warnings
        )

    def with_diagnostics(self, more: Iterable[Diagnostic]) -> Run:
        """Copy of the run with further diagnostics, all diagnostics sorted.

        Args:
            more: Additional diagnostics.
        """
        return replace(
            self, diagnostics=ordered_diagnostics([*self.diagnostics, *more])
        )

    def with_metrics(self, metrics: Mapping[str, float]) -> Run:
        """Copy of the run with further metrics; unchanged without known truth.

        Args:
            metrics: Additional metrics by name.
        """
        if self.score is None:
            return self
        score = replace(self.score, metrics={**self.score.metrics, **metrics})
        return replace(self, score=score)

    @property
    def instruments(self) -> dict[str, str]:
        """Names of the instruments by method, such as "force plate"."""
        return dict(METHOD_LABELS) | {
            m: each.instrument for m, each in self.estimates.items()
        }

    @property
    def truths(self) -> dict[str, float]:
        """True values by parameter name; {} without known truth."""
        return {} if self.score is None else self.score.truths

    @property
    def metrics(self) -> Mapping[str, float]:
        """Metrics by name (docs/experiments.md); {} without known truth."""
        return {} if self.score is None else self.score.metrics

    @property
    def verdicts(self) -> dict[str, bool]:
        """Verdict on each bound of [expect]: True if it holds, keyed by metric.

        The result is empty without an experiment. A bound on a metric that the run lacks is False.
        """
        if self.experiment is None:
            return {}
        return {
            name: name in self.metrics and bound.contains(self.metrics[name])
            for name, bound in self.experiment.expect.items()
        }

    @property
    def as_expected(self) -> bool:
        """True if every claim holds."""
        return all(self.verdicts.values())


def assemble_run(
    tree: Tree,
    recording: Recording,
    *,
    name: str,
    settings: Settings = DEFAULTS,
    experiment: Experiment | None = None,
    doubt: CalibrationCovariance | None = None,
    methods: Iterable[Signal] = SIGNALS,
    prior_error: float | None = None,
    bodies: tuple[PriorBodies, ConsistencyOptions] | None = None,
    threads: int | None = None,
    progress: Progress = ignore_progress,
) -> Run:
    """Identify by each available method, and score against the truth of an experiment.

    If one method fails, the run has the reason in `failures`, and the estimate of the other method.

    Args:
        tree: The robot.
        recording: Measured signals; its gravity, if given, replaces the tree's.
        name: Name of the run.
        settings: Filters and other settings of the estimates; default those of `Settings()`.
        experiment: Experiment that made the recording, so that `tree` is the true robot.
        doubt: Covariance of the plate's calibration with which the recording was corrected.
        methods: Methods to identify by: "wrench", "torque" or both.
        prior_error: Relative error assumed for the model file's bodies, as for `posterior`.
        bodies: Prior and options of consistent bodies; None to estimate none.
        threads: Number of threads; default one per processor.
        progress: Called with the number of finished samples and of all samples, for each method in
            turn.

    Raises:
        RecordingError: The recording is of another robot.
    """
    recording = adapt_to_robot(recording, tree).ordered(tree)
    tree = with_gear_shafts(with_recorded_gravity(tree, recording), recording)
    analysis = analyse(
        tree,
        recording,
        settings,
        methods=methods,
        doubt=doubt,
        prior_error=prior_error,
        bodies=bodies,
        threads=threads,
        progress=progress,
    )
    estimates, posteriors = analysis.estimates, analysis.posterior
    run = Run(
        name=name,
        tree=tree,
        recording=recording,
        estimates=estimates,
        failures={method: str(error) for method, error in analysis.failures.items()},
        settings=completed_by_estimates(settings, estimates.values()),
        experiment=experiment,
        score=_run_score(tree, recording, estimates, settings, experiment),
        consistent=analysis.bodies,
        posterior=posteriors,
        verdict=verdict_of(estimates.values(), posteriors.values()),
    )
    run = _with_new_diagnostics(run, _run_diagnostics(run, analysis.bodies_failure))
    return run if settings.drives == "off" else _with_drives(run, settings, progress)


def _run_score(
    tree: Tree,
    recording: Recording,
    estimates: Mapping[Signal, Estimate],
    settings: Settings,
    experiment: Experiment | None,
) -> Score | None:
    """Errors of estimates along the recording's motion; None without known truth."""
    if experiment is None:
        return None
    motion, samples = recorded_motion(recording, settings)
    torque = None if recording.torque is None else recording.torque[samples]
    plant = experiment.simulation
    return score(tree, estimates, settings.zeros, plant, motion, torque)


def _run_diagnostics(
    run: Run, bodies_failure: TestbedError | None
) -> Iterator[Diagnostic]:
    """Yield the diagnostics of a run.

    In order, these concern verdict, model, recording, estimates and consistent bodies. The verdict
    has diagnostics only if there are posteriors. A failed method has a diagnostic only if its
    signal was recorded, or if all methods failed.
    """
    if run.posterior:
        yield from (each for each in run.verdict if each.code != WELL_CODE)
    missing_estimates = [
        make_diagnostic(
            "estimate.missing", method, reason=reason, name=METHOD_LABELS[method]
        )
        for method, reason in run.failures.items()
        if not run.estimates or getattr(run.recording, method) is not None
    ]
    diagnostics = [*diagnostics_of_estimates(run.estimates.values())]
    for method, errors in ({} if run.score is None else run.score.errors).items():
        diagnostics += bias_diagnostics(run.estimates[method], errors)
    for estimate in run.estimates.values():
        diagnostics += correlation_diagnostics(estimate)
    if len(run.recording.segments) > 1:
        diagnostics.append(
            make_diagnostic("recording.longest", value=len(run.recording.segments))
        )
    recorded = run.recording.metadata.diagnostics
    all_diagnostics = ordered_diagnostics(
        [*missing_estimates, *run.tree.diagnostics, *recorded, *diagnostics]
    )
    yield from worded_for_sensor(all_diagnostics, robot_sensor_label(run.tree))
    if run.consistent is not None:
        yield from run.consistent.diagnostics
    if bodies_failure is not None:
        yield make_diagnostic("bodies.missing", reason=bodies_failure)


def _with_new_diagnostics(run: Run, diagnostics: Iterable[Diagnostic]) -> Run:
    """Copy of a run with further diagnostics appended, without duplicates."""
    unique = dict.fromkeys([*run.diagnostics, *diagnostics])
    return replace(run, diagnostics=tuple(unique))


def _with_drives(run: Run, settings: Settings, progress: Progress) -> Run:
    """Add the drives identified from the plate's estimate to a run.

    In an experiment, the metrics of the drives are added, too. A failure is not raised, but gives
    the diagnostic "drives.missing" with the reason.
    """
    try:
        if run.recording.torque is None or "wrench" not in run.estimates:
            raise SettingsError("that needs torques and the plate's estimate")
        drives = identify_drives(
            run.tree,
            run.recording,
            run.estimates["wrench"],
            settings=settings,
            choose=settings.drives == "chosen",
            progress=progress,
        )
    except TestbedError as error:
        return _with_new_diagnostics(
            run, [make_diagnostic("drives.missing", "the drives", reason=error)]
        )
    run = _with_new_diagnostics(replace(run, drives=drives), drives.diagnostics)
    if run.experiment is None:
        return run
    return run.with_metrics(
        drive_metrics(run.tree, run.experiment, run.recording, drives)
    )
