"""A campaign: a TOML file that varies an experiment, as a frozen value, every key checked.

Levels of its factors are crossed and sampled: a cell is one combination of them.
"""

from __future__ import annotations

import copy
import re
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field, model_validator

from testbed.core.base.arrays import Array
from testbed.core.base.errors import ExperimentError, UnknownName
from testbed.core.base.toml_text import Finite, Positive, checked, read_toml
from testbed.core.estimation.estimate import METHODS, Method
from testbed.lab.experiment.experiment import Experiment
from testbed.lab.experiment.experiment_tables import METRICS, RunName
from testbed.lab.experiment.robot_tables import Table

LARGEST_SEED = 2**62
"""Seeds of runs are below this."""

MOST_RUNS = 10_000_000
"""Runs of one campaign."""

ENGINE = "identification.engine=compiled"
"""What every run of a campaign is sent first: workers live long enough to load the kernel."""

FactorName = Annotated[str, Field(pattern=r"^[^\n]+$", max_length=60)]


class LevelTable(Table):
    """One level of a factor that has names for levels."""

    name: Annotated[str, Field(min_length=1, max_length=60)]
    """What it is called in tables and pictures."""
    set: tuple[str, ...] = ()
    """What is different: "key=value" as `--set` takes it."""


class FactorTable(Table):
    """What is varied: all `values`, all levels of a list, or points of a range."""

    name: FactorName
    """Of its column in the table, with unit."""
    set: tuple[str, ...] = ()
    """What the level changes: "key=value" as `--set` takes it, `$` for the level and `$*0.2` for
    multiples of it."""
    values: tuple[int | Finite | str, ...] = ()
    """Every one of these, crossed with all other factors."""
    level: tuple[LevelTable, ...] = ()
    """Levels with names, `[[factor.level]]`, crossed likewise."""
    range: tuple[Finite, Finite] | None = None
    """Least and greatest level; `[sampling]` says how points are taken."""
    log: bool = False
    """Whether points of the range are even in its logarithm."""

    @model_validator(mode="after")
    def _one_kind(self) -> FactorTable:
        kinds = (self.values, self.level, self.range)
        if sum(bool(kind) for kind in kinds) != 1:
            raise ValueError(f"factor '{self.name}' needs one of values, level and range")
        if bool(self.level) == bool(self.set):
            raise ValueError(f"factor '{self.name}': levels with names have a set each, others one")
        if self.range and (self.range[0] >= self.range[1] or (self.log and self.range[0] <= 0)):
            raise ValueError(f"factor '{self.name}': the range is empty, or has no logarithm")
        return self


class SamplingTable(Table):
    """How points are taken from the ranges, together."""

    method: Literal["random", "latin_hypercube", "sobol"] = "sobol"
    """Independent points, one in each slice of every range, or a scrambled Sobol sequence."""
    points: Annotated[int, Field(ge=1, le=1_000_000)] = 64
    """How many."""
    seed: Annotated[int, Field(ge=0, lt=LARGEST_SEED)] = 0
    """Of the points."""


class StopTable(Table):
    """When a cell has enough replicates."""

    figure: str
    """One of the metrics of docs/experiments.md."""
    standard_error: Positive
    """Of its mean over the cell's replicates, below which no more are made."""
    round: Annotated[int, Field(ge=2, le=100_000)] = 10
    """Replicates that are made before the rule is looked at, each time."""

    @model_validator(mode="after")
    def _known(self) -> StopTable:
        if self.figure not in METRICS:
            raise ValueError(str(UnknownName("figure", self.figure, METRICS)))
        return self


class CampaignTables(Table):
    """What a campaign's file says."""

    name: RunName
    """Of the campaign."""
    claim: str = ""
    """What it shows, in a sentence."""
    experiment: str
    """Experiment file, relative to this one; its own claims do not count."""
    set: tuple[str, ...] = ()
    """What is different from it throughout: "key = value" as `--set` takes it."""
    methods: Annotated[tuple[Method, ...], Field(min_length=1)] = METHODS
    """Which estimates are made."""
    replicates: Annotated[int, Field(ge=1, le=1_000_000)] = 1
    """Runs of each cell, each with a seed of its own; with `[stop]` the most."""
    seed: Annotated[int, Field(ge=0, lt=LARGEST_SEED)] = 1
    """Of the first replicate; the others' follow."""
    common_seeds: bool = True
    """Whether the first replicates of all cells have one seed, and so on: cells then differ by
    their factors alone."""
    recordings: Literal["drop", "keep"] = "drop"
    """Whether the recordings are kept, a Parquet file each."""
    factor: tuple[FactorTable, ...] = ()
    """What is varied."""
    sampling: SamplingTable = SamplingTable()
    """How points are taken from ranges."""
    stop: StopTable | None = None
    """When a cell has enough replicates; without it all are made."""


