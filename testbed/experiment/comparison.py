"""A comparison: one simulated motion, measured and identified in several ways.

A TOML file names an experiment and lists variants of its instrument or its identification,
each with what is expected of it, and with a remedy if there is one.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from testbed.arrays import Array
from testbed.codec import encode
from testbed.diagnostics import messages, ordered
from testbed.dynamics.newton_euler import Motion
from testbed.errors import ExperimentError, UnknownName
from testbed.experiment.evaluate import evaluate
from testbed.experiment.experiment import Experiment
from testbed.experiment.experiment_tables import Expectations, VariedTables
from testbed.experiment.robot_tables import Table
from testbed.experiment.run import Run, shown_motion
from testbed.experiment.simulate import simulate
from testbed.identification.estimate import Estimate, Method
from testbed.identification.estimate_summary import corrected_by, summary_of
from testbed.identification.regression.passes import Progress
from testbed.identification.regression.windows import row_weights
from testbed.identification.validate import friction, predictions
from testbed.instruments.chain import measured_again
from testbed.recordings.columns import AXES, PLATE_UNITS
from testbed.recordings.recording import Recording
from testbed.toml_text import checked, read_toml

PLAIN = "as it is"
"""The experiment itself among its variants."""


class VariantTable(Table):
    """One way in which the experiment is measured and identified."""

    name: Annotated[str, Field(min_length=1, max_length=100)]
    """What it is called in the table."""
    set: tuple[str, ...] = ()
    """What is different: "key = value" as `--set` takes it."""
    remedy: tuple[str, ...] = ()
    """What is done about it, besides: also such words."""
    says: str | None = None
    """Code of the first diagnostic that the experiment itself does not have; "" for none."""
    expect: Expectations = Field(default_factory=dict)
    """Bounds on metrics."""
    remedied: Expectations = Field(default_factory=dict)
    """Bounds on metrics once the remedy is applied."""


class ComparisonTables(VariedTables):
    """What a comparison's file says."""

    expect: Expectations = Field(default_factory=dict)
    """Bounds on the experiment's own metrics."""
    variant: Annotated[tuple[VariantTable, ...], Field(min_length=1)]
    """The variants."""


@dataclass(frozen=True)
class Variant:
    """One line of a comparison.

    Attributes:
        name: Of the variant.
        experiment: Its settings, and what is expected.
        remedied: The same with the remedy; None if there is none.
        says: Code of the first diagnostic; "" for none; None where nothing is claimed.
    """

    name: str
    experiment: Experiment
    remedied: Experiment | None = None
    says: str | None = None


@dataclass(frozen=True)
class Comparison:
    """Variants of an experiment that share one motion.

    Attributes:
        name: Of the comparison.
        claim: What it shows.
        methods: Which estimates are made.
        variants: The experiment itself, then its variants.
    """

    name: str
    claim: str
    methods: tuple[Method, ...]
    variants: tuple[Variant, ...]

    @staticmethod
    def load(path: str | Path, settings: Iterable[str] = ()) -> Comparison:
        """Read a comparison's file and its experiment.

        Args:
            path: The TOML file.
            settings: Overrides of the experiment, for all variants.

        Raises:
            ExperimentError: A file cannot be read, says what is not understood, or a variant
                would need another simulation.
        """
        path = Path(path)
        tables = checked(ComparisonTables, read_toml(path, "comparison"), str(path))
        throughout = [*tables.set, *settings]

        def made(words: Sequence[str], expect: Expectations) -> Experiment:
            found = Experiment.load(path.parent / tables.experiment, [*throughout, *words])
            return found.model_copy(update={"expect": expect})

        base = made([], tables.expect)
        variants = [Variant(PLAIN, base)]
        for each in tables.variant:
            corrected = made([*each.set, *each.remedy], each.remedied) if each.remedy else None
            if each.remedied and corrected is None:
                raise ExperimentError(f"{path}: variant '{each.name}' expects what no remedy does")
            if each.says and each.says not in messages():
                raise UnknownName("diagnostic", each.says, messages())
            variant = Variant(each.name, made(each.set, each.expect), corrected, each.says)
            for experiment in filter(None, (variant.experiment, corrected)):
                _check_shared(base, experiment, f"{path}: variant '{each.name}'")
            variants.append(variant)
        return Comparison(tables.name, tables.claim, tables.methods, tuple(variants))


