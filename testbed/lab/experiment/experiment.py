"""An experiment: a TOML file as a frozen value with checked keys.

SI units, radians, joint side; tables keyed by joint name. An unknown key is an error that lists the
known keys.
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
from testbed.core.base.toml_text import (
    Finite,
    apply_settings,
    read_toml,
    validate_tables,
)
from testbed.core.estimation.settings import Settings
from testbed.core.robot.gravity import parse_gravity
from testbed.core.robot.model_file import (
    ModelFile,
    mimic_joints,
    nearest_consistent_bodies,
)
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
    """Settings of a simulated experiment: robot, motion, sensors, estimation and claims."""

    name: RunName
    """Name of the run folder: letters, digits, dot, dash, underscore."""
    claim: str = ""
    """Claim of the experiment, in a sentence."""
    model: str
    """Model file, MJCF or URDF, relative to the experiment file."""
    seed: Annotated[int, Field(ge=0, lt=2**128)] = 0
    """Seed of the motion and of all noise."""
    gravity: (
        Annotated[
            list[Finite],
            Field(min_length=3, max_length=3),
            BeforeValidator(parse_gravity),
        ]
        | None
    ) = None
    """Gravity (gx, gy, gz) [m/s^2], bedplate frame, or how the robot is mounted: "level",
    "ceiling", "wall +x", "wall -x", "wall +y", "wall -y", "none"; default the model file's."""
    weld_root: bool = False
    """Weld a floating root to the bedplate."""
    motion: MotionTable = MotionTable()
    excitation: ExcitationTable = ExcitationTable()
    simulation: SimulationTable = SimulationTable()
    measurement: Instrument = Instrument()
    identification: Settings = Settings()
    consistent: ConsistencyOptions | None = None
    """Options of physically consistent bodies; without the table none are estimated."""
    prior: PriorTable = PriorTable()
    expect: Expectations = Field(default_factory=dict)
    """Bounds on metrics: the claim in numbers."""

    @property
    def summary(self) -> SummaryTable:
        """Tables and keys that differ from their defaults."""
        tables = self.model_dump(mode="json", exclude_defaults=True, exclude_none=True)
        rows = tuple((name, repr(value)) for name, value in tables.items())
        return SummaryTable(f"experiment {self.name}", rows)

    @staticmethod
    def from_toml(path: str | Path, settings: Iterable[str] = ()) -> Experiment:
        """Read an experiment file.

        Args:
            path: TOML file; `model` is taken relative to it.
            settings: Overrides "table.key=value", the value in TOML or a bare word.

        Raises:
            ExperimentError: The file cannot be read, or a key or value is not valid.
        """
        path = Path(path)
        return Experiment.of_content(read_toml(path), path, settings)

    def with_(self, **changes: Any) -> Experiment:
        """Copy of the experiment with some values changed.

        Args:
            **changes: New values by table or key; for a table, a dict of the changed keys.

        Raises:
            ExperimentError: A key or value is not valid.
        """
        tables = self.model_dump(mode="json", exclude_none=True)
        return validate_tables(Experiment, _merged_table(tables, changes), "with_")

    @staticmethod
    def of_content(
        content: dict[str, Any], path: Path, settings: Iterable[str] = ()
    ) -> Experiment:
        """Build an experiment from the parsed tables of its TOML file.

        Args:
            content: Unchecked tables, into which the overrides are inserted.
            path: The TOML file; `model` and `motion.file` are taken relative to it.
            settings: Overrides "table.key=value".

        Raises:
            ExperimentError: A key or value is not valid.
        """
        apply_settings(content, settings)
        experiment = validate_tables(Experiment, content, str(path))
        if "\0" in experiment.model + experiment.motion.file:
            raise ExperimentError(f"{path}: model or motion.file is not a file name")
        changed: dict[str, Any] = {
            "model": str((path.parent / experiment.model).resolve())
        }
        if experiment.motion.file:
            file = str((path.parent / experiment.motion.file).resolve())
            changed["motion"] = experiment.motion.model_copy(update={"file": file})
        return experiment.model_copy(update=changed)

    @staticmethod
    def of_model(path: Path, settings: Iterable[str] = ()) -> Experiment:
        """Build an experiment without an experiment file, from a model file and overrides.

        Args:
            path: Model file.
            settings: Overrides "table.key=value".

        Raises:
            ExperimentError: A key or value is not valid.
        """
        content: dict[str, Any] = {"name": run_name(path), "model": str(path.resolve())}
        apply_settings(content, settings)
        return validate_tables(Experiment, content, "--set")

    def as_toml(self) -> str:
        """TOML text of the experiment, with every default written out."""
        return tomli_w.dumps(self.model_dump(mode="json", exclude_none=True))

    @property
    def file(self) -> ModelFile:
        """Model file of the robot, with root welded, bodies replaced and joints locked.

        The joints of `robot.lock` are locked, and with `robot.lock_mimic` the mimic joints too.
        """
        mimic = mimic_joints(self.model) if self.robot.lock_mimic else ()
        lock = dict.fromkeys(mimic) | self.robot.lock
        return ModelFile(
            Path(self.model), self.weld_root, self.robot.replacement_inertias, lock
        )

    def with_nearest_bodies(self) -> tuple[Experiment, tuple[Diagnostic, ...]]:
        """Copy of the experiment with inconsistent bodies repaired, and diagnostics of the repair.

        Every body that is not physically consistent is replaced by the nearest consistent body;
        entries of `robot.repair` take precedence.
        """
        file = self.file
        nearest = nearest_consistent_bodies(
            file.path, weld_root=file.weld_root, lock=file.lock
        )
        tables = {
            name: BodyTable.from_inertia(body) for name, body in nearest.bodies.items()
        }
        repair = {"repair": tables | self.robot.repair}
        robot = self.robot.model_copy(update=repair)
        return self.model_copy(update={"robot": robot}), nearest.diagnostics

    @property
    def mounted_sensors(self) -> list[ForcePlate]:
        """Force sensors in the robot, with noise and errors from their tables in `sensors`.

        A sensor that has no table is perfect.
        """
        sensors = []
        for name, mounting in self.force_sensors.items():
            table = self.sensors.get(name, SensorTable())
            noise = table.force_noise, table.moment_noise
            sensors.append(
                ForcePlate(noise, table.fault, table.full_scale, table.plate, mounting)
            )
        return sensors

    @property
    def sensor_instruments(self) -> dict[str, Instrument]:
        """Noise and range of the force sensors in the robot, by name."""
        sensors = zip(self.force_sensors, self.mounted_sensors, strict=True)
        return {name: Instrument(**plate.settings) for name, plate in sensors}


