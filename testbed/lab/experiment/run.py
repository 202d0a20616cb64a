"""A run: a recording of one robot, what was identified from it, how well, with what doubts."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from testbed.applications.analysis import analyse
from testbed.applications.drives.identify_drives import DriveFindings, identify_drives
from testbed.applications.validate import Validation, motion_in
from testbed.bodies.consistency.consistent import Consistent
from testbed.bodies.consistency.options import ConsistencyOptions
from testbed.bodies.posterior import Posterior
from testbed.bodies.prior import Prior
from testbed.bodies.verdict import WELL, verdict_of
from testbed.core.base.diagnostics import (
    Diagnosed,
    Diagnostic,
    diagnose,
    of_instrument,
    ordered,
    sentences,
)
from testbed.core.base.errors import RecordingError, SettingsError, TestbedError, plural
from testbed.core.base.stages import Progress, unreported
from testbed.core.base.summary_table import Summarized, SummaryTable
from testbed.core.dynamics.newton_euler import Motion
from testbed.core.estimation.diagnostics.torques import diagnostics_of
from testbed.core.estimation.estimate import (
    METHODS,
    NAMES,
    SIGNAL_OF,
    Estimate,
    Method,
    sensor_of,
)
from testbed.core.estimation.selection.chosen import with_chosen_settings
from testbed.core.estimation.sensor.correction import CalibrationCovariance
from testbed.core.estimation.settings import DEFAULTS, Settings
from testbed.core.recordings.geometry import in_its_gravity
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.source import longest_segment
from testbed.core.recordings.views import on_its_base, with_gear
from testbed.core.robot.model_file import ModelFile
from testbed.core.robot.tree import Tree
from testbed.lab.experiment.experiment import Experiment
from testbed.lab.experiment.score import Errors, Score, drive_metrics, score


def shown_motion(recording: Recording, settings: Settings) -> tuple[Motion, slice]:
    """A recording's motion, and the samples it covers; unfiltered where filters do not fit.

    Args:
        recording: Two samples or more.
        settings: Whose filter on positions to use.
    """
    try:
        return motion_in(recording, settings)
    except RecordingError:
        first, last = longest_segment(recording)
        shown = recording.part(first, last)
        speed = np.gradient(shown.position, 1 / shown.rate, axis=0)
        rates = speed, np.gradient(speed, 1 / shown.rate, axis=0)
        return Motion(shown.time, shown.position, *rates), slice(first, last)


CLOSE = 0.9
"""Correlation above which two parameters are named."""

MOST_PAIRS = 5
"""Pairs that are named."""

FAR = 5.0
"""Errors in sigmas that noise does not make."""

CAUSES: Mapping[Method, tuple[str, ...]] = {
    "internal": ("torque-constant", "friction-law", "rotor"),
    "external": ("plate-errors", "encoder_delays"),
}
"""Of errors that sigma does not count."""

EXACT = 1e-6
"""Relative error that is of no matter, however small sigma is."""


def correlated(estimate: Estimate) -> Iterator[Diagnostic]:
    """Parameters of large correlation, the largest first.

    Args:
        estimate: Of one method.
    """
    scale = np.sqrt(np.maximum(np.diagonal(estimate.covariance), 1e-300))
    correlation = np.triu(estimate.covariance / np.outer(scale, scale), 1)
    pairs = np.argwhere(np.abs(correlation) > CLOSE).tolist()
    pairs.sort(key=lambda pair: -abs(correlation[*pair]))
    named = [
        f"{estimate.names[a]} and {estimate.names[b]} (correlation {correlation[a, b]:.2f})"
        for a, b in pairs
    ]
    more = len(pairs) - MOST_PAIRS
    if pairs:
        yield diagnose(
            "estimate.correlated",
            f"the {estimate.method} estimate",
            correlation[*pairs[0]],
            method=estimate.method,
            pairs=", ".join(named[:MOST_PAIRS])
            + (f" and {more} more pairs" if more > 0 else ""),
        )


def systematic_errors(estimate: Estimate, errors: Errors) -> Iterator[Diagnostic]:
    """Errors that sigma does not explain.

    Args:
        estimate: Of one method.
        errors: Of its values.
    """
    gap = np.abs(estimate.values - errors.truth)
    # where nothing has a scale
    rounding = EXACT * np.abs(errors.truth).max(initial=0.0)
    exact = np.where(
        np.isnan(errors.relative), gap < rounding, np.abs(errors.relative) < EXACT
    )
    far = np.where(exact, 0.0, np.nan_to_num(np.abs(errors.z), posinf=np.inf))
    others = int((far > FAR).sum()) - 1
    if others < 0:
        return
    worst = int(far.argmax())
    more = f" and of {plural(others, 'more parameter')}" if others else ""
    yield diagnose(
        "estimate.bias",
        f"the {estimate.method} estimate of {estimate.names[worst]}{more}",
        float(far[worst]),
        method=estimate.method,
        causes=CAUSES[estimate.method],
        limit=FAR,
    )


@dataclass(frozen=True, eq=False, repr=False)
class Run(Diagnosed, Summarized):
    """One recording and what came of it.

    Attributes:
        name: Of the run.
        tree: The robot, under the recording's gravity.
        recording: What was measured; joint columns in the order of `tree.names`.
        estimates: By method; only those that could be made.
        failures: Why a method has no estimate, by method.
        settings: How the recording's signals were treated.
        experiment: What was carried out; None for a recording that no experiment made.
        score: The estimates against the truth; None where the truth is not known.
        diagnostics: What a careful reader should know, in order.
        validation: What the estimates leave of a motion that they have not seen, by method;
            {} where there is none.
        unseen: A recording of that motion; None for none.
        drives: What the plate says of the drives; None where it was not asked.
        consistent: Bodies that can exist; None where they were not asked for.
        posterior: What an imported recording adds to its model file, by method; {} of others.
        verdict: Reservations about the estimates, or one line of their prediction errors.
    """

    name: str
    tree: Tree
    recording: Recording
    estimates: Mapping[Method, Estimate]
    failures: Mapping[Method, str] = field(default_factory=dict)
    settings: Settings = field(default_factory=Settings)
    experiment: Experiment | None = None
    score: Score | None = None
    diagnostics: tuple[Diagnostic, ...] = ()
    validation: Mapping[Method, Validation] = field(default_factory=dict)
    unseen: Recording | None = None
    drives: DriveFindings | None = None
    consistent: Consistent | None = None
    posterior: Mapping[Method, Posterior] = field(default_factory=dict)
    verdict: tuple[Diagnostic, ...] = ()

    @property
    def model(self) -> ModelFile | None:
        """The model file, for its shapes; None if the robot came from no file."""
        return self.tree.file if isinstance(self.tree.file, ModelFile) else None

    @property
    def summary(self) -> SummaryTable:
        """Figures of merit, or how many parameters each estimate has."""
        counts = {
            self.instruments[m]: str(len(e.names)) for m, e in self.estimates.items()
        }
        figures = {name: f"{value:.4g}" for name, value in self.metrics.items()}
        warnings = tuple(f"warning: {line}" for line in sentences(self.diagnostics))
        return SummaryTable(
            f"run '{self.name}'", tuple((counts | figures).items()), warnings
        )

    def with_diagnostics(self, more: Iterable[Diagnostic]) -> Run:
        """The same with more diagnostics, put in order anew.

        Args:
            more: The diagnostics.
        """
        return replace(self, diagnostics=ordered([*self.diagnostics, *more]))

    def with_metrics(self, metrics: Mapping[str, float]) -> Run:
        """The same with more figures of merit; as it is where the truth is not known.

        Args:
            metrics: Figures by name.
        """
        if self.score is None:
            return self
        score = replace(self.score, metrics={**self.score.metrics, **metrics})
        return replace(self, score=score)

    @property
    def instruments(self) -> dict[str, str]:
        """By method, what it measures with."""
        return dict(NAMES) | {m: each.instrument for m, each in self.estimates.items()}

    @property
    def truths(self) -> dict[str, float]:
        """True values by parameter name; {} where they are not known."""
        return {} if self.score is None else self.score.truths

    @property
    def metrics(self) -> Mapping[str, float]:
        """Figures of merit by name (docs/experiments.md); {} where the truth is not known."""
        return {} if self.score is None else self.score.metrics

    @property
    def verdicts(self) -> dict[str, bool]:
        """For each metric in [expect], whether the claim holds; not if the run lacks the metric."""
        if self.experiment is None:
            return {}
        return {
            name: name in self.metrics and bound.holds(self.metrics[name])
            for name, bound in self.experiment.expect.items()
        }

    @property
    def as_expected(self) -> bool:
        """Whether every claim holds."""
        return all(self.verdicts.values())


def assemble_run(
    tree: Tree,
    recording: Recording,
    *,
    name: str,
    settings: Settings = DEFAULTS,
    experiment: Experiment | None = None,
    doubt: CalibrationCovariance | None = None,
    methods: Iterable[Method] = METHODS,
    prior_error: float | None = None,
    bodies: tuple[Prior, ConsistencyOptions] | None = None,
    threads: int | None = None,
    progress: Progress = unreported,
) -> Run:
    """Identify by every method that the recording's signals allow, and score where that is known.

    A method that fails does not take the other with it: the run says why it has none.

    Args:
        tree: The robot.
        recording: What was measured; its gravity, where it says so, goes before the tree's.
        name: Of the run.
        settings: How the signals are treated; default those of `Settings()`.
        experiment: What made the recording: the tree then holds the truth.
        doubt: About the plate by which the recording was corrected.
        methods: Which estimates to make.
        prior_error: Of the model file's bodies, as for `posterior`.
        bodies: Prior and conditions of consistent bodies; None for none.
        threads: How many to use; default one a processor.
        progress: Called with samples done and samples in all, method by method.

    Raises:
        RecordingError: The recording is of another robot.
    """
    recording = on_its_base(recording, tree).ordered(tree)
    tree = with_gear(in_its_gravity(tree, recording), recording)
    found = analyse(
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
    estimates, posteriors = found.estimates, found.posterior
    run = Run(
        name=name,
        tree=tree,
        recording=recording,
        estimates=estimates,
        failures={method: str(error) for method, error in found.failures.items()},
        settings=with_chosen_settings(settings, estimates.values()),
        experiment=experiment,
        score=_score(tree, recording, estimates, settings, experiment),
        consistent=found.bodies,
        posterior=posteriors,
        verdict=verdict_of(estimates.values(), posteriors.values()),
    )
    run = _with_unique(run, _diagnostics(run, found.bodies_failure))
    return run if settings.drives == "off" else _with_drives(run, settings, progress)


def _score(
    tree: Tree,
    recording: Recording,
    estimates: Mapping[Method, Estimate],
    settings: Settings,
    experiment: Experiment | None,
) -> Score | None:
    """Score of estimates along the recording's motion; None where the truth is not known."""
    if experiment is None:
        return None
    motion, inner = shown_motion(recording, settings)
    torque = None if recording.torque is None else recording.torque[inner]
    plant = experiment.simulation
    return score(tree, estimates, settings.zeros, plant, motion, torque)


