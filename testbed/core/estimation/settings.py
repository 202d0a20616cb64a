"""How a recording becomes equations: the one place of defaults."""

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
from testbed.core.robot.friction import law_of
from testbed.core.robot.joint_law import JointLaw
from testbed.sensors.catalogue import term_of, terms

LARGEST = 1e9
"""Times [s] and speeds [rad/s, m/s] that no robot has."""


def with_sigmas(
    stated: Mapping[str, float | Sequence[float]],
) -> dict[str, tuple[float, float]]:
    """Value and sigma by name; zero where none is stated.

    Args:
        stated: A table that has been checked.
    """
    values = {}
    for name, given in stated.items():
        value, sigma, *_ = (
            (*given, 0.0) if isinstance(given, Sequence) else (given, 0.0)
        )
        values[name] = float(value), float(sigma)
    return values


USUAL = ("coulomb", "viscous")
"""Terms of which nothing else is said."""

FIT: Final = "fit"
"""A filter that fits the sampling rate."""

AUTO = "auto"
"""Terms that held-out data choose."""

Cutoff = float | Literal["off", "fit"]
"""A frequency [Hz], or "off", or what the sampling rate allows."""

POSITION_CUTOFF, ROW_CUTOFF = 40.0, 5.0
"""Where the sampling rate allows them [Hz]."""

SLOWEST_ROWS = 0.1
"""Share of a sampling rate up to which differences of positions are good derivatives."""


def _distinct(names: tuple[str | JointLaw, ...]) -> tuple[str | JointLaw, ...]:
    """Raise ValueError where something is named twice."""
    kinds = [name if isinstance(name, str) else name.kind for name in names]
    if len(set(kinds)) < len(kinds):
        raise ValueError
    return names


def _known_terms(terms: tuple[str | JointLaw, ...]) -> tuple[str | JointLaw, ...]:
    """Raise UnknownName where a term is no law."""
    for term in terms:
        law_of(term)
    return terms


def _rising(span: tuple[float, float]) -> tuple[float, float]:
    """Raise ValueError where the second time is not the later one."""
    if not span[0] < span[1]:
        raise ValueError
    return span


Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Amount = Annotated[Number, Field(ge=0, le=LARGEST)]
Name = Annotated[str, Field(strict=True)]
Filter = Annotated[
    Annotated[Number, Field(gt=0)] | Literal["off", "fit"],
    BeforeValidator(lambda given: "off" if given is None else given),
]
Share = Annotated[Number, Field(gt=0)]


class Checked(Value):
    """A frozen dataclass whose fields are checked, whoever makes the value.

    Beside the type of a field stands what pydantic checks, and that in words.
    """

    __pydantic_config__: ClassVar = {"extra": "forbid", "strict": True}
    _valid: ClassVar[Mapping[str, tuple[TypeAdapter[Any], str]]]

    def __init_subclass__(cls) -> None:
        hints = get_type_hints(cls, include_extras=True).items()
        metadata = {name: getattr(hint, "__metadata__", ()) for name, hint in hints}
        cls._valid = {
            k: (TypeAdapter(each[0]), each[1]) for k, each in metadata.items() if each
        }

    def __post_init__(self) -> None:
        for name, (adapter, meaning) in self._valid.items():
            given = getattr(self, name)
            try:
                checked = adapter.validate_python(given)
            except ValidationError:
                raise SettingsError(f"{name} is {meaning}, found {given!r}") from None
            object.__setattr__(self, name, checked)


KNOWN = (
    dict[Name, Number | tuple[Number] | tuple[Number, Annotated[Number, Field(ge=0)]]],
    "a table of values, or of values and their sigmas, by name",
)


