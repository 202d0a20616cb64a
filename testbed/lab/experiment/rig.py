"""Simulated rig: robot, effects in its plant, and sensors with their errors.

Plain frozen values in SI units and radians at the joint side, complete before any file is read or
anything is simulated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from testbed.core.base.errors import ExperimentError, SettingsError
from testbed.core.base.summary_table import Summarized, SummaryTable
from testbed.core.robot.force_sensor import ForceSensor
from testbed.core.robot.model_file import ModelFile, model_file_of
from testbed.core.robot.tree import Tree, require_tree
from testbed.lab.experiment.experiment import Experiment
from testbed.lab.experiment.sensors import (
    Encoders,
    ForcePlate,
    JointTorques,
    Sensor,
    sensors_of,
)
from testbed.lab.instruments.chain import Instrument
from testbed.lab.simulation.effect import Effect
from testbed.sensors.sensor_error import SensorError

MAX_STEPS_PER_SAMPLE = 10_000
"""Largest number of simulation steps per sample; about a thousand samples are held at full
resolution."""

MAX_SAMPLES = 2e6
"""Largest number of samples of a run, which are held in memory."""


def _check_kinds(name: str, values: object, kind: type) -> None:
    """Raise SettingsError if values are not a sequence of the given class."""
    if not isinstance(values, Sequence) or not all(
        isinstance(each, kind) for each in values
    ):
        raise SettingsError(
            f"Rig: {name} is a list of {kind.__name__} values, found {values!r:.80}"
        )


@dataclass(frozen=True, eq=False, repr=False)
class Rig(Summarized):
    """Robot on a bedplate with plant effects and sensors, for simulation along any motion.

    Attributes:
        robot: Robot of `load_tree`, under its gravity.
        plant: Further effects in the plant: `Stribeck()`, `Payload()`, ... (docs/instruments.md).
        sensors: Recorded signals with their errors, besides positions. Default: all, without
            errors.
        rate: Sampling rate of sensors and controller [Hz].
        averaged: True if a sample is the mean over the sampling time, False if it is the value at
            its start.
        friction: True to simulate the joints' friction.
        step: Integration step while a joint sticks or reverses [s]; otherwise steps are up to 1 ms.
        bandwidth: Bandwidth of the joint controllers [rad/s].
        warm_up: Simulated time before the recording starts [s].
    """

    robot: Tree
    plant: Sequence[Effect] = ()
    sensors: Sequence[Sensor] = (ForcePlate(), JointTorques(), Encoders())
    rate: float = 1000.0
    averaged: bool = True
    friction: bool = True
    step: float = 2.5e-4
    bandwidth: float = 60.0
    warm_up: float = 2.0

    def __post_init__(self) -> None:
        require_tree(self.robot, "Rig(robot, plant, sensors)")
        names = self.robot.names
        _check_kinds("plant", self.plant, Effect)
        _check_kinds("sensors", self.sensors, Sensor)
        for sensor in self.sensors:
            _check_kinds(
                f"errors of {type(sensor).__name__}", sensor.errors, SensorError
            )
        if not isinstance(self.friction, bool):
            raise SettingsError(
                f"Rig: friction is True or False, found {self.friction!r}; that of joints is the "
                "robot's, as robot.with_joints({JOINT: {'coulomb': 4.0}})"
            )
        object.__setattr__(
            self, "plant", tuple(effect.for_joints(names) for effect in self.plant)
        )
        object.__setattr__(self, "sensors", tuple(self.sensors))
        kinds = [type(sensor).__name__ for sensor in self.outer]
        for kind in kinds:
            if kinds.count(kind) > 1:
                raise SettingsError(
                    f"Rig: sensors has more than one {kind}; keep one (a force sensor in the robot "
                    'is ForcePlate(mounting=ForceSensor("LINK")))'
                )
        for joint in self.instrument.torque_constant_error:
            self.robot.index(joint)  # refuses joints that are not there
        self.instrument.error_stages(
            names
        )  # refuses errors of joints that are not there

    @staticmethod
    def from_toml(path: str | Path) -> Rig:
        """Read the rig of an experiment file.

        Args:
            path: TOML file; `model` is taken relative to it.

        Raises:
            TestbedError: The file cannot be read, or a key or value is not valid.
        """
        return rig_of(Experiment.from_toml(path))

    @property
    def summary(self) -> SummaryTable:
        """Table with one line each for robot, plant and sensors."""
        rows = [("robot", repr(self.robot))]
        rows += [("plant", repr(each)) for each in self.plant]
        rows += [("sensor", repr(each)) for each in self.sensors]
        return SummaryTable(f"rig at {self.rate:g} Hz", tuple(rows))

    @property
    def file(self) -> ModelFile:
        """Model file of the robot.

        Raises:
            ModelError: The robot was not read from a file.
        """
        return model_file_of(self.robot)

    @property
    def true_robot(self) -> Tree:
        """Robot including the payloads and rotors added by the plant's effects."""
        tree = self.robot
        for effect in self.plant:
            tree = effect.robot_with_effect(tree)
        return tree

    @property
    def outer(self) -> tuple[Sensor, ...]:
        """Sensors of the joints and the plate under the robot."""
        return tuple(each for each in self.sensors if each not in self.mounted.values())

    @property
    def mounted(self) -> dict[ForceSensor, ForcePlate]:
        """Force sensors in the robot, keyed by their mounting."""
        plates = (each for each in self.sensors if isinstance(each, ForcePlate))
        return {each.mounting: each for each in plates if each.mounting is not None}

    @property
    def instrument(self) -> Instrument:
        """Instrument that combines the sensors of the joints and the plate under the robot."""
        return self.instrument_of(*self.outer)

    def instrument_of(self, *sensors: Sensor) -> Instrument:
        """Combine sensors into one instrument at the rig's sampling rate.

        Args:
            sensors: At most one sensor of each class; the signals of a missing class have no
                errors.
        """
        settings = {
            key: value for each in sensors for key, value in each.settings.items()
        }
        errors = tuple(error for each in sensors for error in each.errors)
        return Instrument(
            rate=self.rate, averaged=self.averaged, fault=errors, **settings
        )

    def steps(self, seconds: float) -> int:
        """Number of simulation steps per sample.

        Args:
            seconds: Length of the recording [s].

        Raises:
            SettingsError: The step does not divide the sampling time, the bandwidth exceeds half
                the rate, or the length has fewer than 2 or more than `MAX_SAMPLES` samples.
        """
        if self.bandwidth > self.rate / 2:
            raise SettingsError(
                f"bandwidth = {self.bandwidth:g} rad/s is too fast for a controller at rate = "
                f"{self.rate:g} Hz; lower it to {self.rate / 2:g} or less"
            )
        steps = 1 / self.rate / self.step
        if (
            not 0.5 < steps < MAX_STEPS_PER_SAMPLE
            or abs(round(steps) / steps - 1) > 1e-9
        ):
            raise SettingsError(
                f"step = {self.step:g} s does not divide the sampling time 1 / rate = "
                f"{1 / self.rate:g} s into 1 to {MAX_STEPS_PER_SAMPLE} steps"
            )
        if not self.rate * seconds >= 2:
            raise SettingsError(
                f"{seconds:g} s at {self.rate:g} Hz hold no two samples"
            )
        if self.rate * (seconds + self.warm_up) > MAX_SAMPLES:
            raise SettingsError(
                f"{seconds:g} s (motion.duration) at {self.rate:g} Hz are more than the "
                f"{MAX_SAMPLES:.0e} samples that one run holds in memory; make several runs"
            )
        return round(steps)