def _diagnostics(run: Run, bodies_failure: TestbedError | None) -> Iterator[Diagnostic]:
    """What to know of the answer, the model, the recording, the estimates and the bodies."""
    if run.posterior:
        yield from (each for each in run.verdict if each.code != WELL)
    missing = [
        diagnose("estimate.missing", method, reason=reason, name=NAMES[method])
        for method, reason in run.failures.items()
        if not run.estimates or getattr(run.recording, SIGNAL_OF[method]) is not None
    ]
    found = [*diagnostics_of(run.estimates.values())]
    for method, errors in ({} if run.score is None else run.score.errors).items():
        found += systematic_errors(run.estimates[method], errors)
    for estimate in run.estimates.values():
        found += correlated(estimate)
    if len(run.recording.segments) > 1:
        found.append(diagnose("recording.longest", value=len(run.recording.segments)))
    known = run.recording.metadata.diagnostics
    every = ordered([*missing, *run.tree.diagnostics, *known, *found])
    yield from of_instrument(every, sensor_of(run.tree))
    if run.consistent is not None:
        yield from run.consistent.diagnostics
    if bodies_failure is not None:
        yield diagnose("bodies.missing", reason=bodies_failure)


def _with_unique(run: Run, diagnostics: Iterable[Diagnostic]) -> Run:
    """A run with more diagnostics behind its own, none twice."""
    every = dict.fromkeys([*run.diagnostics, *diagnostics])
    return replace(run, diagnostics=tuple(every))


def _with_drives(run: Run, settings: Settings, progress: Progress) -> Run:
    """A run with what the plate says of the drives, and what to know of it."""
    try:
        if run.recording.torque is None or "external" not in run.estimates:
            raise SettingsError("that needs torques and the plate's estimate")
        drives = identify_drives(
            run.tree,
            run.recording,
            run.estimates["external"],
            settings=settings,
            choose=settings.drives == "chosen",
            progress=progress,
        )
    except TestbedError as error:
        return _with_unique(
            run, [diagnose("drives.missing", "the drives", reason=error)]
        )
    run = _with_unique(replace(run, drives=drives), drives.diagnostics)
    if run.experiment is None:
        return run
    return run.with_metrics(
        drive_metrics(run.tree, run.experiment, run.recording, drives)
    )
