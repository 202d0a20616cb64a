"""Tables of a robot and of estimates from a recording, without simulation."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BaseModel, Field, model_validator

from testbed.bodies.consistency.options import ConsistencyOptions
from testbed.core.base.toml_text import (
    STRICT_TABLE,
    Finite,
    NotNegative,
    Positive,
    apply_settings,
    validate_tables,
)
from testbed.core.estimation.settings import Settings
from testbed.core.robot.force_sensor import (
    ForceSensor,
    tree_before_sensors,
    tree_beyond_sensor,
)
from testbed.core.robot.free_root import with_free_base
from testbed.core.robot.inertia import Inertia
from testbed.core.robot.model_file import model_file_of
from testbed.core.robot.rotations import rpy_to_matrix
from testbed.core.robot.shafts import with_shafts
from testbed.core.robot.tree import Tree
from testbed.sensors.kind_reader import TableField, sensor_error_from_table
from testbed.sensors.sensor_error import FULL_SCALE, SensorError

Interval = tuple[Finite, Finite]


class StrictTable(BaseModel):
    """Table of an experiment file that refuses unknown keys."""

    model_config = STRICT_TABLE


class JointTable(StrictTable):
    """Limits, friction and rotor of a joint, in place of the model file's values."""

    position_range: Interval | None = None
    """Smallest and largest position [rad or m]."""
    max_velocity: Positive | None = None
    """Velocity limit [rad/s or m/s]."""
    max_effort: Positive | None = None
    """Effort limit of the motor, at the joint [N m or N]."""
    coulomb: NotNegative | None = None
    """Coulomb friction [N m or N]."""
    viscous: NotNegative | None = None
    """Viscous friction [N m s/rad or N s/m]."""
    rotor_inertia: NotNegative | None = None
    """Inertia of the drive, at the joint [kg m^2 or kg]."""
    rotor_spin: Finite | None = None
    """Gear ratio times inertia of a rotor that spins on the carrying body. The plate measures
    its angular momentum; it is counted with the minimal parameters that contain it
    (docs/instruments.md) [kg m^2]."""


class BodyTable(StrictTable):
    """Mass, centre of mass and inertia of a link, including all links fixed to it."""

    mass: NotNegative
    """Mass [kg]."""
    centre: tuple[Finite, Finite, Finite]
    """Centre of mass, from the link's origin, along its axes [m]."""
    inertia: tuple[Finite, Finite, Finite, Finite, Finite, Finite]
    """Inertia about the centre of mass, along the link's axes: xx, yy, zz, xy, xz, yz [kg m^2]."""

    @staticmethod
    def from_inertia(body: Inertia) -> BodyTable:
        """Build a table from an inertia about and along the link's frame.

        Args:
            body: Inertia of the link.
        """
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = body.central.tolist()
        centre = tuple(body.com.tolist())
        return BodyTable(
            mass=body.mass, centre=centre, inertia=(xx, yy, zz, xy, xz, yz)
        )

    @property
    def inertia_at_origin(self) -> Inertia:
        """Inertia about the origin of the link's frame, along its axes [kg m^2]."""
        xx, yy, zz, xy, xz, yz = self.inertia
        central = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
        return Inertia.about_centre(self.mass, self.centre, central)


class SensorTable(StrictTable):
    """Six-axis force sensor between a link and its parent link, under a free name."""

    link: str = ""
    """First link beyond the sensor; default the sensor's name."""
    position: tuple[Finite, Finite, Finite] = (0.0, 0.0, 0.0)
    """Position of its origin in that link's frame [m]."""
    rpy: tuple[Finite, Finite, Finite] = (0.0, 0.0, 0.0)
    """Roll, pitch, yaw of its axes in that link's frame [rad]."""
    plate: str = ""
    """Commercial sensor, as in `measurement.plate`, for noise and range that are not given."""
    force_noise: NotNegative = 0.0
    """Standard deviation of its forces [N]."""
    moment_noise: NotNegative = 0.0
    """Standard deviation of its moments [N m]."""
    full_scale: tuple[Positive, Positive, Positive, Positive, Positive, Positive] = (
        FULL_SCALE
    )
    """Largest measurable magnitudes [N, N m], as in `measurement.full_scale`."""
    fault: tuple[Annotated[SensorError, TableField(sensor_error_from_table)], ...] = ()
    """Further errors of the sensor, `[[sensors.NAME.fault]]`, as for the plate."""

    @model_validator(mode="after")
    def _check_faults(self) -> SensorTable:
        """Raise ValueError for sensor errors that do not apply to a wrench."""
        for fault in self.fault:
            if fault.signal != "wrench":
                raise ValueError(
                    f"fault: {fault.kind} is no fault of a force sensor's wrench"
                )
        return self

    def force_sensor(self, name: str) -> ForceSensor:
        """Force sensor with the mounting of this table.

        Args:
            name: Name of the sensor.
        """
        return ForceSensor(
            self.link or name, np.array(self.position), rpy_to_matrix(self.rpy), name
        )