@dataclass(frozen=True)
class Choice:
    """One level of one factor.

    Attributes:
        factor: Its number.
        level: A number, or a name.
        words: What it changes, as `--set` takes it.
    """

    factor: int
    level: float | str
    words: tuple[str, ...]


@dataclass(frozen=True)
class Cell:
    """One combination of levels.

    Attributes:
        levels: Of every factor, in the order of the file.
        words: What they change, as `--set` takes it.
    """

    levels: tuple[float | str, ...]
    words: tuple[str, ...]


class Place(NamedTuple):
    """Where a run stands in its campaign: numbers of its cell and of its replicate there."""

    cell: int
    replicate: int


@dataclass(frozen=True)
class Campaign:
    """An experiment, what is varied of it, and how often each is repeated.

    Attributes:
        tables: What the file says.
        base: The experiment's file.
        content: Its tables, unchecked.
        cells: Combinations of the factors' levels.
    """

    tables: CampaignTables
    base: Path
    content: Mapping[str, Any]
    cells: tuple[Cell, ...]

    @staticmethod
    def load(path: str | Path, settings: Iterable[str] = ()) -> Campaign:
        """Read a campaign's file, and the tables of its experiment.

        Args:
            path: The TOML file.
            settings: Overrides of the experiment, for all runs.

        Raises:
            ExperimentError: A file cannot be read, or says what is not understood.
        """
        path = Path(path)
        tables = checked(CampaignTables, read_toml(path, "campaign"), str(path))
        tables = tables.model_copy(update={"set": (*tables.set, *settings)})
        base = (path.parent / tables.experiment).resolve()
        names = [factor.name for factor in tables.factor]
        if len(set(names)) < len(names):
            raise ExperimentError(f"{path}: two factors have one name: {', '.join(names)}")
        cells = cells_of(_cross(tables), _sample(tables))
        if len(cells) * tables.replicates > MOST_RUNS:
            raise ExperimentError(
                f"{path}: {len(cells)} cells of {tables.replicates} replicates are more than "
                f"{MOST_RUNS:.0e} runs"
            )
        content = read_toml(base)
        content.pop("expect", None)
        campaign = Campaign(tables, base, content, cells)
        for cell in range(len(cells)):
            campaign.experiment(cell, 0)  # what is not understood is said before work is done
        return campaign

    @property
    def factors(self) -> tuple[str, ...]:
        """Names of what is varied."""
        return tuple(factor.name for factor in self.tables.factor)

    @property
    def runs(self) -> int:
        """How many there are at most."""
        return len(self.cells) * self.tables.replicates

    def words(self, cell: int, replicate: int) -> tuple[str, ...]:
        """What is different from the experiment's file in a run, as `--set` takes it.

        Args:
            cell: Its number.
            replicate: Its number.
        """
        seed = f"seed={self.seed(cell, replicate)}"
        return (ENGINE, *self.tables.set, *self.cells[cell].words, seed)

    def seed(self, cell: int, replicate: int) -> int:
        """The seed of a run.

        Args:
            cell: Its number.
            replicate: Its number.
        """
        own = 0 if self.tables.common_seeds else cell * self.tables.replicates
        return self.tables.seed + own + replicate

    def command(self, cell: int, replicate: int) -> str:
        """What carries a run out again, by itself.

        Args:
            cell: Its number.
            replicate: Its number.
        """
        words = (f"--set {shlex.quote(word)}" for word in self.words(cell, replicate))
        return f"testbed run {shlex.quote(str(self.base))} {' '.join(words)}"

    def experiment(self, cell: int, replicate: int) -> Experiment:
        """The experiment of a run.

        Args:
            cell: Its number.
            replicate: Its number.

        Raises:
            ExperimentError: Something is said that is not understood.
        """
        return experiment_of(self.content, self.base, self.words(cell, replicate))

    def rounds(self) -> Iterator[range]:
        """Replicates by rounds: after each the rule for stopping is looked at."""
        step = self.tables.replicates if self.tables.stop is None else self.tables.stop.round
        for first in range(0, self.tables.replicates, step):
            yield range(first, min(first + step, self.tables.replicates))


