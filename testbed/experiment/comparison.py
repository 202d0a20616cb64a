"""A comparison: one simulated motion, measured and identified in several ways.

A TOML file names an experiment and lists variants of its instrument or its identification,
each with what is expected of it, and with a remedy if there is one.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from testbed.codec import encode
from testbed.diagnostics.diagnostic import messages, ordered
from testbed.errors import ExperimentError, UnknownName
from testbed.experiment.evaluate import evaluate
from testbed.experiment.experiment import Experiment
from testbed.experiment.experiment_tables import Expectations, Table, VariedTables
from testbed.experiment.run import Run
from testbed.experiment.simulate import simulate
from testbed.identification.estimate import Estimate, Method
from testbed.identification.regression.passes import Progress
from testbed.instruments.chain import measured_again
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
        tables = checked(ComparisonTables, read_toml(path), str(path))
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
