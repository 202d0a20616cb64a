"""A campaign: a TOML file that varies an experiment; the levels of its factors are crossed."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import product
from math import prod
from pathlib import Path
from typing import Annotated, TypeAlias

from pydantic import Field, model_validator

from testbed.core.base.errors import ExperimentError
from testbed.core.base.toml_text import Finite, checked, read_toml
from testbed.core.estimation.estimate import METHODS, Method
from testbed.lab.experiment.experiment import Experiment
from testbed.lab.experiment.experiment_tables import RunName
from testbed.lab.experiment.robot_tables import StrictTable

LARGEST_SEED = 2**62
"""Bound on the seeds of runs."""

MAX_RUNS = 1_000_000
"""Largest number of runs in a campaign."""

DEFAULTS = ("identification.engine=compiled", "expect={}")
"""Settings of every run: the compiled kernel, and no claims of the experiment's file."""

Level: TypeAlias = int | float | str
"""A number, or the name of a level."""


class LevelTable(StrictTable):
    """One level of a factor that has names for levels."""

    name: Annotated[str, Field(min_length=1, max_length=60)]
    """What it is called in tables and pictures."""
    set: tuple[str, ...] = ()
    """What is different: "key=value" as `--set` takes it."""


class FactorTable(StrictTable):
    """What is varied: all `values`, or all levels of a list."""

    name: Annotated[str, Field(pattern=r"^[^\n]+$", max_length=60)]
    """Of its column in the table, with unit."""
    set: tuple[str, ...] = ()
    """What a value changes: "key=value" as `--set` takes it, `$` for the value and `$*0.2` for
    multiples of it."""
    values: tuple[int | Finite | str, ...] = ()
    """Every one of these, crossed with all other factors."""
    level: tuple[LevelTable, ...] = ()
    """Levels with names, `[[factor.level]]`, crossed likewise."""

    @model_validator(mode="after")
    def _one_kind(self) -> FactorTable:
        if not self.level and not (self.values and self.set):
            raise ValueError(f"factor '{self.name}' needs levels, or values with a set")
        if self.level and (self.values or self.set):
            raise ValueError(
                f"factor '{self.name}' has levels: no values and no set beside them"
            )
        return self

    def levels(self) -> list[tuple[Level, tuple[str, ...]]]:
        """Levels with their settings.

        Raises:
            ExperimentError: A multiple is asked for of a level that is no number.
        """
        if self.level:
            return [(each.name, each.set) for each in self.level]
        return [
            (value, tuple(self._filled(word, value) for word in self.set))
            for value in self.values
        ]

    def _filled(self, setting: str, level: Level) -> str:
        """A setting with the level in the place of `$`."""

        def number(found: re.Match[str]) -> str:
            if isinstance(level, str):
                raise ExperimentError(
                    f"factor '{self.name}': '{level}' is no number, and {setting} asks for one"
                )
            return repr(level * float(found[1]))

        multiples = re.sub(r"\$\*([-+]?\d[\d.]*(?:e[-+]?\d+)?)", number, setting)
        return multiples.replace("$", str(level))


class CampaignTables(StrictTable):
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
    replicates: Annotated[int, Field(ge=1, le=MAX_RUNS)] = 1
    """Runs of each cell, each with a seed of its own; the same seeds in all cells."""
    seed: Annotated[int, Field(ge=0, lt=LARGEST_SEED)] = 1
    """Of the first replicate; the others' follow."""
    factor: tuple[FactorTable, ...] = ()
    """What is varied."""


@dataclass(frozen=True)
class Cell:
    """One combination of levels.

    Attributes:
        levels: Levels of all factors, in the order of the file.
        settings: Settings of the levels, as `--set` takes them.
    """

    levels: tuple[Level, ...]
    settings: tuple[str, ...]


@dataclass(frozen=True)
class Campaign:
    """An experiment, what is varied of it, and how often each is repeated.

    Attributes:
        tables: Content of the campaign's file.
        base: The experiment's file.
        cells: Combinations of the factors' levels.
    """

    tables: CampaignTables
    base: Path
    cells: tuple[Cell, ...]

    @staticmethod
    def load(path: str | Path, settings: Iterable[str] = ()) -> Campaign:
        """Read a campaign's file, and check the experiment of every cell.

        Args:
            path: The TOML file.
            settings: Overrides of the experiment, for all runs.

        Raises:
            ExperimentError: A file cannot be read, or says what is not understood.
        """
        path = Path(path)
        tables = checked(CampaignTables, read_toml(path, "campaign"), str(path))
        tables = tables.model_copy(update={"set": (*tables.set, *settings)})
        names = [factor.name for factor in tables.factor]
        if len(set(names)) < len(names):
            raise ExperimentError(
                f"{path}: two factors have one name: {', '.join(names)}"
            )
        factors = [factor.levels() for factor in tables.factor]
        if prod(map(len, factors)) * tables.replicates > MAX_RUNS:
            raise ExperimentError(f"{path}: more than {MAX_RUNS:.0e} runs")
        cells = []
        for combination in product(*factors):
            levels = tuple(level for level, _ in combination)
            cells.append(
                Cell(levels, tuple(word for _, words in combination for word in words))
            )
        campaign = Campaign(
            tables, (path.parent / tables.experiment).resolve(), tuple(cells)
        )
        for cell in range(len(cells)):
            campaign.experiment(cell, 0)
        return campaign

    @property
    def factors(self) -> tuple[str, ...]:
        """Names of what is varied."""
        return tuple(factor.name for factor in self.tables.factor)

    def settings(self, cell: int, replicate: int) -> tuple[str, ...]:
        """Settings of a run beyond the experiment's file, as `--set` takes them.

        Args:
            cell: Number of its cell.
            replicate: Number of its replicate.
        """
        seed = f"seed={self.tables.seed + replicate}"
        return (*DEFAULTS, *self.tables.set, *self.cells[cell].settings, seed)

    def command(self, cell: int, replicate: int) -> str:
        """Command line that carries out a run by itself; arguments as for `settings`."""
        words = (
            f"--set {shlex.quote(word)}" for word in self.settings(cell, replicate)
        )
        return f"testbed run {shlex.quote(str(self.base))} {' '.join(words)}"

    def experiment(self, cell: int, replicate: int) -> Experiment:
        """Experiment of a run; arguments as for `settings`.

        Raises:
            ExperimentError: Something is said that is not understood.
        """
        return Experiment.from_toml(self.base, self.settings(cell, replicate))