def experiment_of(content: Mapping[str, Any], base: Path, words: Iterable[str]) -> Experiment:
    """An experiment that differs by some words from the tables of a file.

    Args:
        content: The tables, unchecked; left as they are.
        base: The file.
        words: Overrides "table.key=value".

    Raises:
        ExperimentError: Something is said that is not understood.
    """
    return Experiment.of_content(copy.deepcopy(dict(content)), base, words)


def _cross(tables: CampaignTables) -> list[list[Choice]]:
    """Levels of the factors with values or names, in the order of the file."""
    found = []
    for number, factor in enumerate(tables.factor):
        if factor.level:
            found.append([Choice(number, each.name, each.set) for each in factor.level])
        elif factor.values:
            found.append([_choice(number, factor, value) for value in factor.values])
    return found


def _sample(tables: CampaignTables) -> list[list[Choice]]:
    """Points of all ranges together, each a level of every such factor."""
    ranges = [(k, factor) for k, factor in enumerate(tables.factor) if factor.range]
    if not ranges:
        return []
    asked = tables.sampling
    spans = [(*factor.range, factor.log) for _, factor in ranges if factor.range]
    points = sample(asked.method, spans, asked.points, asked.seed)
    return [
        [_choice(k, factor, level) for (k, factor), level in zip(ranges, point, strict=True)]
        for point in points.tolist()
    ]


def _choice(number: int, factor: FactorTable, level: float | str) -> Choice:
    """A level with the words that it stands for."""
    words = tuple(_filled(word, level, factor.name) for word in factor.set)
    return Choice(number, level, words)


def _filled(word: str, level: float | str, name: str) -> str:
    """A word with the level in the place of `$`."""

    def put(found: re.Match[str]) -> str:
        if found[1] is None:
            return str(level)
        if isinstance(level, str):
            raise ExperimentError(f"factor '{name}': '{level}' is no number, and {word} asks for")
        return repr(level * float(found[1]))

    return re.sub(r"\$(?:\*([-+]?\d[\d.]*(?:e[-+]?\d+)?))?", put, word)


def cells_of(
    crossed: Sequence[Sequence[Choice]], points: Sequence[Sequence[Choice]]
) -> tuple[Cell, ...]:
    """All combinations of the crossed factors, each with every point of the sampled ones.

    Args:
        crossed: Levels of each factor that has all of them.
        points: Levels of all sampled factors together, by point; [] for none.
    """
    found = []
    for chosen in product(*crossed):
        for point in points or [()]:
            every = sorted((*chosen, *point), key=lambda choice: choice.factor)
            words = tuple(word for choice in every for word in choice.words)
            found.append(Cell(tuple(choice.level for choice in every), words))
    return tuple(found)


def sample(
    method: str, spans: Sequence[tuple[float, float, bool]], points: int, seed: int
) -> Array:
    """Points in a box, (points, factors).

    Args:
        method: "random", "latin_hypercube" or "sobol".
        spans: Least and greatest level of each factor, and whether even in the logarithm.
        points: How many.
        seed: Of the points.
    """
    from scipy.stats import qmc

    rng = np.random.default_rng(seed)
    if method == "random":
        unit = rng.random((points, len(spans)))
    elif method == "latin_hypercube":
        unit = qmc.LatinHypercube(len(spans), rng=rng).random(points)
    else:
        power = max(points - 1, 0).bit_length()  # whole powers of two keep the balance
        unit = qmc.Sobol(len(spans), rng=rng).random_base2(power)[:points]
    found = np.empty_like(unit)
    for k, (low, high, log) in enumerate(spans):
        part = unit[:, k]
        found[:, k] = low * (high / low) ** part if log else low + (high - low) * part
    return found
