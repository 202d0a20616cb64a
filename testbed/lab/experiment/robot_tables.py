"""Tables about a robot and about the estimates from a recording, which need no simulation."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BaseModel, Field, model_validator

from testbed.bodies.consistency.options import ConsistencyOptions
from testbed.core.base.toml_text import (
    KNOWN_KEYS,
    Finite,
    NotNegative,
    Positive,
    checked,
    override,
)
from testbed.core.estimation.settings import Settings
from testbed.core.robot.force_sensor import ForceSensor, before_sensors, beyond_sensor
from testbed.core.robot.free_root import on_free_base
from testbed.core.robot.inertia import Inertia
from testbed.core.robot.model_file import file_of
from testbed.core.robot.rotations import from_rpy
from testbed.core.robot.shafts import with_shafts
from testbed.core.robot.tree import Tree
from testbed.sensors.kind_reader import AsTable, error_of
from testbed.sensors.sensor_error import FULL_SCALE, SensorError

Range = tuple[Finite, Finite]


class StrictTable(BaseModel):
    """Table of an experiment file that refuses unknown keys."""

    model_config = KNOWN_KEYS


class JointTable(StrictTable):
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


class BodyTable(StrictTable):
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
        return BodyTable(
            mass=body.mass, centre=centre, inertia=(xx, yy, zz, xy, xz, yz)
        )

    @property
    def body(self) -> Inertia:
        """Inertia about the origin of the link's frame, along its axes [kg m^2]."""
        xx, yy, zz, xy, xz, yz = self.inertia
        central = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
        return Inertia.about_centre(self.mass, self.centre, central)


class SensorTable(StrictTable):
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
    full_scale: tuple[Positive, Positive, Positive, Positive, Positive, Positive] = (
        FULL_SCALE
    )
    """Largest values that it can show [N, N m], as `measurement.full_scale`."""
    fault: tuple[Annotated[SensorError, AsTable(error_of)], ...] = ()
    """What else is wrong with it, `[[sensors.NAME.fault]]`: as of the plate."""

    @model_validator(mode="after")
    def _faults_are_of_its_wrench(self) -> SensorTable:
        for fault in self.fault:
            if fault.signal != "wrench":
                raise ValueError(
                    f"fault: {fault.kind} is no fault of a force sensor's wrench"
                )
        return self

    def sensor(self, name: str) -> ForceSensor:
        """As a value.

        Args:
            name: Of the sensor.
        """
        return ForceSensor(
            self.link or name, np.array(self.position), from_rpy(self.rpy), name
        )


class RobotTable(StrictTable):
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


class RobotTables(StrictTable):
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

    def sensed(self, tree: Tree) -> Tree:
        """Part of a robot whose wrench is measured: all, or the links beyond a force sensor.

        Args:
            tree: Whole robot.

        Raises:
            UnknownName: The model file has no such link.
            ModelError: The link is the root.
        """
        about, sensors = self.robot.sensor, self.force_sensors
        if not about:
            return tree
        links = file_of(tree).links()
        if about == PLATE:
            return before_sensors(tree, links, sensors.values())
        return beyond_sensor(tree, links, sensors.pop(about), sensors.values())


class RecordingTables(RobotTables):
    """What can be said about a recording that no experiment made, by `--set`."""

    identification: Settings = Settings()
    """How the estimates are made."""
    consistent: ConsistencyOptions = ConsistencyOptions()
    """What is asked of physically consistent bodies."""

    @staticmethod
    def of(settings: Iterable[str], sensors: Mapping[str, Any] = {}) -> RecordingTables:
        """From words "table.key=value".

        Args:
            settings: The words.
            sensors: Tables of force sensors of which the words say nothing, by name.

        Raises:
            ExperimentError: They say what is not understood.
        """
        content: dict[str, Any] = {"sensors": {}}
        override(content, settings)
        if isinstance(content["sensors"], dict):
            content["sensors"] = {**sensors, **content["sensors"]}
        return checked(RecordingTables, content, "--set")
