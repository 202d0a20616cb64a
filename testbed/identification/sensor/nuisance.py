"""An unknown of the instrument: how it shows in the wrench, and how it is taken back.

To add one, write a `Nuisance` in a file of this folder and put it into the catalogue.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from testbed.arrays import Array
from testbed.codec import named
from testbed.identification.sensor.predicted_wrench import PredictedWrench
from testbed.recordings.recording import Recording
from testbed.robot.tree import Tree


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

Undo = Callable[[Recording, Array, Array], Recording]
"""A recording as it would be without: of a recording, the nuisance's numbers, (k,), and the
samples' times from the middle of the whole recording, (M,) [s]."""


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
        passing: Whether it is of one recording only, so that another has its own.
        covers: Other kinds whose effects are among this one's; they are simpler.
        whole: Whether it is of no use unless all its numbers are identifiable; they are near what
            the parameters do, and their columns have to be exact.
        added: Whether its columns are what it adds to the plate's channels as they are, before
            any mixture of them is taken back.
        unmixed: What takes its mixture of the channels back; None where it mixes none.
    """

    kind: str
    parts: Numbers
    columns: Effect
    undo: Undo | None = None
    by_measured: Effect | None = None
    passing: bool = False
    covers: tuple[str, ...] = ()
    whole: bool = False
    added: bool = False
    unmixed: Unmix | None = None

    __get_pydantic_core_schema__ = named(lambda nuisance: nuisance.kind)
