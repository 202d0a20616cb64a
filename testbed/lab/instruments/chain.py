"""Simulated measurement: chains of sensor errors for encoders, drives and force plate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, ClassVar

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.errors import RecordingError, SettingsError, UnknownName
from testbed.core.recordings.metadata import Metadata
from testbed.core.recordings.recording import Recording, Truth
from testbed.lab.instruments.error_chain import (
    apply_chain,
    numbered_errors,
    random_stream,
)
from testbed.lab.instruments.plates import PLATE_MODELS
from testbed.sensors.errors.encoder_instant_sampling import EncoderInstantSampling
from testbed.sensors.errors.encoder_noise import EncoderNoise
from testbed.sensors.errors.encoder_resolution import EncoderResolution
from testbed.sensors.errors.measured_tare import MeasuredTare
from testbed.sensors.errors.plate_noise import PlateNoise
from testbed.sensors.errors.torque_constant_error import TorqueConstantError
from testbed.sensors.errors.torque_noise import TorqueNoise
from testbed.sensors.kind_reader import TableField, sensor_error_from_table
from testbed.sensors.kind_table import Key
from testbed.sensors.sensor_error import FULL_SCALE, SensorError, Signal

_KEYS: Mapping[str, Key] = {
    "rate": Key(positive=True),
    "encoder_resolution": Key(least=0),
    "encoder_noise": Key(least=0),
    "torque_noise": Key(least=0),
    "torque_constant_error": Key("joints"),
    "force_noise": Key(least=0),
    "moment_noise": Key(least=0),
    "full_scale": Key("channels", positive=True),
}
"""Bounds on the numbers of an instrument, by key."""
_SIGNALS: tuple[Signal, ...] = ("position", "torque", "wrench", "tare")
"""Measured signals."""
_TARE_USE = "tare"
"""Purpose of the random stream for a measured tare."""


@dataclass(frozen=True)
class Instrument:
    """Sampling and sensor errors of a simulated measurement: the table [measurement].

    By default, measurements are exact.

    Attributes:
        rate: Sampling rate, also the controller's rate [Hz].
        averaged: True if a sample is the mean over its integration steps, False if it is the value
            at its first instant.
        senses_kinematics: True if velocities and accelerations are measured exactly, too.
        encoder_resolution: Least count of the encoders [rad or m]; 0 for continuous positions.
        encoder_noise: Standard deviation of position noise [rad or m].
        torque_noise: Standard deviation of the reported motor torque [N m or N].
        torque_constant_error: Relative error of the drives' torque constants, keyed by joint; with
            0.08, the reported torque is 8 % too large.
        plate: Name of a plate model, whose noise and range replace default values of these.
        force_noise: Standard deviation of the plate's forces [N].
        moment_noise: Standard deviation of the plate's moments [N m].
        full_scale: Largest values of the plate's channels [N, N m]. Errors by crosstalk and
            converters are relative to them; only a converter limits the signal to them.
        fault: Further sensor errors, from `[[measurement.fault]]`.
    """

    rate: float = 1000.0
    averaged: bool = True
    senses_kinematics: bool = False
    encoder_resolution: float = 0.0
    encoder_noise: float = 0.0
    torque_noise: float = 0.0
    torque_constant_error: Mapping[str, float] = field(default_factory=dict)
    plate: str = ""
    force_noise: float = 0.0
    moment_noise: float = 0.0
    full_scale: tuple[float, float, float, float, float, float] = FULL_SCALE
    fault: tuple[Annotated[SensorError, TableField(sensor_error_from_table)], ...] = ()

    __pydantic_config__: ClassVar = {
        "extra": "forbid",
        "strict": True,
        "allow_inf_nan": False,
    }

    def __post_init__(self) -> None:
        if self.plate:
            self._apply_plate_model(self.plate)
        for name, key in _KEYS.items():
            key.validated_value(getattr(self, name), name)
        for fault in self.fault:
            fault.check_rate(self.rate)
        if sum(isinstance(fault, MeasuredTare) for fault in self.fault) > 1:
            raise SettingsError(
                "measured_tare is asked for more than once; there is one tare"
            )
        latched = any(isinstance(fault, EncoderInstantSampling) for fault in self.fault)
        if latched and not self.averaged:
            raise SettingsError(
                "encoder_instant_sampling makes instants of means, and with averaged = false all "
                "samples are instants; leave one of them out"
            )

    def _apply_plate_model(self, plate: str) -> None:
        """Replace default force noise, moment noise and full scale by a plate model's values.

        Raises:
            SettingsError: There is no plate model of this name.
        """
        if plate not in PLATE_MODELS:
            raise SettingsError(str(UnknownName("plate", plate, PLATE_MODELS)))
        for name in ("force_noise", "moment_noise", "full_scale"):
            if getattr(self, name) == type(self).__dataclass_fields__[name].default:
                object.__setattr__(self, name, getattr(PLATE_MODELS[plate], name))

    @property
    def plate_noise(self) -> Array:
        """Noise standard deviations of the plate's channels, (6,) [N, N m]."""
        return np.repeat([self.force_noise, self.moment_noise], 3)

    def error_stages(
        self, names: tuple[str, ...]
    ) -> dict[Signal, tuple[SensorError, ...]]:
        """Sensor errors of each signal, sorted by stage, then by order in the file.

        Args:
            names: Joint names.

        Returns:
            Errors keyed by signal, "position", "torque", "wrench" and "tare"; empty for no errors.

        Raises:
            SettingsError: An error refers to an unknown joint, or lacks values for some joints.
        """
        errors = tuple(self.torque_constant_error.get(name, 0.0) for name in names)
        always: tuple[SensorError, ...] = (
            EncoderNoise(self.encoder_noise),
            EncoderResolution(self.encoder_resolution),
            TorqueConstantError(errors),
            TorqueNoise(self.torque_noise),
            PlateNoise(self.force_noise, self.moment_noise),
        )
        faults = [
            fault.for_robot(names, self.full_scale) for fault in (*always, *self.fault)
        ]
        faults.sort(key=lambda fault: fault.stage)
        return {
            s: tuple(fault for fault in faults if fault.signal == s) for s in _SIGNALS
        }

    def sampled_stages(
        self, names: tuple[str, ...], seed: int, sensor: str = ""
    ) -> dict[Signal, tuple[SensorError, ...]]:
        """Sensor errors of each signal, with their signs, phases and crosstalk drawn at random.

        Args:
            names: Joint names.
            seed: Seed of the recording.
            sensor: Name of the force sensor; "" for the plate.
        """
        use = f"once {sensor}".strip()
        return {
            signal: tuple(
                fault.with_random_values(
                    len(names), random_stream(fault.kind, seed, number, use)
                )
                for fault, number in numbered_errors(stages)
            )
            for signal, stages in self.error_stages(names).items()
        }


