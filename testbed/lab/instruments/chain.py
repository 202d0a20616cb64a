"""The whole instrument: encoders, drives and plate, each a chain of stages."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, ClassVar

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.errors import RecordingError, SettingsError, UnknownName
from testbed.core.recordings.metadata import Metadata
from testbed.core.recordings.recording import Recording, Truth
from testbed.lab.instruments.error_chain import apply_chain, number_kinds, stream
from testbed.lab.instruments.plates import PLATES
from testbed.sensors.errors.encoder_instant_sampling import EncoderInstantSampling
from testbed.sensors.errors.encoder_noise import EncoderNoise
from testbed.sensors.errors.encoder_resolution import EncoderResolution
from testbed.sensors.errors.measured_tare import MeasuredTare
from testbed.sensors.errors.plate_noise import PlateNoise
from testbed.sensors.errors.torque_constant_error import TorqueConstantError
from testbed.sensors.errors.torque_noise import TorqueNoise
from testbed.sensors.kind_reader import AsTable, error_of
from testbed.sensors.kind_table import Key
from testbed.sensors.sensor_error import FULL_SCALE, SensorError, Signal

_SIZES: Mapping[str, Key] = {
    "rate": Key(positive=True),
    "encoder_resolution": Key(least=0),
    "encoder_noise": Key(least=0),
    "torque_noise": Key(least=0),
    "torque_constant_error": Key("joints"),
    "force_noise": Key(least=0),
    "moment_noise": Key(least=0),
    "full_scale": Key("channels", positive=True),
}
_SIGNALS: tuple[Signal, ...] = ("position", "torque", "wrench", "tare")
_TARE = "tare"
"""Use of random numbers for a tare that is measured."""


@dataclass(frozen=True)
class Instrument:
    """How samples are taken and how well; by default perfectly. The table [measurement].

    Attributes:
        rate: Samples a second; also the controller's rate [Hz].
        averaged: Each sample is the mean over its steps, else its first instant.
        senses_kinematics: Velocities and accelerations are sensed exactly.
        encoder_resolution: Least count of the encoders; 0 for none [rad or m].
        encoder_noise: Standard deviation of position noise [rad or m].
        torque_noise: Standard deviation of the reported motor torque [N m or N].
        torque_constant_error: Relative error of the drives' torque constants by joint
            name: 0.08 reports 8 % too much.
        plate: Model of the plate, for its noise and range where these are not said.
        force_noise: Standard deviation of the plate's forces [N].
        moment_noise: Standard deviation of the plate's moments [N m].
        full_scale: Largest values that the plate's channels can show [N, N m]. Crosstalk and
            converters go by it; only a converter stops there.
        fault: Whatever else is wrong, `[[measurement.fault]]`.
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
    fault: tuple[Annotated[SensorError, AsTable(error_of)], ...] = ()

    __pydantic_config__: ClassVar = {
        "extra": "forbid",
        "strict": True,
        "allow_inf_nan": False,
    }

    def __post_init__(self) -> None:
        if self.plate:
            self._take_from(self.plate)
        for name, size in _SIZES.items():
            size.checked(getattr(self, name), name)
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

    def _take_from(self, plate: str) -> None:
        """Noise and range of a model of plate, where these are not said."""
        if plate not in PLATES:
            raise SettingsError(str(UnknownName("plate", plate, PLATES)))
        for name in ("force_noise", "moment_noise", "full_scale"):
            if getattr(self, name) == type(self).__dataclass_fields__[name].default:
                object.__setattr__(self, name, getattr(PLATES[plate], name))

    @property
    def plate_noise(self) -> Array:
        """Standard deviation of the plate's channels, (6,) [N, N m]."""
        return np.repeat([self.force_noise, self.moment_noise], 3)

    def stages(self, names: tuple[str, ...]) -> dict[Signal, tuple[SensorError, ...]]:
        """What happens to each signal, in order: by place, then as asked for.

        Raises:
            SettingsError: A fault names a joint that is not there, or not of all.
        """
        errors = tuple(self.torque_constant_error.get(name, 0.0) for name in names)
        always: tuple[SensorError, ...] = (
            EncoderNoise(self.encoder_noise),
            EncoderResolution(self.encoder_resolution),
            TorqueConstantError(errors),
            TorqueNoise(self.torque_noise),
            PlateNoise(self.force_noise, self.moment_noise),
        )
        every = [fault.on(names, self.full_scale) for fault in (*always, *self.fault)]
        every.sort(key=lambda fault: fault.stage)
        return {
            s: tuple(fault for fault in every if fault.signal == s) for s in _SIGNALS
        }

    def installed(
        self, names: tuple[str, ...], seed: int, sensor: str = ""
    ) -> dict[Signal, tuple[SensorError, ...]]:
        """The stages with all that chance decides once: signs, phases, crosstalk.

        Args:
            names: Joint names.
            seed: Of the recording.
            sensor: Name of the force sensor that it stands for; "" for the plate.
        """
        once = f"once {sensor}".strip()
        return {
            signal: tuple(
                fault.sample(len(names), stream(fault.kind, seed, number, once))
                for fault, number in number_kinds(stages)
            )
            for signal, stages in self.stages(names).items()
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
    """What the instrument shows of what happened.

    Args:
        instrument: The instrument.
        names: Joint names.
        time: (M,) [s].
        truth: What happens.
        tare: Known static wrench of the pedestal, (6,) [N, N m].
        metadata: Of the recording.
        seed: Of the noise.
        installed: Seed of what chance decides once; default `seed`.
    """
    senses = instrument.senses_kinematics
    exact = Recording(
        names=names,
        time=time,
        position=truth.position,
        torque=truth.torque,
        wrench=truth.wrench,
        velocity=truth.velocity if senses else None,
        acceleration=truth.acceleration if senses else None,
        tare=tare,
        truth=truth,
        metadata=metadata,
    )
    once = seed if installed is None else installed
    chains = instrument.installed(names, once)
    seen: dict[str, Any] = {
        signal: apply_chain(chains[signal], exact.measured(signal), time, seed)
        for signal in ("position", "torque", "wrench")
    }
    for fault in chains["tare"]:
        assert isinstance(fault, MeasuredTare)
        instants = fault.instants(instrument.rate)
        still = np.tile(tare, (len(instants), 1))
        shown = apply_chain(chains["wrench"], still, instants, seed, _TARE)
        seen["tare"] = fault.apply(shown, instants, stream(fault.kind, seed))[0]
    return replace(exact, **seen)


def with_sensors(
    recording: Recording,
    instruments: Mapping[str, Instrument],
    seed: int,
    installed: int | None = None,
) -> Recording:
    """A simulated recording with what force sensors in the robot show.

    Args:
        recording: Its truth has their wrenches, in this order.
        instruments: By sensor; what they say of a plate is of it.
        seed: Of the noise.
        installed: Seed of what chance decides once; default `seed`.

    Raises:
        RecordingError: The recording has no truth of them.
    """
    truth = recording.truth
    if truth is None or truth.sensors is None:
        raise RecordingError(
            "only a simulated recording, with truth, is measured again"
        )
    once, shown = seed if installed is None else installed, []
    for k, (name, instrument) in enumerate(instruments.items()):
        chain = instrument.installed(recording.names, once, name)["wrench"]
        true = truth.sensors[:, 6 * k : 6 * k + 6]
        shown.append(apply_chain(chain, true, recording.time, seed, f"sensor {name}"))
    return replace(recording, sensors=np.hstack(shown), sensor_names=tuple(instruments))


def measured_again(
    recording: Recording, instrument: Instrument, seed: int
) -> Recording:
    """What another instrument shows of a run that was simulated before: no simulation needed.

    Args:
        recording: With its truth, and with the exact tare: of an instrument that does not
            measure it. Its samples are means if the other instrument's are.
        instrument: The other instrument, of the same rate.
        seed: Of the noise.

    Raises:
        RecordingError: The recording has no truth or no tare, or is of another rate.
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
    found = measure(
        instrument,
        recording.names,
        recording.time,
        recording.truth,
        recording.tare,
        recording.metadata,
        seed,
    )
    return replace(found, temperature=recording.temperature)
