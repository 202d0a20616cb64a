"""An experiment: a TOML file as a frozen value, every key checked.

SI units, radians, joint side; tables keyed by joint name. A key that is not known is an
error that lists the known ones.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import tomli_w
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from testbed.errors import ExperimentError, UnknownName

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Cutoff = Positive | Literal["off"]

METRICS = (
    "external_rms_relative_error",
    "external_max_relative_error",
    "external_max_z",
    "internal_rms_relative_error",
    "internal_max_relative_error",
    "internal_max_z",
    "internal_to_external",
    "friction_max_relative_error",
)
"""What `[expect]` can bound (docs/experiments.md)."""


class _Table(BaseModel):
    model_config = ConfigDict(
        extra="forbid", frozen=True, strict=True, use_attribute_docstrings=True
    )


class MotionTable(_Table):
    """Which motion: the best of a few random Fourier series within the limits."""

    duration: Positive = 60.0
    """Of the recording [s]."""
    fundamental: Positive = 0.1
    """Frequency at which the motion repeats [Hz]."""
    harmonics: Annotated[int, Field(ge=1, le=100)] = 5
    """Number of harmonics."""
    candidates: Annotated[int, Field(ge=1, le=10_000)] = 40
    """Random motions drawn; the one that promises the smallest sigma is run."""
    max_velocity: dict[str, Positive] = {}
    """By joint, besides the model file's limits [rad/s or m/s]."""
    max_acceleration: dict[str, Positive] = {}
    """By joint [rad/s^2 or m/s^2]."""


class SimulationTable(_Table):
    """The plant and its controller."""

    step: Positive = 2.5e-4
    """Of the integration [s]."""
    friction: bool = True
    """Keep the model file's joint friction."""
    bandwidth: Positive = 60.0
    """Of the joint controllers [rad/s]."""
    warm_up: NotNegative = 2.0
    """Time run before the recording starts [s]."""


class MeasurementTable(_Table):
    """The instrument; by default perfect encoders, drives and plate."""

    rate: Positive = 1000.0
    """Samples a second; also the controller's rate [Hz]."""
    averaged: bool = True
    """Each sample is the mean over its steps, else its first instant."""
    senses_kinematics: bool = False
    """Velocities and accelerations are sensed exactly."""
    encoder_resolution: NotNegative = 0.0
    """Least count [rad or m]."""
    encoder_noise: NotNegative = 0.0
    """Standard deviation [rad or m]."""
    torque_noise: NotNegative = 0.0
    """Standard deviation [N m or N]."""
    torque_constant_error: dict[str, Finite] = {}
    """By joint: 0.08 reports 8 % too much."""
    force_noise: NotNegative = 0.0
    """Standard deviation of the plate's forces [N]."""
    moment_noise: NotNegative = 0.0
    """Standard deviation of the plate's moments [N m]."""


class IdentificationTable(_Table):
    """How the estimates are made."""

    zeros: bool = False
    """Parameters that are zero in the model file are known."""
    position_cutoff: Cutoff = 40.0
    """Low-pass on encoder positions [Hz], or "off"."""
    cutoff: Cutoff = 5.0
    """Parallel low-pass on regressor and measurement [Hz], or "off"."""
    deadband: NotNegative = 0.02
    """Joint rows at lower speeds are dropped [rad/s or m/s]."""


class Bound(_Table):
    """A claim about one metric."""

    at_most: Finite | None = None
    at_least: Finite | None = None

    @model_validator(mode="after")
    def _bounds_something(self) -> Bound:
        if self.at_most is None and self.at_least is None:
            raise ValueError("a claim needs at_most or at_least")
        return self

    @property
    def wanted(self) -> str:
        """In words: at most 0.0015."""
        bounds = self.model_dump(exclude_none=True).items()
        return ", ".join(f"{side.replace('_', ' ')} {value:g}" for side, value in bounds)

    def holds(self, value: float) -> bool:
        """Whether `value` is within the bound; a value that is not a number never is."""
        low = -math.inf if self.at_least is None else self.at_least
        return low <= value <= (math.inf if self.at_most is None else self.at_most)