def _check_shared(base: Experiment, other: Experiment, who: str) -> None:
    """Whether both can share one motion.

    Raises:
        ExperimentError: They cannot.
    """
    free = ("expect", "measurement", "identification")
    keys = [k for k, value in base if k not in free and getattr(other, k) != value]
    for key in ("rate", "averaged"):
        if getattr(base.measurement, key) != getattr(other.measurement, key):
            keys.append(f"measurement.{key}")
    if keys:
        raise ExperimentError(
            f"{who} changes {', '.join(keys)}: all variants share one motion and one clock, so "
            "that they may change only identification and the rest of measurement"
        )


@dataclass(frozen=True, eq=False)
class Compared:
    """What came of one variant.

    Attributes:
        variant: The variant.
        run: Its run.
        remedied: The run with the remedy; None if there is none.
        said: Codes of the estimates' diagnostics that the experiment itself does not have.
    """

    variant: Variant
    run: Run
    remedied: Run | None
    said: tuple[str, ...]

    @property
    def named(self) -> bool | None:
        """Whether what is said first is what should be; None where nothing is claimed."""
        wanted = self.variant.says
        if wanted is None:
            return None
        return self.said[:1] == ((wanted,) if wanted else ())

    @property
    def as_expected(self) -> bool:
        """Whether every claim holds."""
        runs = [self.run, *([] if self.remedied is None else [self.remedied])]
        return self.named is not False and all(run.as_expected for run in runs)


def compare(
    comparison: Comparison, progress: Progress = lambda done, total: None
) -> Iterator[Compared]:
    """Simulate once; measure, identify and judge every variant.

    Args:
        comparison: What to compare.
        progress: Of the simulation: called with samples done and samples in all.
    """
    base = comparison.variants[0].experiment
    exact = replace(base.measurement, fault=())  # a tare that is measured is no exact one
    recording = simulate(base.model_copy(update={"measurement": exact}), progress)

    def carried_out(experiment: Experiment) -> Run:
        seen = measured_again(recording, experiment.measurement, experiment.seed)
        return evaluate(experiment, seen, methods=comparison.methods)

    usual: tuple[str, ...] = ()
    for variant in comparison.variants:
        run = carried_out(variant.experiment)
        corrected = None if variant.remedied is None else carried_out(variant.remedied)
        said = tuple(codes_of(run.estimates.values()))
        yield Compared(variant, run, corrected, tuple(code for code in said if code not in usual))
        if variant.name == PLAIN:
            usual = said


def codes_of(estimates: Iterable[Estimate]) -> Iterator[str]:
    """Codes of diagnostics in their order, none twice, without those that follow from others.

    Args:
        estimates: Of one recording.
    """
    every = ordered(each for estimate in estimates for each in estimate.diagnostics)
    yield from dict.fromkeys(each.code for each in every if not each.follows)


def comparison_as_json(comparison: Comparison, rows: Sequence[Compared]) -> dict[str, Any]:
    """A comparison as JSON takes it.

    Args:
        comparison: What was compared.
        rows: What came of it.
    """
    return {
        "name": comparison.name,
        "claim": comparison.claim,
        "variants": [_row(row) for row in rows],
        "as_expected": all(row.as_expected for row in rows),
    }


def _row(row: Compared) -> dict[str, Any]:
    return {
        "name": row.variant.name,
        **_judged(row.run),
        "said": list(row.said),
        "says": row.variant.says,
        "named": row.named,
        "remedied": None if row.remedied is None else _judged(row.remedied),
        "as_expected": row.as_expected,
    }


def _judged(run: Run) -> dict[str, Any]:
    estimates = run.estimates
    return {
        "metrics": dict(run.metrics),
        "verdicts": run.verdicts,
        "failures": dict(run.failures),
        "nuisances": {m: [encode(n) for n in e.nuisances] for m, e in estimates.items()},
        "diagnostics": {m: [encode(d) for d in e.diagnostics] for m, e in estimates.items()},
    }


