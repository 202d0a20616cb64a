"""The tables of an experiment file: settings with units, defaults and bounds, each in one place."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, BaseModel, Field, model_validator

from testbed.errors import UnknownName
from testbed.identification.estimate import METHODS, Method
from testbed.instruments.fault import FULL_SCALE, Fault
from testbed.instruments.faults import fault_of
from testbed.kind_table import AsTable
from testbed.robot.force_sensor import ForceSensor, before_sensors, beyond_sensor
from testbed.robot.free_base import on_free_base
from testbed.robot.inertia import Inertia, from_rpy
from testbed.robot.locks import with_shafts
from testbed.robot.model_file import ModelFile
from testbed.robot.tree import Tree
from testbed.simulation.effect import Effect
from testbed.simulation.effects import effect_of
from testbed.toml_text import KNOWN_KEYS, Finite, NotNegative, Positive

Range = tuple[Finite, Finite]

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


class Table(BaseModel):
    """A table whose keys are all known."""

    model_config = KNOWN_KEYS


class JointTable(Table):
    """What the model file does not say of a joint, or says wrongly."""

    position_range: Range | None = None
    """Least and greatest position [rad or m]."""
    max_velocity: Positive | None = None
    """[rad/s or m/s]."""
    max_effort: Positive | None = None
    """Of the motor, at the joint [N m or N]."""
    coulomb: NotNegative | None = None
    """Dry friction [N m or N]."""
    viscous: NotNegative | None = None
    """Viscous friction [N m s/rad or N s/m]."""
    rotor_inertia: NotNegative | None = None
    """Of the drive, at the joint [kg m^2 or kg]."""
    rotor_spin: Finite | None = None
    """Ratio times inertia of a rotor that spins on its carrier: what the plate feels of it, counted
    as the minimal parameters' that hold it (docs/instruments.md) [kg m^2]."""


class BodyTable(Table):
    """A link with all that is fixed to it, along the link's axes."""

    mass: NotNegative
    """[kg]."""
    centre: tuple[Finite, Finite, Finite]
    """Of mass, from the link's origin [m]."""
    inertia: tuple[Finite, Finite, Finite, Finite, Finite, Finite]
    """About the centre: xx, yy, zz, xy, xz, yz [kg m^2]."""

    @staticmethod
    def of(body: Inertia) -> BodyTable:
        """A table of a body that is given about and along the link's frame."""
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = body.central.tolist()
        centre = tuple(body.com.tolist())
        return BodyTable(mass=body.mass, centre=centre, inertia=(xx, yy, zz, xy, xz, yz))

    @property
    def body(self) -> Inertia:
        """About and along the link's frame."""
        xx, yy, zz, xy, xz, yz = self.inertia
        central = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
        return Inertia.about_centre(self.mass, self.centre, central)


class SensorTable(Table):
    """A six-axis force sensor between a link and the one that carries it, by a name of your own."""

    link: str = ""
    """The first link beyond it; default the sensor's name."""
    position: tuple[Finite, Finite, Finite] = (0.0, 0.0, 0.0)
    """Of its origin in that link's frame [m]."""
    rpy: tuple[Finite, Finite, Finite] = (0.0, 0.0, 0.0)
    """Roll, pitch, yaw of its axes in that link's frame [rad]."""
    plate: str = ""
    """Model of sensor, as `measurement.plate`, for its noise and range where these are not said."""
    force_noise: NotNegative = 0.0
    """Standard deviation of its forces [N]."""
    moment_noise: NotNegative = 0.0
    """Standard deviation of its moments [N m]."""
    full_scale: tuple[Positive, Positive, Positive, Positive, Positive, Positive] = FULL_SCALE
    """Largest values that it can show [N, N m], as `measurement.full_scale`."""
    fault: tuple[Annotated[Fault, AsTable(fault_of)], ...] = ()
    """What else is wrong with it, `[[sensors.NAME.fault]]`: as of the plate."""

    @model_validator(mode="after")
    def _faults_are_of_its_wrench(self) -> SensorTable:
        for fault in self.fault:
            if fault.signal != "wrench":
                raise ValueError(f"fault: {fault.kind} is no fault of a force sensor's wrench")
        return self

    def sensor(self, name: str) -> ForceSensor:
        """As a value.

        Args:
            name: Of the sensor.
        """
        return ForceSensor(self.link or name, np.array(self.position), from_rpy(self.rpy), name)


