"""What an estimate says of the instrument."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

from testbed.core.base.arrays import Array
from testbed.core.base.codec import named
from testbed.core.estimation.sensor.predicted_wrench import PredictedWrench
from testbed.core.recordings.recording import Recording
from testbed.core.robot.tree import Tree

NEARLY = 0.6
"""Part of what a cause explains that a simpler one among it has to explain to be named first."""


@dataclass(frozen=True)
class NuisanceEstimate:
    """One number of the instrument that was estimated with the parameters.

    Attributes:
        kind: Of the nuisance.
        name: Such as "pose/rx".
        unit: Its unit.
        value: What the instrument adds or does.
        sigma: Its standard deviation.
    """

    kind: str
    name: str
    unit: str
    value: float
    sigma: float


@dataclass(frozen=True)
class TraceTest:
    """Whether residuals hold what one kind of fault of the instrument would leave.

    Attributes:
        nuisance: The kind.
        chance: Probability of residuals like these where the model holds.
        clearness: How much it explains beyond what its numbers alone would, by Akaike's
            criterion.
        names: Of its numbers.
        units: One each.
        size: What they would be if it were the only fault.
        shift: By how many sigma the parameter moves that moves most if it is estimated.
        parameter: Which one that is.
        alone: The one number that explains nearly as much, and what it would be; None if none does.
    """

    nuisance: Nuisance
    chance: float
    clearness: float
    names: tuple[str, ...]
    units: tuple[str, ...]
    size: tuple[float, ...]
    shift: float
    parameter: str
    alone: NuisanceEstimate | None = None

    def largest(self, count: int) -> list[str]:
        """The fault's largest numbers in words, so many of each unit; or the one that explains it.

        Args:
            count: How many.
        """
        one = self.alone
        if one is not None:
            return [f"{one.name} {one.value:.3g} +- {one.sigma:.2g} {one.unit}".rstrip()]
        numbers = sorted(
            zip(self.names, self.units, self.size, strict=True), key=lambda n: -abs(n[2])
        )
        phrases = []
        for unit in dict.fromkeys(self.units):
            own = [(name, size) for name, own_unit, size in numbers if own_unit == unit]
            phrases += [f"{name} {size:.3g} {unit}".rstrip() for name, size in own[:count]]
        return phrases


def in_order(tests: Iterable[TraceTest]) -> tuple[TraceTest, ...]:
    """The clearest first; one that holds a simpler one after it, if that does nearly as well.

    Args:
        tests: Of all kinds.
    """
    every = tuple(tests)
    clearness = {test.nuisance.kind: test.clearness for test in every}

    def rank(test: TraceTest) -> tuple[float, int]:
        own = test.clearness
        held = [clearness.get(kind, 0.0) for kind in test.nuisance.covers]
        nearly = [other for other in held if other > NEARLY * own > 0]
        return -min([own, *nearly]), len(nearly)

    return tuple(sorted(every, key=rank))


class Part(NamedTuple):
    """One number of a nuisance.

    Attributes:
        name: Such as "pose/rx".
        unit: Its unit.
        right: Its value where nothing is wrong.
    """

    name: str
    unit: str
    right: float = 0.0


Numbers = Callable[[Tree], tuple[Part, ...]]
"""The numbers of a nuisance, for a robot."""


def always(*parts: Part) -> Numbers:
    """The same numbers for every robot.

    Args:
        parts: The numbers.
    """
    return lambda tree: parts


Effect = Callable[[PredictedWrench], Array]
"""What the measured wrench grows by with each of them, (rows, 6, k)."""

Undo = Callable[[Recording, Array, Array, Tree], Recording]
"""A recording as it would be without: of a recording, the nuisance's numbers, (k,), the samples'
times from the middle of the whole recording, (M,) [s], and the robot."""

Unmix = Callable[[Array], Array]
"""What takes a mixture of the channels back, (6, 6), of the nuisance's numbers, (k,)."""


@dataclass(frozen=True)
class Nuisance:
    """One kind of unknown of the instrument.

    Attributes:
        kind: Its name in `identification.nuisances`.
        parts: Its numbers, for a robot.
        columns: How much the measured wrench grows with each of them, to first order,
            (rows, 6, k).
        undo: What takes it back exactly; None where it can only be tested for.
        by_measured: The columns made of the measured wrench instead of the predicted one. Noise of
            the encoders is in the predicted one and in what is to be explained, and makes weakly
            identifiable numbers drift; noise of the plate is in neither twice.
        tested: Whether its traces are looked for in every estimate. Those of a drift are not: slow
            noise looks alike.
        beside: Another kind that is not asked for without this one; "" for none.
        passing: Whether it is of one recording only, so that another has its own.
        covers: Other kinds whose effects are among this one's; they are simpler.
        whole: Whether it is of no use unless all its numbers are identifiable; they are near what
            the parameters do, and their columns have to be exact.
        added: Whether its columns are what it adds to the plate's channels as they are, before
            any mixture of them is taken back.
        unmixed: What takes its mixture of the channels back; None where it mixes none.
        of_encoders: Whether it spoils estimates by torques as well.
        unfolded: Whether its columns are made at so many instants that the encoders' noise is not
            folded. Of all kinds an error that does not last would have too much in common with
            that noise in the rows.
    """

    kind: str
    parts: Numbers
    columns: Effect
    undo: Undo | None = None
    by_measured: Effect | None = None
    tested: bool = False
    beside: str = ""
    passing: bool = False
    covers: tuple[str, ...] = ()
    whole: bool = False
    added: bool = False
    unmixed: Unmix | None = None
    of_encoders: bool = False
    unfolded: bool = False

    __get_pydantic_core_schema__ = named(lambda nuisance: nuisance.kind)


def of_wrench(change: Callable[[Array, Array, Array], Array]) -> Undo:
    """Undo by a function of the wrench, the numbers, and time.

    Args:
        change: Makes the wrench without, (M, 6), of that which was measured, (M, 6).
    """

    def undo(recording: Recording, values: Array, time: Array, tree: Tree) -> Recording:
        del tree
        return replace(recording, wrench=change(recording.measured("wrench"), values, time))

    return undo
