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

    To a plate that does not move it is the same as a bias.

    Source    Our own choice: as much as the bias.

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
        """Constants of the plate's channels, (6,)."""
        del tree
        return cls.fixed
