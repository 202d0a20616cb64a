"""Constant error of the plate's tare."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from testbed.core.robot.tree import Tree
from testbed.sensors.errors.plate_bias import PlateBias
from testbed.sensors.systematic_error import Coefficient, channel_coefficients


@dataclass(frozen=True)
class PlateTare(PlateBias):
    """Constant wrench in addition to the stated tare, in all recordings with the pedestal.

    For a plate that does not move, this error is equivalent to a bias.

    Source    Our own choice: the same size as the bias.

    Attributes:
        force: Additional force [N].
        moment: Additional moment [N m].
    """

    kind: ClassVar[str] = "plate_tare"
    term: ClassVar[str] = "tare"
    fixed: ClassVar[tuple[Coefficient, ...]] = channel_coefficients("tare")
    of_one_recording: ClassVar[bool] = False

    @classmethod
    def coefficients(cls, tree: Tree) -> tuple[Coefficient, ...]:
        """Coefficients of the constant wrench, one per channel of the plate, (6,)."""
        del tree
        return cls.fixed
