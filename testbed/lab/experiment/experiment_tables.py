"""The tables of an experiment file: settings with units, defaults and bounds, each in one place."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from testbed.core.base.errors import UnknownName
from testbed.core.base.toml_text import Finite, NotNegative, Positive
from testbed.lab.experiment.robot_tables import StrictTable
from testbed.lab.simulation.effect import Effect
from testbed.lab.simulation.effects import effect_of
from testbed.sensors.kind_reader import AsTable

ALWAYS_JUDGED = (
    "external_rms_relative_error",
    "external_max_relative_error",
    "external_max_z",
    "internal_rms_relative_error",
    "internal_max_relative_error",
    "internal_max_z",
    "internal_to_external",
    "friction_max_relative_error",
)
"""What every run with a truth is judged by."""

METRICS = (
    *ALWAYS_JUDGED,
    "external_floor",
    "torque_constant_max_error",
    "torque_constant_max_z",
    "coulomb_max_relative_error",
    "load_max_relative_error",
    "rotor_max_relative_error",
    "friction_curve_rms",
    "combined_rms_relative_error",
    "combined_max_z",
    "consistent_rms_relative_error",
    "prior_rms_relative_error",
    "consistent_to_plain",
    "consistent_least_eigenvalue",
    "payload_mass_error",
    "payload_mass_z",
    "payload_mass_sigma",
    "payload_centre_error",
)
"""What `[expect]` can bound (docs/experiments.md)."""

MOST_HARMONICS = 100
"""Of a motion."""


class MotionTable(StrictTable):
    """Which motion: that of a file, or the best of a few random ones that are proven safe."""

    file: str = ""
    """Motion to run, as `testbed excite` wrote it, relative to the experiment file; then
    `fundamental`, `harmonics` and `candidates` do not count."""
    duration: Positive = 60.0
    """Of the recording [s]."""
    at_rest: bool = False
    """The robot sets out from rest and comes to rest along the motion's own path, proven as well.
    Both are recorded; the whole periods between, nearest to `duration`, are for the estimate."""
    fundamental: Positive = 0.1
    """Frequency at which the motion repeats [Hz]."""
    harmonics: Annotated[int, Field(ge=1, le=MOST_HARMONICS)] = 5
    """Number of harmonics."""
    candidates: Annotated[int, Field(ge=1, le=10_000)] = 40
    """Random motions drawn; the one that promises the smallest sigma is run."""
    max_velocity: dict[str, Positive] = Field(default_factory=dict)
    """By joint, besides the model file's limits [rad/s or m/s]."""
    max_acceleration: dict[str, Positive] = Field(default_factory=dict)
    """By joint [rad/s^2 or m/s^2]."""


class ObstacleTable(StrictTable):
    """A box of the robot's cell, along the bedplate's axes."""

    centre: tuple[Finite, Finite, Finite]
    """Bedplate frame [m]."""
    size: tuple[Positive, Positive, Positive]
    """Lengths of its sides [m]."""


class ExcitationTable(StrictTable):
    """What a motion must respect, and what `testbed excite` looks for."""

    instrument: Literal["plate", "joints", "both"] = "plate"
    """By whose signals the bodies are to become certain: the plate's, joint torques, or both."""
    criterion: Literal["a", "d", "e"] = "a"
    """Of the covariance of relative errors: its trace, determinant or largest eigenvalue."""
    lowest_frequency: Positive = 0.1
    """At which a motion may repeat [Hz]."""
    highest_frequency: Positive = 1.6
    """Of its fastest harmonic [Hz]."""
    harmonics: Annotated[int, Field(ge=1, le=100)] = 8
    """Most that are used."""
    starts: Annotated[int, Field(ge=1, le=10_000)] = 6
    """Searches, each from another random motion; the best result is taken."""
    margin: Annotated[float, Field(gt=0, le=1)] = 0.95
    """Share of every limit that a designed motion may use; random ones are proven for all of it."""
    clearance: NotNegative | Literal["off"] = 0.02
    """Distance kept by bodies that no joint joins, and to plate, floor and obstacles [m]."""
    exclude: tuple[tuple[str, str], ...] = ()
    """Pairs of bodies whose distance does not count, by name; "plate" is what stands on it, "floor"
    the floor."""
    floor: Finite | Literal["off"] | None = None
    """Height of the floor [m], bedplate frame; default the lowest point of what the file draws on
    the bedplate."""
    obstacle: tuple[ObstacleTable, ...] = ()
    """Boxes around the robot, `[[excitation.obstacle]]`."""
    plate_range: (
        tuple[Positive, Positive, Positive, Positive, Positive, Positive] | None
    ) = None
    """Largest magnitudes of the plate's wrench, pedestal included [N, N m]; default
    `measurement.full_scale` for designed motions, none for random ones or without a plate. Force
    sensors have their own `full_scale`."""
    pressure_area: tuple[Positive, Positive] | None = None
    """Half lengths along x and y of the area in which the centre of pressure stays [m]; default
    none: the plate is bolted down."""


class SimulationTable(StrictTable):
    """The plant and its controller."""

    step: Positive = 2.5e-4
    """Of the integration where a joint sticks or turns round; else it may be up to 1 ms [s]."""
    friction: bool = True
    """Keep the joints' friction."""
    bandwidth: Positive = 60.0
    """Of the joint controllers [rad/s]."""
    warm_up: NotNegative = 2.0
    """Time run before the recording starts [s]."""
    effect: tuple[Annotated[Effect, AsTable(effect_of)], ...] = ()
    """What else is in the plant, `[[simulation.effect]]` (docs/instruments.md)."""


class PriorTable(StrictTable):
    """The model file that consistent bodies start from: in an experiment it is the truth."""

    error: NotNegative = 0.3
    """How wrong its bodies are made first, in parts of themselves."""


class Bound(StrictTable):
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
        return ", ".join(
            f"{side.replace('_', ' ')} {value:g}" for side, value in bounds
        )

    def holds(self, value: float) -> bool:
        """Whether `value` is within the bound; a value that is not a number never is."""
        low = -math.inf if self.at_least is None else self.at_least
        return low <= value <= (math.inf if self.at_most is None else self.at_most)


def _known(expect: dict[str, Bound]) -> dict[str, Bound]:
    for name in expect:
        if name not in METRICS:
            raise ValueError(str(UnknownName("metric", name, METRICS)))
    return expect


Expectations = Annotated[dict[str, Bound], AfterValidator(_known)]
"""Bounds by metric."""

RunName = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$", max_length=100)]
"""Letters, digits, dot, dash, underscore."""
