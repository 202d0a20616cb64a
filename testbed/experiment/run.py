"""A run: one recording of one robot, what was identified from it, and how well.

The value that terminal, report and viewer take, whether a simulation made the recording or
somebody's own instruments.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from testbed.diagnostics.diagnostic import Diagnosed, Diagnostic, diagnose, ordered
from testbed.errors import RecordingError, TestbedError, UnseenParameters
from testbed.experiment.drive_score import drive_metrics
from testbed.experiment.experiment import Experiment
from testbed.experiment.run_diagnostics import diagnostics_of_run
from testbed.experiment.score import Score, score
from testbed.experiment.shown_motion import shown_motion
from testbed.identification.consistency.consistent import Consistent
from testbed.identification.drives.identify_drives import DriveFindings, identify_drives
from testbed.identification.estimate import METHODS, Estimate, Method
from testbed.identification.identify import identify
from testbed.identification.regression.passes import Progress
from testbed.identification.selection.term_choice import with_chosen_terms
from testbed.identification.sensor.calibration_covariance import CalibrationCovariance
from testbed.identification.settings import Settings
from testbed.identification.validate import Validation
from testbed.recordings.coupled_gear import with_gear
from testbed.recordings.geometry import in_its_gravity
from testbed.recordings.recording import Recording
from testbed.robot.model_file import ModelFile
from testbed.robot.tree import Tree


@dataclass(frozen=True, eq=False)
class Run(Diagnosed):
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
        model: The model file, for its shapes; None if the robot came from no file.
        diagnostics: What a careful reader should know, in order.
        validation: What the estimates leave of a motion that they have not seen, by method;
            {} where there is none.
        unseen: A recording of that motion; None for none.
        drives: What the plate says of the drives; None where it was not asked.
        consistent: Bodies that can exist; None where they were not asked for.
    """

    name: str
    tree: Tree
    recording: Recording
    estimates: Mapping[Method, Estimate]
    failures: Mapping[Method, str] = field(default_factory=dict)
    settings: Settings = field(default_factory=Settings)
    experiment: Experiment | None = None
    score: Score | None = None
    model: ModelFile | None = None
    diagnostics: tuple[Diagnostic, ...] = ()
    validation: Mapping[Method, Validation] = field(default_factory=dict)
    unseen: Recording | None = None
    drives: DriveFindings | None = None
    consistent: Consistent | None = None

    def with_diagnostics(self, more: Iterable[Diagnostic]) -> Run:
        """The same with more diagnostics, put in order anew.

        Args:
            more: The diagnostics.
        """
        return replace(self, diagnostics=ordered([*self.diagnostics, *more]))

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
    settings: Settings | None = None,
    experiment: Experiment | None = None,
    model: ModelFile | None = None,
    doubt: CalibrationCovariance | None = None,
    methods: Iterable[Method] = METHODS,
    threads: int | None = None,
    progress: Progress = lambda done, total: None,
) -> Run:
    """Identify by every method that the recording's signals allow, and score where that is known.

    A method that fails does not take the other with it: the run says why it has none.

    Args:
        tree: The robot.
        recording: What was measured; its gravity, where it says so, goes before the tree's.
        name: Of the run.
        settings: How the signals are treated; default `Settings()`.
        experiment: What made the recording: the tree then holds the truth.
        model: The model file, for its shapes.
        doubt: About the plate by which the recording was corrected.
        methods: Which estimates to make.
        threads: How many to use; default one a processor.
        progress: Called with samples done and samples in all, method by method.

    Raises:
        RecordingError: The recording is of another robot.
    """
    recording = recording.ordered(tree)
    tree = with_gear(in_its_gravity(tree, recording), recording)
    settings = settings or Settings()
    estimates: dict[Method, Estimate] = {}
    failures: dict[Method, str] = {}
    for method in methods:
        if tree.floating and method == "internal":
            continue  # nothing is missing: joint torques are none of the ground's
        try:
            estimates[method] = identify(
                tree,
                recording,
                method,
                settings=settings,
                doubt=doubt,
                threads=threads,
                progress=progress,
            )
        except (RecordingError, UnseenParameters) as error:
            failures[method] = str(error)
    judged = None
    if experiment is not None:
        motion, inner = shown_motion(recording, settings)
        torque = None if recording.torque is None else recording.torque[inner]
        friction = experiment.simulation.friction
        judged = score(tree, estimates, settings.zeros, friction, motion, torque)
    errors = {} if judged is None else judged.errors
    known = diagnostics_of_run(tree, recording, estimates, failures, errors)
    drives, more = _drives(tree, recording, estimates, settings, progress)
    if judged is not None and drives is not None and experiment is not None:
        metrics = drive_metrics(tree, experiment, recording, drives)
        judged = replace(judged, metrics={**judged.metrics, **metrics})
    return Run(
        name=name,
        tree=tree,
        recording=recording,
        estimates=estimates,
        failures=failures,
        settings=with_chosen_terms(settings, estimates.values()),
        experiment=experiment,
        score=judged,
        model=model,
        diagnostics=(*known, *more),
        drives=drives,
    )


def _drives(
    tree: Tree,
    recording: Recording,
    estimates: Mapping[Method, Estimate],
    settings: Settings,
    progress: Progress,
) -> tuple[DriveFindings | None, tuple[Diagnostic, ...]]:
    """What the plate says of the drives where that is asked, and what to know of it."""
    if settings.drives == "off":
        return None, ()
    if recording.torque is None or "external" not in estimates:
        reason = "that needs torques and the plate's estimate"
        return None, (diagnose("drives.missing", "the drives", reason=reason),)
    choose = settings.drives == "chosen"
    try:
        found = identify_drives(
            tree,
            recording,
            estimates["external"],
            settings=settings,
            choose=choose,
            progress=progress,
        )
    except TestbedError as error:
        return None, (diagnose("drives.missing", "the drives", reason=error),)
    return found, found.diagnostics