@dataclass(frozen=True, eq=False)
class Signal:
    """One kind of measurement and what the estimates say of it.

    Attributes:
        kind: "wrench" or "torque".
        channels: Names, (k,).
        units: One a channel.
        measured: (M, k) [N, N m].
        predicted: By method, (M, k). The wrench contains the pedestal's; joint torques of the
            external estimate lack friction.
    """

    kind: Literal["wrench", "torque"]
    channels: tuple[str, ...]
    units: tuple[str, ...]
    measured: Array
    predicted: Mapping[Method, Array]

    def residual(self, method: Method) -> Array:
        """Measured less predicted, (M, k)."""
        return self.measured - self.predicted[method]


@dataclass(frozen=True, eq=False)
class Predictions:
    """A recording beside what a run's estimates say of it.

    Attributes:
        run: Whose estimates.
        recording: Of the run, or another of the same robot; joints in the tree's order.
        motion: What the recording shows, without the ends that filters take, M samples.
        signals: What was measured: the wrench, the joint torques, or both.
        unseen: Whether the recording is another one.
    """

    run: Run
    recording: Recording
    motion: Motion
    signals: tuple[Signal, ...]
    unseen: bool = False

    @cached_property
    def unexplained_torque(self) -> Array | None:
        """Motor torque less what the robot needs by the plate's estimate, (M, n) [N m or N].

        Friction, and what the drives report wrongly. None without torques or that estimate.
        """
        for signal in self.signals:
            if signal.kind == "torque" and "external" in signal.predicted:
                return signal.residual("external")
        return None

    def smoothed(self, cutoff: float) -> Predictions:
        """Through one low-pass, without the ends it takes; as it is where it is too short for it.

        Args:
            cutoff: Where the low-pass has a gain of one half [Hz].
        """
        weights = row_weights(self.recording.rate, cutoff)
        reach = len(weights) // 2
        if self.motion.samples <= 2 * len(weights):
            return self

        def passed(values: Array) -> Array:
            return np.column_stack([np.convolve(each, weights, "valid") for each in values.T])

        signals = [
            replace(
                signal,
                measured=passed(signal.measured),
                predicted={method: passed(each) for method, each in signal.predicted.items()},
            )
            for signal in self.signals
        ]
        inner = slice(reach, self.motion.samples - reach)
        return replace(self, motion=self.motion[inner], signals=tuple(signals))

    def friction(self, speed: Array) -> Array | None:
        """Friction of the internal estimate at speeds, (k, n) [N m or N]; None without it.

        Args:
            speed: Joint velocities, (k, n) [rad/s or m/s].
        """
        internal = self.run.estimates.get("internal")
        return None if internal is None else friction(speed, internal)


def _without_faults(run: Run, recording: Recording) -> Recording:
    """The recording, faults that an estimate of the run has found taken back."""
    external = run.estimates.get("external")
    if external is None or not external.nuisances:
        return recording
    corrected = corrected_by(recording, run.tree, summary_of(external))
    return corrected.part(0, corrected.samples)


def predict(run: Run, recording: Recording | None = None) -> Predictions:
    """What a run's estimates say of a recording.

    Args:
        run: The run.
        recording: Of the same robot; default the run's own.

    Raises:
        RecordingError: The recording is of another robot.
    """
    tree, unseen = run.tree, recording is not None
    recording = run.recording if recording is None else recording.ordered(tree)
    recording = _without_faults(run, recording)
    motion, inner = shown_motion(recording, run.settings)
    wrench, torque = predictions(tree, recording, motion, run.estimates)
    signals = []
    if recording.wrench is not None:
        signals.append(Signal("wrench", AXES, PLATE_UNITS, recording.wrench[inner], wrench))
    if recording.torque is not None:
        units = tuple("N m" if joint.revolute else "N" for joint in tree.joints)
        signals.append(Signal("torque", tree.names, units, recording.torque[inner], torque))
    return Predictions(run, recording, motion, tuple(signals), unseen)
