"""Campaign: a TOML file that varies an experiment by a full factorial design."""

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
from testbed.core.base.toml_text import Finite, read_toml, validate_tables
from testbed.core.parameters.rules import SIGNALS, Signal
from testbed.lab.experiment.experiment import Experiment
from testbed.lab.experiment.experiment_tables import RunName
from testbed.lab.experiment.robot_tables import StrictTable

MAX_SEED = 2**62
"""Upper bound on the seeds of runs."""

MAX_RUNS = 1_000_000
"""Largest number of runs in a campaign."""

DEFAULT_SETTINGS = ("identification.engine=compiled", "expect={}")
"""Settings of every run: the compiled kernel, no expected values of the experiment's file."""

Level: TypeAlias = int | float | str
"""Level of a factor: a number, or the name of a level."""


class LevelTable(StrictTable):
    """Named level of a factor, `[[factor.level]]`."""

    name: Annotated[str, Field(min_length=1, max_length=60)]
    """Name of the level in tables and pictures."""
    set: tuple[str, ...] = ()
    """Settings of the level: "key=value" as `--set` takes it."""


class FactorTable(StrictTable):
    """Factor of a campaign, `[[factor]]`: a list of values or a list of named levels."""

    name: Annotated[str, Field(pattern=r"^[^\n]+$", max_length=60)]
    """Name of the factor, with unit: its column in the table."""
    set: tuple[str, ...] = ()
    """Settings of a value: "key=value" as `--set` takes it, `$` for the value and `$*0.2` for
    multiples of it."""
    values: tuple[int | Finite | str, ...] = ()
    """Values of the factor, crossed with all other factors."""
    level: tuple[LevelTable, ...] = ()
    """Named levels, `[[factor.level]]`, crossed with all other factors."""

    @model_validator(mode="after")
    def _check_levels(self) -> FactorTable:
        """Raise ValueError unless the factor has either levels, or values with settings."""
        if not self.level and not (self.values and self.set):
            raise ValueError(f"factor '{self.name}' needs levels, or values with a set")
        if self.level and (self.values or self.set):
            raise ValueError(
                f"factor '{self.name}' has levels: no values and no set beside them"
            )
        return self

    def levels(self) -> list[tuple[Level, tuple[str, ...]]]:
        """Levels of the factor, each with its settings.

        Named levels have their own settings. For a list of values, the settings are those of the
        factor, with `$` replaced by the value.

        Raises:
            ExperimentError: A setting contains a multiple of a level that is not a number.
        """
        if self.level:
            return [(level.name, level.set) for level in self.level]
        return [
            (
                value,
                tuple(
                    self._substituted_setting(setting, value) for setting in self.set
                ),
            )
            for value in self.values
        ]

    def _substituted_setting(self, setting: str, level: Level) -> str:
        """Setting with `$` and its multiples replaced by a level.

        Args:
            setting: Setting with the placeholder `$` for the level, or `$*NUMBER` for a multiple of
                it.
            level: Level of the factor.

        Raises:
            ExperimentError: The setting contains a multiple of a level that is not a number.
        """

        def number(match: re.Match[str]) -> str:
            if isinstance(level, str):
                raise ExperimentError(
                    f"factor '{self.name}': '{level}' is no number, and {setting} requires one"
                )
            return repr(level * float(match[1]))

        multiples = re.sub(r"\$\*([-+]?\d[\d.]*(?:e[-+]?\d+)?)", number, setting)
        return multiples.replace("$", str(level))


class CampaignTables(StrictTable):
    """Content of a campaign's TOML file, checked for unknown keys."""

    name: RunName
    """Name of the campaign."""
    claim: str = ""
    """Conclusion of the campaign, in a sentence."""
    experiment: str
    """Experiment file, relative to this file; its expected values are ignored."""
    set: tuple[str, ...] = ()
    """Settings of all runs that differ from the experiment: "key = value" as `--set` takes it."""
    methods: Annotated[tuple[Signal, ...], Field(min_length=1)] = SIGNALS
    """Methods of identification that are applied."""
    replicates: Annotated[int, Field(ge=1, le=MAX_RUNS)] = 1
    """Number of runs of each cell, with different seeds; the seeds are the same in all cells."""
    seed: Annotated[int, Field(ge=0, lt=MAX_SEED)] = 1
    """Seed of the first replicate; the others follow consecutively."""
    factor: tuple[FactorTable, ...] = ()
    """Factors that are varied."""


@dataclass(frozen=True)
class Cell:
    """Cell of a factorial design: one combination of factor levels.

    Attributes:
        levels: Levels of all factors, in the order of the file.
        settings: Settings of these levels, in the format of `--set`.
    """

    levels: tuple[Level, ...]
    settings: tuple[str, ...]


@dataclass(frozen=True)
class Campaign:
    """Campaign: an experiment, the cells of a factorial design, and a number of replicates.

    Attributes:
        tables: Content of the campaign's file.
        experiment_file: Path of the experiment file.
        cells: Combinations of the factors' levels; the last factor varies fastest.
    """

    tables: CampaignTables
    experiment_file: Path
    cells: tuple[Cell, ...]

    @staticmethod
    def load(path: str | Path, settings: Iterable[str] = ()) -> Campaign:
        """Read a campaign's file, and check the experiment of every cell.

        Args:
            path: The TOML file.
            settings: Overrides of the experiment that apply to all runs.

        Raises:
            ExperimentError: A file cannot be read, or has an unknown key or an invalid value; two
                factors have the same name; or there are more than `MAX_RUNS` runs.
        """
        path = Path(path)
        tables = validate_tables(CampaignTables, read_toml(path, "campaign"), str(path))
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
        """Names of the factors."""
        return tuple(factor.name for factor in self.tables.factor)

    def settings(self, cell: int, replicate: int) -> tuple[str, ...]:
        """Settings of a run that differ from the experiment file, in the format of `--set`.

        They are, in this order, `DEFAULT_SETTINGS`, those of the campaign, those of the cell, and
        the seed of the replicate. Later settings override earlier ones.

        Args:
            cell: Index of the cell.
            replicate: Index of the replicate.
        """
        seed = f"seed={self.tables.seed + replicate}"
        return (*DEFAULT_SETTINGS, *self.tables.set, *self.cells[cell].settings, seed)

    def command(self, cell: int, replicate: int) -> str:
        """Command line that carries out a single run; arguments as for `settings`."""
        words = (
            f"--set {shlex.quote(word)}" for word in self.settings(cell, replicate)
        )
        return f"testbed run {shlex.quote(str(self.experiment_file))} {' '.join(words)}"

    def experiment(self, cell: int, replicate: int) -> Experiment:
        """Experiment of a run; arguments as for `settings`.

        Raises:
            ExperimentError: A setting has an unknown key or an invalid value.
        """
        return Experiment.from_toml(
            self.experiment_file, self.settings(cell, replicate)
        )