class RobotTable(Table):
    """How the model file is read."""

    lock: dict[str, Finite] = {}
    """Joints that are held, and where [rad or m]: their bodies become part of the carriers."""
    lock_mimic: bool = False
    """Joints that mimic others are held where their masters' zero puts them."""
    repair: dict[str, BodyTable] = {}
    """By link: bodies in place of those that no matter can make, as `testbed new` writes them. A
    model file with such bodies is refused without."""
    base: Literal["fixed", "measured"] = "fixed"
    """Whether the root is welded to the bedplate, or free and its pose in the recording."""
    sensor: str = ""
    """Which force sensor the estimate is by, a name in `sensors` or a link: it is of the links
    beyond it, up to the next sensor. "plate" is the force plate up to the next; default: the force
    plate under the whole robot."""
    joint: dict[str, JointTable] = {}
    """By joint: limits and friction, instead of the model file's."""
    coupling: dict[str, dict[str, Finite]] = {}
    """Motor shafts that turn with several joints: by a name of your own, how much with each joint.
    Default: those of an imported recording's [gear]."""

    @property
    def bodies(self) -> dict[str, Inertia]:
        """What is taken in place of bodies that cannot be, by link."""
        return {name: table.body for name, table in self.repair.items()}

    @property
    def settings(self) -> dict[str, dict[str, object]]:
        """What is said of joints, by joint and key."""
        left_out = {"rotor_spin"}
        return {
            name: table.model_dump(exclude_none=True, exclude=left_out)
            for name, table in self.joint.items()
        }

    def on(self, tree: Tree) -> Tree:
        """The robot of a model file with all that is said here of its base, joints and shafts.

        Args:
            tree: As the file has it, the root welded.

        Raises:
            UnknownName: There is no such joint.
            ModelError: Something is said that no robot has.
        """
        whole = on_free_base(tree) if self.base == "measured" else tree
        return with_shafts(whole.with_joints(self.settings), self.coupling)

    @property
    def spins(self) -> dict[str, float]:
        """Spin of rotors, by joint."""
        given = {name: table.rotor_spin for name, table in self.joint.items()}
        return {name: spin for name, spin in given.items() if spin is not None}


PLATE = "plate"
"""What `robot.sensor` calls the force plate."""


def _named(name: str) -> str:
    if name == PLATE or not name.isprintable() or "/" in name:
        raise ValueError(f"'{name}' is no name of a force sensor")
    return name


SensorName = Annotated[str, Field(min_length=1, max_length=100), AfterValidator(_named)]


class RobotTables(Table):
    """A robot and its force sensors."""

    robot: RobotTable = RobotTable()
    """How the model file is read."""
    sensors: dict[SensorName, SensorTable] = {}
    """Force sensors in the robot, besides the force plate under it."""

    @property
    def force_sensors(self) -> dict[str, ForceSensor]:
        """Those of `sensors`, and the one that `robot.sensor` names by its link."""
        own, about = self.sensors, self.robot.sensor
        if about and about != PLATE and about not in own:
            own = own | {about: SensorTable()}
        return {name: table.sensor(name) for name, table in own.items()}

    def sensed(self, tree: Tree, model: ModelFile) -> Tree:
        """What the wrench is of: the whole robot, or what lies beyond a force sensor.

        Args:
            tree: The robot.
            model: Its model file.

        Raises:
            UnknownName: The model file has no such link.
            ModelError: The link is the root.
        """
        about, sensors = self.robot.sensor, self.force_sensors
        if not about:
            return tree
        if about == PLATE:
            return before_sensors(tree, model.links(), sensors.values())
        own = sensors.pop(about)
        return beyond_sensor(tree, model.links(), own, sensors.values())


class MotionTable(Table):
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
    max_velocity: dict[str, Positive] = {}
    """By joint, besides the model file's limits [rad/s or m/s]."""
    max_acceleration: dict[str, Positive] = {}
    """By joint [rad/s^2 or m/s^2]."""


