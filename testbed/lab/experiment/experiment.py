"""An experiment: a TOML file as a frozen value, every key checked.

SI units, radians, joint side; tables keyed by joint name. A key that is not known is an
error that lists the known ones.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any

import tomli_w
from pydantic import BeforeValidator, Field

from testbed.bodies.consistency.options import ConsistencyOptions
from testbed.core.base.diagnostics import Diagnostic
from testbed.core.base.errors import ExperimentError
from testbed.core.base.summary_table import Summarized, SummaryTable
from testbed.core.base.toml_text import Finite, checked, override, read_toml
from testbed.core.estimation.settings import Settings
from testbed.core.robot.gravity import gravity_of
from testbed.core.robot.model_file import ModelFile, mimic_joints, nearest_bodies
from testbed.lab.experiment.experiment_tables import (
    ExcitationTable,
    Expectations,
    MotionTable,
    PriorTable,
    RunName,
    SimulationTable,
)
from testbed.lab.experiment.robot_tables import BodyTable, RobotTables, SensorTable
from testbed.lab.experiment.sensors import ForcePlate
from testbed.lab.instruments.chain import Instrument


class Experiment(Summarized, RobotTables):
    """Everything that determines a run, as an experiment file says it."""

    name: RunName
    """Of the run folder: letters, digits, dot, dash, underscore."""
    claim: str = ""
    """What the experiment shows, in a sentence."""
    model: str
    """Model file, MJCF or URDF, relative to the experiment file."""
    seed: Annotated[int, Field(ge=0, lt=2**128)] = 0
    """Of the motion and of all noise."""
    gravity: (
        Annotated[
            list[Finite],
            Field(min_length=3, max_length=3),
            BeforeValidator(gravity_of),
        ]
        | None
    ) = None
    """(gx, gy, gz) [m/s^2], bedplate frame, or how it is mounted: "level", "ceiling", "wall +x",
    "wall -x", "wall +y", "wall -y", "none"; default the model file's."""
    weld_root: bool = False
    """Weld a floating root to the bedplate."""
    motion: MotionTable = MotionTable()
    excitation: ExcitationTable = ExcitationTable()
    simulation: SimulationTable = SimulationTable()
    measurement: Instrument = Instrument()
    identification: Settings = Settings()
    consistent: ConsistencyOptions | None = None
    """What is asked of physically consistent bodies; without the table none are made."""
    prior: PriorTable = PriorTable()
    expect: Expectations = Field(default_factory=dict)
    """Bounds on metrics: the claim."""

    @property
    def summary(self) -> SummaryTable:
        """Tables and keys that are not at their defaults."""
        said = self.model_dump(mode="json", exclude_defaults=True, exclude_none=True)
        rows = tuple((name, repr(value)) for name, value in said.items())
        return SummaryTable(f"experiment {self.name}", rows)

    @staticmethod
    def from_toml(path: str | Path, settings: Iterable[str] = ()) -> Experiment:
        """Read an experiment file.

        Args:
            path: The TOML file; `model` is taken relative to it.
            settings: Overrides "table.key=value", the value in TOML or a bare word.

        Raises:
            ExperimentError: The file cannot be read, or says what is not understood.
        """
        path = Path(path)
        return Experiment.of_content(read_toml(path), path, settings)

    def with_(self, **changes: Any) -> Experiment:
        """The same with some values changed.

        Args:
            **changes: By table or key; of a table a dict of those of its keys that change.

        Raises:
            ExperimentError: Something is said that is not understood.
        """
        said = self.model_dump(mode="json", exclude_none=True)
        return checked(Experiment, _merged(said, changes), "with_")

    @staticmethod
    def of_content(
        content: dict[str, Any], path: Path, settings: Iterable[str] = ()
    ) -> Experiment:
        """From the tables of an experiment file that has been read.

        Args:
            content: Its tables, unchecked; overrides are put in.
            path: The file; `model` is taken relative to it.
            settings: Overrides "table.key=value".

        Raises:
            ExperimentError: Something is said that is not understood.
        """
        override(content, settings)
        found = checked(Experiment, content, str(path))
        if "\0" in found.model + found.motion.file:
            raise ExperimentError(f"{path}: model or motion.file is not a file name")
        changed: dict[str, Any] = {"model": str((path.parent / found.model).resolve())}
        if found.motion.file:
            file = str((path.parent / found.motion.file).resolve())
            changed["motion"] = found.motion.model_copy(update={"file": file})
        return found.model_copy(update=changed)

    @staticmethod
    def of_model(path: Path, settings: Iterable[str] = ()) -> Experiment:
        """An experiment that says only which model, and the words of --set.

        Args:
            path: The model file.
            settings: Overrides "table.key=value".

        Raises:
            ExperimentError: A word says what is not understood.
        """
        content: dict[str, Any] = {"name": run_name(path), "model": str(path.resolve())}
        override(content, settings)
        return checked(Experiment, content, "--set")

    def as_toml(self) -> str:
        """The experiment with every default written out."""
        return tomli_w.dumps(self.model_dump(mode="json", exclude_none=True))

    @property
    def file(self) -> ModelFile:
        """The model file, and how it is read."""
        mimic = mimic_joints(self.model) if self.robot.lock_mimic else ()
        held = dict.fromkeys(mimic) | self.robot.lock
        return ModelFile(Path(self.model), self.weld_root, self.robot.bodies, held)

    def with_nearest_bodies(self) -> tuple[Experiment, tuple[Diagnostic, ...]]:
        """The same with the nearest bodies in place of those that cannot be; what to say of it."""
        file = self.file
        found = nearest_bodies(file.path, weld_root=file.weld_root, lock=file.lock)
        tables = {name: BodyTable.of(body) for name, body in found.bodies.items()}
        repair = {"repair": tables | self.robot.repair}
        robot = self.robot.model_copy(update=repair)
        return self.model_copy(update={"robot": robot}), found.diagnostics

    @property
    def mounted_sensors(self) -> list[ForcePlate]:
        """The robot's force sensors, each with its errors."""
        found = []
        for name, mounting in self.force_sensors.items():
            table = self.sensors.get(name, SensorTable())
            noise = table.force_noise, table.moment_noise
            found.append(
                ForcePlate(noise, table.fault, table.full_scale, table.plate, mounting)
            )
        return found

    @property
    def sensor_instruments(self) -> dict[str, Instrument]:
        """Noise and range of the robot's force sensors by name."""
        named = zip(self.force_sensors, self.mounted_sensors, strict=True)
        return {name: Instrument(**plate.settings) for name, plate in named}


def _merged(table: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """A table with some keys changed, tables in it likewise."""
    found = dict(table)
    for key, value in changes.items():
        old = found.get(key)
        both = isinstance(value, Mapping) and isinstance(old, Mapping)
        found[key] = _merged(found[key], value) if both else value
    return found


GENERIC = ("robot", "model", "scene", "main", "mjcf", "urdf")
"""Names of files that say nothing of the robot."""
UNNAMED = ("", "robot", "MuJoCo Model")
"""Names of models that have none."""


def run_name(path: Path, own: str = "") -> str:
    """A run's name made of a model file's, or of the model's where the file's says nothing.

    Args:
        path: The file.
        own: The model's own name.
    """
    said = path.stem
    if said.lower() in GENERIC:
        said = path.absolute().parent.name if own in UNNAMED else own
    return re.sub(r"[^A-Za-z0-9_.-]", "-", said)[:100].lstrip("_.-") or "robot"
