"""Tables of an experiment file: motion, limits, simulation, prior and claims."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from testbed.core.base.errors import UnknownName
from testbed.core.base.toml_text import Finite, NotNegative, Positive
from testbed.lab.experiment.robot_tables import StrictTable
from testbed.lab.simulation.effect import Effect
from testbed.lab.simulation.effects import effect_from_table
from testbed.sensors.kind_reader import TableField

BASIC_METRICS = (
    "wrench_rms_relative_error",
    "wrench_max_relative_error",
    "wrench_max_z",
    "torque_rms_relative_error",
    "torque_max_relative_error",
    "torque_max_z",
    "torque_to_wrench",
    "friction_max_relative_error",
)
"""Metrics of every run with known truth."""

METRICS = (
    *BASIC_METRICS,
    "wrench_floor",
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
"""Metrics that `[expect]` can bound (docs/experiments.md)."""

MAX_HARMONICS = 100
"""Largest number of harmonics of a motion."""


class MotionTable(StrictTable):
    """Motion of an experiment: a file, or the best of several random motions."""

    file: str = ""
    """Motion file of `testbed excite`, relative to the experiment file; with it, `fundamental`,
    `harmonics` and `candidates` have no effect."""
    duration: Positive = 60.0
    """Duration of the recording [s]."""
    at_rest: bool = False
    """Start from rest and end at rest, along the motion's own path, with limits proven there
    too. Start and end are recorded; estimates use the whole periods between, as many as come
    nearest to `duration`."""
    fundamental: Positive = 0.1
    """Fundamental frequency of the motion [Hz]."""
    harmonics: Annotated[int, Field(ge=1, le=MAX_HARMONICS)] = 5
    """Number of harmonics."""
    candidates: Annotated[int, Field(ge=1, le=10_000)] = 40
    """Number of random motions; the motion with the smallest predicted sigma is run."""
    max_velocity: dict[str, Positive] = Field(default_factory=dict)
    """Velocity limits by joint, besides those of the model file [rad/s or m/s]."""
    max_acceleration: dict[str, Positive] = Field(default_factory=dict)
    """Acceleration limits by joint [rad/s^2 or m/s^2]."""


class ObstacleTable(StrictTable):
    """Obstacle in the robot's workspace: a box along the bedplate's axes."""

    centre: tuple[Finite, Finite, Finite]
    """Centre of the box, bedplate frame [m]."""
    size: tuple[Positive, Positive, Positive]
    """Lengths of its sides [m]."""


class ExcitationTable(StrictTable):
    """Limits of a motion, and options of its design by `testbed excite`."""

    instrument: Literal["plate", "joints", "both"] = "plate"
    """Signals by which the design makes the bodies' parameters certain: the plate's, joint
    torques, or both."""
    criterion: Literal["a", "d", "e"] = "a"
    """Optimality criterion of the covariance of relative errors: a its trace, d its determinant,
    e its largest eigenvalue."""
    lowest_frequency: Positive = 0.1
    """Smallest fundamental frequency of a motion [Hz]."""
    highest_frequency: Positive = 1.6
    """Largest frequency of the fastest harmonic [Hz]."""
    harmonics: Annotated[int, Field(ge=1, le=100)] = 8
    """Largest number of harmonics."""
    starts: Annotated[int, Field(ge=1, le=10_000)] = 6
    """Number of searches, each from another random motion; the best result is taken."""
    margin: Annotated[float, Field(gt=0, le=1)] = 0.95
    """Share of every limit that a designed motion may use; random motions may use all of it."""
    clearance: NotNegative | Literal["off"] = 0.02
    """Smallest distance between bodies without a common joint, and to plate, floor and obstacles
    [m]."""
    exclude: tuple[tuple[str, str], ...] = ()
    """Pairs of bodies, by name, without a smallest distance; "plate" is the pedestal on the
    plate, "floor" the floor."""
    floor: Finite | Literal["off"] | None = None
    """Height of the floor [m], bedplate frame; default the lowest point of the model file's
    shapes on the bedplate."""
    obstacle: tuple[ObstacleTable, ...] = ()
    """Boxes around the robot, `[[excitation.obstacle]]`."""
    plate_range: (
        tuple[Positive, Positive, Positive, Positive, Positive, Positive] | None
    ) = None
    """Largest magnitudes of the plate's wrench, pedestal included [N, N m]; default
    `measurement.full_scale` for designed motions, none for random motions or without a plate.
    Force sensors have their own `full_scale`."""
    pressure_area: tuple[Positive, Positive] | None = None
    """Half lengths along x and y of the area for the centre of pressure [m]; default none: the
    plate is bolted down."""


class SimulationTable(StrictTable):
    """Simulated plant and joint controllers."""

    step: Positive = 2.5e-4
    """Integration step where a joint sticks or reverses; elsewhere up to 1 ms [s]."""
    friction: bool = True
    """Keep the joints' friction."""
    bandwidth: Positive = 60.0
    """Bandwidth of the joint controllers [rad/s]."""
    warm_up: NotNegative = 2.0
    """Simulated time before the recording starts [s]."""
    effect: tuple[Annotated[Effect, TableField(effect_from_table)], ...] = ()
    """Further effects in the plant, `[[simulation.effect]]` (docs/instruments.md)."""


class PriorTable(StrictTable):
    """Perturbation of the true bodies, which yields the prior of the consistent bodies."""

    error: NotNegative = 0.3
    """Relative standard deviation of the perturbation of each body."""


class Bound(StrictTable):
    """Bounds that an experiment claims for one metric."""

    at_most: Finite | None = None
    at_least: Finite | None = None

    @model_validator(mode="after")
    def _check_bounds(self) -> Bound:
        """Raise ValueError if neither bound is given."""
        if self.at_most is None and self.at_least is None:
            raise ValueError("a claim needs at_most or at_least")
        return self

    @property
    def description(self) -> str:
        """Bounds in words, such as "at most 0.0015"."""
        bounds = self.model_dump(exclude_none=True).items()
        return ", ".join(
            f"{side.replace('_', ' ')} {value:g}" for side, value in bounds
        )

    def contains(self, value: float) -> bool:
        """Test whether a value is within the bounds; False for NaN."""
        low = -math.inf if self.at_least is None else self.at_least
        return low <= value <= (math.inf if self.at_most is None else self.at_most)


def _check_metrics(expect: dict[str, Bound]) -> dict[str, Bound]:
    """Raise ValueError for a bound on a metric that is not in `METRICS`."""
    for name in expect:
        if name not in METRICS:
            raise ValueError(str(UnknownName("metric", name, METRICS)))
    return expect


Expectations = Annotated[dict[str, Bound], AfterValidator(_check_metrics)]
"""Bounds by metric."""

RunName = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$", max_length=100)]
"""Name of letters, digits, dot, dash, underscore."""