class ObstacleTable(Table):
    """A box of the robot's cell, along the bedplate's axes."""

    centre: tuple[Finite, Finite, Finite]
    """Bedplate frame [m]."""
    size: tuple[Positive, Positive, Positive]
    """Lengths of its sides [m]."""


class ExcitationTable(Table):
    """What a motion must respect, and what `testbed excite` looks for."""

    aim: Literal["bodies", "friction"] = "bodies"
    """What is to become certain: the bodies' parameters; or the joints' torque constants and
    coefficients of friction, those of `identification.terms` and the load's, by torques beside the
    plate."""
    instrument: Literal["plate", "joints", "both"] = "plate"
    """By whose signals the bodies are to become certain: the plate's, joint torques, or both."""
    criterion: Literal["a", "d", "e"] | None = None
    """Of the covariance of relative errors: its trace, determinant or largest eigenvalue; default
    "a" for bodies, "d" for friction."""
    lowest_frequency: Positive = 0.1
    """At which a motion may repeat [Hz]."""
    highest_frequency: Positive = 1.6
    """Of its fastest harmonic [Hz]."""
    harmonics: Annotated[int, Field(ge=1, le=100)] = 8
    """Most that are used."""
    starts: Annotated[int, Field(ge=1, le=10_000)] = 6
    """Searches, each from another random motion; the best result is taken."""
    seconds: Positive | None = None
    """Time after which searches end, whatever they have reached [s]; default none."""
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
    plate_range: tuple[Positive, Positive, Positive, Positive, Positive, Positive] | None = None
    """Largest magnitudes of the plate's wrench, pedestal included [N, N m]; default
    `measurement.full_scale` for designed motions, none for random ones or without a plate. Force
    sensors have their own `full_scale`."""
    pressure_area: tuple[Positive, Positive] | None = None
    """Half lengths along x and y of the area in which the centre of pressure stays [m]; default
    none: the plate is bolted down."""

    @property
    def signals(self) -> Literal["plate", "joints", "both"]:
        """Whose rows count: of the plate and of torques for friction."""
        return self.instrument if self.aim == "bodies" else "both"

    @property
    def judged_by(self) -> Literal["a", "d", "e"]:
        """The criterion; that for friction needs no units to be relative to."""
        return self.criterion or ("a" if self.aim == "bodies" else "d")


class SimulationTable(Table):
    """The plant and its controller."""

    step: Positive = 2.5e-4
    """Of the integration where a joint sticks or turns round; else it may be up to 1 ms [s]."""
    friction: bool = True
    """Keep the joints' friction."""
    bandwidth: Positive = 60.0
    """Of the joint controllers [rad/s]."""
    drive_model_error: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Relative, of every mass and coefficient of friction that the controller believes."""
    warm_up: NotNegative = 2.0
    """Time run before the recording starts [s]."""
    effect: tuple[Annotated[Effect, AsTable(effect_of)], ...] = ()
    """What else is in the plant, `[[simulation.effect]]` (docs/instruments.md)."""


class PriorTable(Table):
    """The model file that consistent bodies start from: in an experiment it is the truth."""

    error: NotNegative = 0.3
    """How wrong its bodies are made first, in parts of themselves."""


class Bound(Table):
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


def _known(expect: dict[str, Bound]) -> dict[str, Bound]:
    for name in expect:
        if name not in METRICS:
            raise ValueError(str(UnknownName("metric", name, METRICS)))
    return expect


Expectations = Annotated[dict[str, Bound], AfterValidator(_known)]
"""Bounds by metric."""

RunName = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$", max_length=100)]
"""Letters, digits, dot, dash, underscore."""


class VariedTables(Table):
    """What a file says that varies one experiment: a comparison, a campaign."""

    name: RunName
    """Of the comparison or campaign."""
    claim: str = ""
    """What it shows, in a sentence."""
    experiment: str
    """Experiment file, relative to this one; its own claims do not count."""
    set: tuple[str, ...] = ()
    """What is different from it throughout: "key = value" as `--set` takes it."""
    methods: Annotated[tuple[Method, ...], Field(min_length=1)] = METHODS
    """Which estimates are made."""
