"""Settings of an estimate: filters, terms, known values and their defaults."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, ClassVar, Final, Literal, get_type_hints

import numpy as np
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    InstanceOf,
    TypeAdapter,
    ValidationError,
)

from testbed.core.base.errors import SettingsError, UnknownName
from testbed.core.base.summary_table import Value
from testbed.core.robot.friction import law_of_term
from testbed.core.robot.joint_law import JointLaw
from testbed.sensors.catalogue import term_by_name, terms_by_name

MAX_TIME_OR_SPEED = 1e9
"""Largest accepted time [s] and speed [rad/s or m/s]."""


def values_with_sigmas(
    stated: Mapping[str, float | Sequence[float]],
) -> dict[str, tuple[float, float]]:
    """Value and sigma of each name; sigma is zero where not stated.

    Args:
        stated: Checked table of values, or of values with sigmas, by name.
    """
    values = {}
    for name, entry in stated.items():
        value, sigma, *_ = (
            (*entry, 0.0) if isinstance(entry, Sequence) else (entry, 0.0)
        )
        values[name] = float(value), float(sigma)
    return values


DEFAULT_TERMS = ("coulomb", "viscous")
"""Default joint laws."""

FIT_TO_SAMPLING_RATE: Final = "fit"
"""Value of a cutoff that is to fit the sampling rate."""

AUTOMATIC_TERMS = "auto"
"""Value of `Settings.terms` for a choice by cross-validation."""

Cutoff = float | Literal["off", "fit"]
"""Cutoff frequency [Hz], "off" for no filter, or "fit" for a default that fits the sampling
rate."""

DEFAULT_POSITION_CUTOFF, DEFAULT_ROW_CUTOFF = 40.0, 5.0
"""Default cutoffs of the low-pass filters on positions and on rows [Hz]."""

MAX_ROW_CUTOFF_FRACTION = 0.1
"""Largest default cutoff on rows relative to the sampling rate, for accurate differences."""


def _check_distinct(names: tuple[str | JointLaw, ...]) -> tuple[str | JointLaw, ...]:
    """Return the names unchanged; raise ValueError if a name occurs twice."""
    kinds = [name if isinstance(name, str) else name.kind for name in names]
    if len(set(kinds)) < len(kinds):
        raise ValueError
    return names


def _check_known_terms(terms: tuple[str | JointLaw, ...]) -> tuple[str | JointLaw, ...]:
    """Return the terms unchanged; raise UnknownName if a term is no joint law."""
    for term in terms:
        law_of_term(term)
    return terms


def _check_increasing(span: tuple[float, float]) -> tuple[float, float]:
    """Return the time span unchanged; raise ValueError unless it increases."""
    if not span[0] < span[1]:
        raise ValueError
    return span


Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
BoundedNumber = Annotated[Number, Field(ge=0, le=MAX_TIME_OR_SPEED)]
Name = Annotated[str, Field(strict=True)]
CutoffValue = Annotated[
    Annotated[Number, Field(gt=0)] | Literal["off", "fit"],
    BeforeValidator(lambda given: "off" if given is None else given),
]
PositiveNumber = Annotated[Number, Field(gt=0)]


class ValidatedValue(Value):
    """Base class of frozen dataclasses whose fields are validated on construction.

    A field's annotation contains the type that pydantic validates and a description of that type.
    """

    __pydantic_config__: ClassVar = {"extra": "forbid", "strict": True}
    _valid: ClassVar[Mapping[str, tuple[TypeAdapter[Any], str]]]

    def __init_subclass__(cls) -> None:
        hints = get_type_hints(cls, include_extras=True).items()
        metadata = {name: getattr(hint, "__metadata__", ()) for name, hint in hints}
        cls._valid = {
            name: (TypeAdapter(annotations[0]), annotations[1])
            for name, annotations in metadata.items()
            if annotations
        }

    def __post_init__(self) -> None:
        for name, (adapter, description) in self._valid.items():
            value = getattr(self, name)
            try:
                checked = adapter.validate_python(value)
            except ValidationError:
                raise SettingsError(
                    f"{name} is {description}, found {value!r}"
                ) from None
            object.__setattr__(self, name, checked)


KNOWN_VALUES_FIELD = (
    dict[Name, Number | tuple[Number] | tuple[Number, Annotated[Number, Field(ge=0)]]],
    "a table of values, or of values and their sigmas, by name",
)


@dataclass(frozen=True, kw_only=True)
class Settings(ValidatedValue):
    """Settings of an estimate: filters, terms, and values known in advance.

    Values are plain; the table [identification] of an experiment file has the same keys.
    """

    zeros: Annotated[
        bool | Sequence[str],
        Annotated[bool, Field(strict=True)] | tuple[Name, ...],
        "true, false or a list of parameters' names",
    ] = False
    """Barycentric parameters that are known to be zero: true for all that are zero in the model
    file, or their names, such as "mb1x" or "K2xy"."""

    position_cutoff: Annotated[
        Cutoff | None, CutoffValue, 'a positive frequency [Hz] or "off"'
    ] = "fit"
    """Cutoff of the low-pass on encoder positions before they are differentiated [Hz], or "off". At
    least twice `cutoff`, since its attenuation of the motion would bias the estimate. Default: 40
    Hz, or none where the sampling rate is too low for that."""

    cutoff: Annotated[
        Cutoff | None, CutoffValue, 'a positive frequency [Hz] or "off"'
    ] = "fit"
    """Cutoff of the low-pass on both regressor columns and measurement [Hz], or "off". Default: 5
    Hz, or a tenth of the sampling rate or half of `position_cutoff` where that is less."""

    deadband: Annotated[
        float, BoundedNumber, f"a speed [rad/s or m/s], from 0 to {MAX_TIME_OR_SPEED:g}"
    ] = 0.02
    """Speed below which a joint counts as resting [rad/s or m/s]: the sign of its dry friction is
    unknown."""

    reversal_reach: Annotated[
        float | None,
        BoundedNumber | None,
        f"a time [s], from 0 to {MAX_TIME_OR_SPEED:g}",
    ] = None
    """Time around a rest of a joint within which its rows are excluded [s], since the filter on
    rows spreads the friction there. Default: an estimate includes and whitens these rows; where
    single rows are used, all but 3 % of the filter's weight has to lie on moving samples, 0.15 s at
    5 Hz."""

    terms: Annotated[
        Sequence[str | JointLaw] | Literal["auto"] | None,
        Annotated[
            tuple[Name | InstanceOf[JointLaw], ...],
            AfterValidator(_check_known_terms),
            AfterValidator(_check_distinct),
        ]
        | Literal["auto"]
        | None,
        'a list of names, none twice, or "auto"',
    ] = None
    """Joint laws: torques besides the forces that move the bodies, such as "coulomb", "viscous",
    "offset", "rotor", those listed by `testbed list`, and "stribeck@0.1", friction that decays at
    0.1 rad/s. Each holds at all joints and at all coupling shafts, "rotor/elbow" at that joint
    only. "auto" chooses by cross-validation. Default: "coulomb" and "viscous", "offset" for
    imported recordings, and "rotor" for torques from motors, else at joints whose rotor the model
    file states."""

    nuisances: Annotated[
        Sequence[str],
        Annotated[
            tuple[Annotated[Name, AfterValidator(term_by_name)], ...],
            AfterValidator(_check_distinct),
        ],
        "a list of names, none twice",
    ] = ()
    """Sensor errors estimated together with the parameters, for the force plate: "bias", "slope",
    "matrix", "pose", "height", "skew", "joint_zeros", "tare" (docs/uncertainty.md)."""

    tare: Annotated[
        Literal["known", "unknown"],
        Literal["known", "unknown"],
        '"known" or "unknown"',
    ] = "known"
    """"known" if the pedestal's share of the wrench is known. With "unknown", only changes of the
    wrench count: the parameters are those of the tared set, and "bias" is among the nuisances."""

    known: Annotated[Mapping[str, float | Sequence[float]], *KNOWN_VALUES_FIELD] = (
        field(default_factory=dict, hash=False)
    )
    """Known values, exact or with a sigma: a value, or value and sigma, by name. "mass" is that of
    all moving bodies [kg], "centre/x" a coordinate of their centre of mass [m]; any minimal
    parameter and any coefficient of a nuisance can be known."""

    span: Annotated[
        Sequence[float] | None,
        Annotated[tuple[Number, Number], AfterValidator(_check_increasing)] | None,
        "two times [s], the earlier one first",
    ] = None
    """Time span of the samples used, from the first to before the second time [s]. Default: the
    span that the recording states for estimates, as one from rest to rest does; else all
    samples."""

    leave_out: Annotated[
        Sequence[str],
        Annotated[tuple[Name, ...], AfterValidator(_check_distinct)],
        "a list of names of channels, none twice",
    ] = ()
    """Channels excluded from the estimate, such as "torque/elbow" or "torque/wrist_*", besides
    samples of an imported recording that are clipped, dead, stuck, repeated or copied; "nothing"
    includes these samples."""

    drives: Annotated[
        Literal["off", "given", "chosen"],
        Literal["off", "given", "chosen"],
        '"off", "given" or "chosen"',
    ] = "off"
    """Comparison of joint torques with the plate's estimate: torque constants, friction curves,
    combination of both methods. "given" uses the stated joint laws, "chosen" those that
    cross-validation chooses for each joint (docs/drives.md)."""

    model_errors: Annotated[
        bool, Annotated[bool, Field(strict=True)], "true or false"
    ] = True
    """True to search the residuals for model errors, such as friction of another law, elastic
    joints or a base that is not level (docs/model-errors.md)."""

    engine: Annotated[
        Literal["by size", "compiled", "numpy"],
        Literal["by size", "compiled", "numpy"],
        '"by size", "compiled" or "numpy"',
    ] = "by size"
    """Implementation that computes the regressor rows: the compiled kernel, NumPy, or the faster of
    both for the size of the job. They differ in rounding only."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.nuisances and self.row_low_pass is None:
            raise SettingsError("nuisances need a cutoff: rows are filtered")
        row_cutoff, position_cutoff = self.row_low_pass, self.position_low_pass
        if (
            self.cutoff == FIT_TO_SAMPLING_RATE
            and row_cutoff is not None
            and position_cutoff is not None
        ):
            row_cutoff = min(row_cutoff, position_cutoff / 2)
        if (
            row_cutoff is not None
            and position_cutoff is not None
            and position_cutoff < 2 * row_cutoff
        ):
            raise SettingsError(
                f"position_cutoff = {position_cutoff:g} Hz is less than twice cutoff = "
                f"{row_cutoff:g} Hz: what it takes from the motion would bias the estimate"
            )

    @property
    def position_low_pass(self) -> float | None:
        """Cutoff of the low-pass on positions [Hz]; None for no filter."""
        return _cutoff_frequency(self.position_cutoff, DEFAULT_POSITION_CUTOFF)

    @property
    def row_low_pass(self) -> float | None:
        """Cutoff of the low-pass on rows [Hz]; None for no filter."""
        return _cutoff_frequency(self.cutoff, DEFAULT_ROW_CUTOFF)

    def fitted(self, rate: float) -> Settings:
        """Settings whose "fit" cutoffs are replaced by frequencies that suit the sampling rate.

        The cutoff on rows is 5 Hz, but at most a tenth of the sampling rate and half of the cutoff
        on positions. The cutoff on positions is 40 Hz, or "off" for sampling rates up to 80 Hz.

        Args:
            rate: Sampling rate [Hz].
        """
        row_cutoff = self.cutoff
        if row_cutoff == FIT_TO_SAMPLING_RATE:
            row_cutoff = min(
                DEFAULT_ROW_CUTOFF,
                MAX_ROW_CUTOFF_FRACTION * rate,
                (self.position_low_pass or np.inf) / 2,
            )
        position_cutoff: Cutoff | None = self.position_cutoff
        if position_cutoff == FIT_TO_SAMPLING_RATE:
            position_cutoff = (
                DEFAULT_POSITION_CUTOFF if rate / 2 > DEFAULT_POSITION_CUTOFF else "off"
            )
        return replace(self, cutoff=row_cutoff, position_cutoff=position_cutoff)

    def with_unknowns(self, names: str | Sequence[str]) -> Settings:
        """Settings with other nuisances or joint laws.

        Args:
            names: Names of sensor errors of the plate, as faults or as nuisances, and of joint
                laws. If no sensor error or no joint law is named, those of the settings are kept.

        Raises:
            UnknownName: A name is neither a sensor error nor a joint law.
        """
        requested, known_errors = (
            [names] if isinstance(names, str) else names,
            terms_by_name(),
        )
        nuisances = dict.fromkeys(
            known_errors[name] for name in requested if name in known_errors
        )
        laws = tuple(name for name in requested if name not in known_errors)
        try:
            return replace(
                self,
                nuisances=tuple(nuisances) or self.nuisances,
                terms=laws or self.terms,
            )
        except UnknownName as error:
            raise UnknownName(
                "term", error.name, (*known_errors, *error.known)
            ) from None

    @property
    def laws(self) -> tuple[JointLaw, ...]:
        """Distinct joint laws of the terms."""
        return tuple(dict.fromkeys(law_of_term(term) for term in self.words))

    @property
    def words(self) -> tuple[str | JointLaw, ...]:
        """Terms as words or laws: "rotor" for all joints, "rotor/elbow" for one joint."""
        if self.terms is None or isinstance(self.terms, str):
            return DEFAULT_TERMS
        return tuple(self.terms)

    @property
    def facts(self) -> dict[str, tuple[float, float]]:
        """Value and sigma of each known quantity, by name."""
        return values_with_sigmas(self.known)


def _cutoff_frequency(cutoff: Cutoff | None, default: float) -> float | None:
    """Cutoff frequency [Hz]; None for no filter.

    Args:
        cutoff: Cutoff of the settings.
        default: Frequency in place of "fit" [Hz].
    """
    if cutoff == FIT_TO_SAMPLING_RATE:
        return default
    return None if cutoff is None or isinstance(cutoff, str) else cutoff


DEFAULTS = Settings()
"""Default settings."""