def measure(
    instrument: Instrument,
    names: tuple[str, ...],
    time: Array,
    truth: Truth,
    tare: Array,
    metadata: Metadata,
    seed: int,
    installed: int | None = None,
) -> Recording:
    """Apply an instrument's sensor errors to true signals, and return the recording.

    The chains of errors are applied to positions, torques and wrench. The tare is exact unless the
    instrument measures it.

    Args:
        instrument: Sensor errors; its rate is used only for a measured tare.
        names: Joint names.
        time: Times of the samples, (M,) [s].
        truth: True signals.
        tare: True static wrench of the pedestal, (6,) [N, N m].
        metadata: Metadata of the recording.
        seed: Seed of the noise.
        installed: Seed of the signs, phases and crosstalk of the sensors; default `seed`.
    """
    has_kinematics = instrument.senses_kinematics
    exact = Recording(
        names=names,
        time=time,
        position=truth.position,
        torque=truth.torque,
        wrench=truth.wrench,
        velocity=truth.velocity if has_kinematics else None,
        acceleration=truth.acceleration if has_kinematics else None,
        tare=tare,
        truth=truth,
        metadata=metadata,
    )
    installation_seed = seed if installed is None else installed
    chains = instrument.sampled_stages(names, installation_seed)
    measured: dict[str, Any] = {
        signal: apply_chain(chains[signal], exact.measured(signal), time, seed)
        for signal in ("position", "torque", "wrench")
    }
    for fault in chains["tare"]:
        assert isinstance(fault, MeasuredTare)
        instants = fault.instants(instrument.rate)
        rest_wrench = np.tile(tare, (len(instants), 1))
        reading = apply_chain(chains["wrench"], rest_wrench, instants, seed, _TARE_USE)
        measured["tare"] = fault.apply(
            reading, instants, random_stream(fault.kind, seed)
        )[0]
    return replace(exact, **measured)


def with_sensor_readings(
    recording: Recording,
    instruments: Mapping[str, Instrument],
    seed: int,
    installed: int | None = None,
) -> Recording:
    """Simulated recording, completed by the readings of force sensors in the robot.

    Args:
        recording: Recording whose true signals contain the wrenches of the sensors, in this order.
        instruments: Instruments keyed by sensor name; their plate errors are those of the sensor.
        seed: Seed of the noise.
        installed: Seed of the signs, phases and crosstalk of the sensors; default `seed`.

    Raises:
        RecordingError: The recording has no true wrenches of the sensors.
    """
    truth = recording.truth
    if truth is None or truth.sensors is None:
        raise RecordingError(
            "only a simulated recording, with truth, is measured again"
        )
    installation_seed, readings = seed if installed is None else installed, []
    for k, (name, instrument) in enumerate(instruments.items()):
        chain = instrument.sampled_stages(recording.names, installation_seed, name)[
            "wrench"
        ]
        true = truth.sensors[:, 6 * k : 6 * k + 6]
        readings.append(
            apply_chain(chain, true, recording.time, seed, f"sensor {name}")
        )
    return replace(
        recording, sensors=np.hstack(readings), sensor_names=tuple(instruments)
    )


def remeasured(recording: Recording, instrument: Instrument, seed: int) -> Recording:
    """Recording of a simulated run with another instrument, without a new simulation.

    Args:
        recording: Recording with true signals and an exact tare. Its samples must be means if those
            of the other instrument are.
        instrument: The other instrument, with the same sampling rate.
        seed: Seed of the noise.

    Raises:
        RecordingError: The recording has no true signals, no tare, or another sampling rate.
    """
    if recording.truth is None or recording.tare is None:
        raise RecordingError(
            "only a simulated recording, with truth and tare, is measured again"
        )
    if abs(recording.rate / instrument.rate - 1) > 1e-6:
        raise RecordingError(
            f"the recording has {recording.rate:g} samples a second, the instrument takes "
            f"{instrument.rate:g}; simulate again"
        )
    measured = measure(
        instrument,
        recording.names,
        recording.time,
        recording.truth,
        recording.tare,
        recording.metadata,
        seed,
    )
    return replace(measured, temperature=recording.temperature)