def rig_of(experiment: Experiment) -> Rig:
    """Rig of an experiment: robot under its gravity, plant and sensors.

    Args:
        experiment: Experiment with its model file.

    Raises:
        UnknownName: A table is for a joint that does not exist.
        ExperimentError: `robot.base` is "measured": experiments have a bedplate.
    """
    tree = experiment.file.tree()
    for name in (*experiment.motion.max_velocity, *experiment.motion.max_acceleration):
        tree.index(name)  # refuses joints that are not there
    if experiment.robot.base == "measured":
        raise ExperimentError(
            'robot.base = "measured" is for recordings: experiments have a bedplate'
        )
    instrument = experiment.measurement
    return Rig(
        robot=experiment.robot.configured_robot(tree).with_gravity(experiment.gravity),
        plant=experiment.simulation.effect,
        sensors=(*sensors_of(instrument), *experiment.mounted_sensors),
        rate=instrument.rate,
        averaged=instrument.averaged,
        **experiment.simulation.model_dump(exclude={"effect"}),
    )


def robot_of(experiment: Experiment) -> Tree:
    """Robot of an experiment under its gravity, including the plant's payloads and rotors."""
    return rig_of(experiment).true_robot


def sensed_robot(experiment: Experiment) -> Tree:
    """Links of an experiment's robot whose wrench is measured.

    These are all links, or those selected by `robot.sensor`.
    """
    return experiment.sensed_part(robot_of(experiment))