class RobotTable(StrictTable):
    """Changes to the robot of the model file: locked joints, bodies, limits, friction."""

    lock: dict[str, Finite] = {}
    """Joints that are locked, and their positions [rad or m]: their bodies become part of the
    carrying bodies."""
    lock_mimic: bool = False
    """Lock joints that mimic others, at the position for zero of the joint they follow."""
    repair: dict[str, BodyTable] = {}
    """Bodies by link, instead of bodies that are not physically consistent, as `testbed new`
    writes them. A model file with such bodies is refused without."""
    base: Literal["fixed", "measured"] = "fixed"
    """Root of the robot: "fixed" to the bedplate, or free with its pose "measured" in the
    recording."""
    sensor: str = ""
    """Force sensor for the wrench, a name in `sensors` or a link; the parameters are those of
    the links beyond it, up to the next sensor. "plate" is the force plate up to the next sensor;
    default: the force plate under the whole robot."""
    joint: dict[str, JointTable] = {}
    """Limits and friction by joint, instead of the model file's."""
    coupling: dict[str, dict[str, Finite]] = {}
    """Motor shafts that turn with several joints, under free names: turns of the shaft per joint
    position, by joint. Default: those of an imported recording's [gear]."""

    @property
    def replacement_inertias(self) -> dict[str, Inertia]:
        """Replacement inertias, keyed by link."""
        return {name: table.inertia_at_origin for name, table in self.repair.items()}

    @property
    def joint_settings(self) -> dict[str, dict[str, object]]:
        """Settings of the table `joint` except rotor spins, keyed by joint and setting."""
        excluded = {"rotor_spin"}
        return {
            name: table.model_dump(exclude_none=True, exclude=excluded)
            for name, table in self.joint.items()
        }

    def configured_robot(self, tree: Tree) -> Tree:
        """Robot of a model file with the base, joints and shafts of this table.

        Args:
            tree: Robot of the model file, its root welded.

        Raises:
            UnknownName: A joint of the table does not exist.
            ModelError: A setting does not fit the robot.
        """
        robot = with_free_base(tree) if self.base == "measured" else tree
        return with_shafts(robot.with_joints(self.joint_settings), self.coupling)

    @property
    def rotor_spins(self) -> dict[str, float]:
        """Given rotor spins, keyed by joint [kg m^2]."""
        spins = {name: table.rotor_spin for name, table in self.joint.items()}
        return {name: spin for name, spin in spins.items() if spin is not None}


PLATE = "plate"
"""Value of `robot.sensor` for the force plate."""


def _check_sensor_name(name: str) -> str:
    """Raise ValueError for an invalid sensor name.

    Invalid are "plate", names with a slash, and names with unprintable characters.
    """
    if name == PLATE or not name.isprintable() or "/" in name:
        raise ValueError(f"'{name}' is no name of a force sensor")
    return name


SensorName = Annotated[
    str, Field(min_length=1, max_length=100), AfterValidator(_check_sensor_name)
]


class RobotTables(StrictTable):
    """Tables of a robot and its force sensors."""

    robot: RobotTable = RobotTable()
    """Changes to the robot of the model file."""
    sensors: dict[SensorName, SensorTable] = {}
    """Force sensors in the robot, besides the force plate under it."""

    @property
    def force_sensors(self) -> dict[str, ForceSensor]:
        """Force sensors keyed by name.

        If `robot.sensor` is a link, a sensor with the link's name is added.
        """
        tables, sensor = self.sensors, self.robot.sensor
        if sensor and sensor != PLATE and sensor not in tables:
            tables = tables | {sensor: SensorTable()}
        return {name: table.force_sensor(name) for name, table in tables.items()}

    def sensed_part(self, tree: Tree) -> Tree:
        """Links of a robot whose wrench is measured, as selected by `robot.sensor`.

        The setting is "" for the whole robot, "plate" for the links up to the first force sensors,
        or the name of a sensor for the links beyond it, up to the next sensors.

        Args:
            tree: Whole robot.

        Raises:
            UnknownName: The model file has no such link.
            ModelError: The link is the root.
        """
        sensor, sensors = self.robot.sensor, self.force_sensors
        if not sensor:
            return tree
        links = model_file_of(tree).links()
        if sensor == PLATE:
            return tree_before_sensors(tree, links, sensors.values())
        return tree_beyond_sensor(tree, links, sensors.pop(sensor), sensors.values())


class RecordingTables(RobotTables):
    """Settings from `--set` for a recording that has no experiment."""

    identification: Settings = Settings()
    """Settings of the estimates."""
    consistent: ConsistencyOptions = ConsistencyOptions()
    """Options of physically consistent bodies."""

    @staticmethod
    def from_overrides(
        settings: Iterable[str], sensors: Mapping[str, Any] = {}
    ) -> RecordingTables:
        """Build the tables from overrides "table.key=value".

        Args:
            settings: Overrides.
            sensors: Tables of force sensors by name; overrides take precedence.

        Raises:
            ExperimentError: A key or value is not valid.
        """
        content: dict[str, Any] = {"sensors": {}}
        apply_settings(content, settings)
        if isinstance(content["sensors"], dict):
            content["sensors"] = {**sensors, **content["sensors"]}
        return validate_tables(RecordingTables, content, "--set")