@dataclass(frozen=True, kw_only=True)
class Settings(Checked):
    """How a recording becomes equations, and what is known before.

    Plain values only: an experiment file's table [identification] holds the same keys.
    """

    zeros: Annotated[
        bool | Sequence[str],
        Annotated[bool, Field(strict=True)] | tuple[Name, ...],
        "true, false or a list of parameters' names",
    ] = False
    """Barycentric parameters that are known to be zero: true for all that are zero in the
    model file, or their names, such as "mb1x" or "K2xy"."""

    position_cutoff: Annotated[
        Cutoff | None, Filter, 'a positive frequency [Hz] or "off"'
    ] = "fit"
    """Low-pass on encoder positions before they are differentiated [Hz], or "off". At least
    twice `cutoff`: what it takes from the motion would bias the estimate. By default 40 Hz, or
    none where the sampling is too slow for that."""

    cutoff: Annotated[Cutoff | None, Filter, 'a positive frequency [Hz] or "off"'] = (
        "fit"
    )
    """Low-pass on the regressor's columns and the measurement alike [Hz], or "off". By default
    5 Hz, or a tenth of the sampling rate or half of `position_cutoff` where that is less."""

    deadband: Annotated[
        float, Amount, f"a speed [rad/s or m/s], from 0 to {LARGEST:g}"
    ] = 0.02
    """Joints that are slower rest: dry friction there has no sign, and is unknown
    [rad/s or m/s]."""

    reversal_reach: Annotated[
        float | None, Amount | None, f"a time [s], from 0 to {LARGEST:g}"
    ] = None
    """Rows of a joint that rests within this time do not count, since the filter on rows spreads
    what friction does there [s]. Default: in an estimate they do, whitened of it; where single
    rows are looked at, all but 3 % of the filter's weight has to move, 0.15 s at 5 Hz."""

    terms: Annotated[
        Sequence[str | JointLaw] | Literal["auto"] | None,
        Annotated[
            tuple[Name | InstanceOf[JointLaw], ...],
            AfterValidator(_known_terms),
            AfterValidator(_distinct),
        ]
        | Literal["auto"]
        | None,
        'a list of names, none twice, or "auto"',
    ] = None
    """What a joint's torque holds besides the forces that move the bodies, as "coulomb", "viscous",
    "offset", "rotor", those that `testbed list` names, and "stribeck@0.1", friction that fades out
    at 0.1 rad/s. Each holds at all joints and at all shafts that couple some, "rotor/elbow" at that
    one. "auto" lets held-out data choose. Default: "coulomb" and "viscous", "offset" of imported
    recordings, and "rotor" of torques from motors, else of joints whose rotor the model file
    states."""

    nuisances: Annotated[
        Sequence[str],
        Annotated[
            tuple[Annotated[Name, AfterValidator(term_of)], ...],
            AfterValidator(_distinct),
        ],
        "a list of names, none twice",
    ] = ()
    """What of the instrument is unknown beside the parameters, for the external method: "bias",
    "slope", "matrix", "pose", "height", "skew", "joint_zeros", "tare" (docs/uncertainty.md)."""

    tare: Annotated[
        Literal["known", "unknown"],
        Literal["known", "unknown"],
        '"known" or "unknown"',
    ] = "known"
    """Whether it is known what of the wrench is the pedestal's. If not, the plate shows only how
    its wrench changes: the parameters are those of the tared set, and "bias" is among the
    nuisances."""

    known: Annotated[Mapping[str, float | Sequence[float]], *KNOWN] = field(
        default_factory=dict, hash=False
    )
    """What is known exactly, or with a sigma: a value, or value and sigma, by name. "mass" is that
    of all moving bodies [kg], "centre/x" where its centre is [m]; any minimal parameter and any
    number of a nuisance can be known."""

    span: Annotated[
        Sequence[float] | None,
        Annotated[tuple[Number, Number], AfterValidator(_rising)] | None,
        "two times [s], the earlier one first",
    ] = None
    """Samples from the first to before the second time count [s]. Default: those that the recording
    says are for an estimate, as one from rest to rest does; else all."""

    leave_out: Annotated[
        Sequence[str],
        Annotated[tuple[Name, ...], AfterValidator(_distinct)],
        "a list of names of channels, none twice",
    ] = ()
    """Channels that do not count, such as "torque/elbow" or "torque/wrist_*", besides samples of an
    imported recording that are clipped, dead, stuck, repeated or copied; "nothing": those count,
    too."""

    drives: Annotated[
        Literal["off", "given", "chosen"],
        Literal["off", "given", "chosen"],
        '"off", "given" or "chosen"',
    ] = "off"
    """Whether joint torques are held against the plate's estimate: torque constants, friction
    curves, both methods combined; with the given terms, or with those that held-out data choose
    for each joint (docs/drives.md)."""

    model_errors: Annotated[
        bool, Annotated[bool, Field(strict=True)], "true or false"
    ] = True
    """Whether residuals are searched for errors of the model, as friction of another law, elastic
    joints or a base that is not level (docs/model-errors.md)."""

    engine: Annotated[
        Literal["by size", "compiled", "numpy"],
        Literal["by size", "compiled", "numpy"],
        '"by size", "compiled" or "numpy"',
    ] = "by size"
    """What makes the rows: the compiled kernel, NumPy, or whichever is faster for the size of the
    job. They differ in rounding only."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.nuisances and self.row_low_pass is None:
            raise SettingsError("nuisances need a cutoff: rows are filtered")
        slow, fast = self.row_low_pass, self.position_low_pass
        if self.cutoff == FIT and slow is not None and fast is not None:
            slow = min(slow, fast / 2)
        if slow is not None and fast is not None and fast < 2 * slow:
            raise SettingsError(
                f"position_cutoff = {fast:g} Hz is less than twice cutoff = {slow:g} Hz: what it "
                "takes from the motion would bias the estimate"
            )

    @property
    def position_low_pass(self) -> float | None:
        """Cutoff of the low-pass on positions [Hz]; None for none."""
        return _hertz(self.position_cutoff, POSITION_CUTOFF)

    @property
    def row_low_pass(self) -> float | None:
        """Cutoff of the low-pass on rows [Hz]; None for none."""
        return _hertz(self.cutoff, ROW_CUTOFF)

    def fitted(self, rate: float) -> Settings:
        """The same with filters that fit a recording.

        Args:
            rate: Samples a second [Hz].
        """
        rows = self.cutoff
        if rows == FIT:
            rows = min(
                ROW_CUTOFF, SLOWEST_ROWS * rate, (self.position_low_pass or np.inf) / 2
            )
        positions: Cutoff | None = self.position_cutoff
        if positions == FIT:
            positions = POSITION_CUTOFF if rate / 2 > POSITION_CUTOFF else "off"
        return replace(self, cutoff=rows, position_cutoff=positions)

    def with_unknowns(self, names: str | Sequence[str]) -> Settings:
        """The same with other unknowns besides the bodies' parameters.

        Args:
            names: Errors of the plate, by the names of faults or nuisances; laws of the joints'
                torques. Of a kind that is not named, those of the settings stay.

        Raises:
            UnknownName: There is no such error and no such law.
        """
        listed, known = [names] if isinstance(names, str) else names, terms()
        errors = dict.fromkeys(known[name] for name in listed if name in known)
        laws = tuple(name for name in listed if name not in known)
        try:
            return replace(
                self,
                nuisances=tuple(errors) or self.nuisances,
                terms=laws or self.terms,
            )
        except UnknownName as error:
            raise UnknownName("term", error.name, (*known, *error.known)) from None

    @property
    def laws(self) -> tuple[JointLaw, ...]:
        """The terms as laws of the joints' torque."""
        return tuple(dict.fromkeys(law_of(term) for term in self.words))

    @property
    def words(self) -> tuple[str | JointLaw, ...]:
        """The terms: "rotor" of all joints, "rotor/elbow" of one."""
        if self.terms is None or isinstance(self.terms, str):
            return USUAL
        return tuple(self.terms)

    @property
    def facts(self) -> dict[str, tuple[float, float]]:
        """Value and sigma of what is known, by name."""
        return with_sigmas(self.known)


def _hertz(cutoff: Cutoff | None, fit: float) -> float | None:
    if cutoff == FIT:
        return fit
    return None if cutoff is None or isinstance(cutoff, str) else cutoff


DEFAULTS = Settings()
"""What is used unless somebody asks otherwise."""