def _merged_table(
    table: Mapping[str, Any], changes: Mapping[str, Any]
) -> dict[str, Any]:
    """Copy of a table with some keys changed, including keys of nested tables."""
    merged = dict(table)
    for key, value in changes.items():
        old_value = merged.get(key)
        nested = isinstance(value, Mapping) and isinstance(old_value, Mapping)
        merged[key] = _merged_table(merged[key], value) if nested else value
    return merged


GENERIC_FILE_NAMES = ("robot", "model", "scene", "main", "mjcf", "urdf")
"""File names that do not name the robot."""
DEFAULT_MODEL_NAMES = ("", "robot", "MuJoCo Model")
"""Model names that stand for a model without name."""


def run_name(path: Path, model_name: str = "") -> str:
    """Name of a run, derived from the model file's name or from the model.

    If the file name is generic (`GENERIC_FILE_NAMES`), the model's name is used, or the folder's
    name if the model has none. Characters other than letters, digits, "_", "." and "-" become "-".

    Args:
        path: Model file.
        model_name: Name of the model in the file.
    """
    name = path.stem
    if name.lower() in GENERIC_FILE_NAMES:
        name = (
            path.absolute().parent.name
            if model_name in DEFAULT_MODEL_NAMES
            else model_name
        )
    return re.sub(r"[^A-Za-z0-9_.-]", "-", name)[:100].lstrip("_.-") or "robot"