class Experiment(_Table):
    """Everything that determines a run."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]
    """Of the run folder: letters, digits, dot, dash, underscore."""
    claim: str = ""
    """What the experiment shows, in a sentence."""
    model: str
    """Model file, MJCF or URDF, relative to the experiment file."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Of the motion and of all noise."""
    gravity: Annotated[list[Finite], Field(min_length=3, max_length=3)] | None = None
    """(gx, gy, gz) [m/s^2], bedplate frame; default the model file's."""
    weld_root: bool = False
    """Weld a floating root to the bedplate."""
    motion: MotionTable = MotionTable()
    simulation: SimulationTable = SimulationTable()
    measurement: MeasurementTable = MeasurementTable()
    identification: IdentificationTable = IdentificationTable()
    expect: dict[str, Bound] = {}
    """Bounds on metrics: the claim."""

    @field_validator("expect")
    @classmethod
    def _metrics_are_known(cls, expect: dict[str, Bound]) -> dict[str, Bound]:
        for name in expect:
            if name not in METRICS:
                raise ValueError(str(UnknownName("metric", name, METRICS)))
        return expect

    @staticmethod
    def load(path: str | Path, settings: Iterable[str] = ()) -> Experiment:
        """Read an experiment file.

        Args:
            path: The TOML file; `model` is taken relative to it.
            settings: Overrides "table.key=value", the value in TOML or a bare word.

        Raises:
            ExperimentError: The file cannot be read, or says what is not understood.
        """
        path = Path(path)
        try:
            content = tomllib.loads(path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            raise ExperimentError(f"there is no experiment file '{path}'") from None
        except (OSError, ValueError) as error:
            raise ExperimentError(f"{path}: not a readable TOML file: {error}") from None
        for setting in settings:
            _override(content, setting)
        try:
            experiment = Experiment.model_validate(content)
        except ValidationError as error:
            raise ExperimentError(f"{path}: {_complaints(error)}") from None
        if "\0" in experiment.model:
            raise ExperimentError(f"{path}: model is not a file name")
        return experiment.model_copy(
            update={"model": str((path.parent / experiment.model).resolve())}
        )

    def as_toml(self) -> str:
        """The experiment with every default written out."""
        return tomli_w.dumps(self.model_dump(mode="json", exclude_none=True))


def _override(content: dict[str, Any], setting: str) -> None:
    """Apply one "table.key=value"."""
    key, equals, value = setting.partition("=")
    if not equals or not key.strip():
        raise ExperimentError(f"--set '{setting}': write it as table.key=value")
    try:
        parsed = tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        parsed = value  # a bare word
    *tables, last = key.strip().split(".")
    here = content
    for table in tables:
        here = here.setdefault(table, {})
        if not isinstance(here, dict):
            raise ExperimentError(f"--set '{setting}': '{table}' is a value, not a table")
    here[last] = parsed


def _complaints(error: ValidationError) -> str:
    """All faults of a file in one line, unknown keys with the known ones."""
    lines = []
    for fault in error.errors():
        where = [str(part) for part in fault["loc"]]
        if fault["type"] == "extra_forbidden":
            *tables, key = where
            known = _known_keys(tables)
            place = f" in [{'.'.join(tables)}]" if tables else ""
            lines.append(str(UnknownName(f"key{place}", key, known)))
        else:
            said = fault["msg"].removeprefix("Value error, ")
            found = "" if fault["type"] == "missing" else f", found {fault['input']!r}"
            label = ".".join(part for part in where if "[" not in part)
            lines.append(said if fault["type"] == "value_error" else f"{label}: {said}{found}")
    return "; ".join(dict.fromkeys(lines))


def _known_keys(tables: list[str]) -> tuple[str, ...]:
    model: type[BaseModel] = Experiment
    for table in tables:
        annotation = model.model_fields[table].annotation if table in model.model_fields else Bound
        model = (
            annotation
            if isinstance(annotation, type) and issubclass(annotation, BaseModel)
            else Bound
        )
    return tuple(model.model_fields)


def joint_tables(experiment: Experiment) -> Mapping[str, Mapping[str, float]]:
    """The tables keyed by joint name, to be checked against the model."""
    return {
        "motion.max_velocity": experiment.motion.max_velocity,
        "motion.max_acceleration": experiment.motion.max_acceleration,
        "measurement.torque_constant_error": experiment.measurement.torque_constant_error,
    }
