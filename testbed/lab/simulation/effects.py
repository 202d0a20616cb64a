"""All kinds of effects in the plant, and an effect of the table that an experiment file has."""

from __future__ import annotations

from collections.abc import Mapping

from testbed.core.base.errors import SettingsError, UnknownName
from testbed.lab.kind_table import of_table
from testbed.lab.simulation.bodies import CompliantPlate, GearedRotor, Payload, Tilt
from testbed.lab.simulation.effect import Effect
from testbed.lab.simulation.joint_friction import (
    AsymmetricFriction,
    LoadFriction,
    LuGreFriction,
    PowerFriction,
    Stribeck,
    WarmingDrives,
)

EFFECTS: tuple[type[Effect], ...] = (
    Stribeck,
    PowerFriction,
    AsymmetricFriction,
    LoadFriction,
    WarmingDrives,
    LuGreFriction,
    GearedRotor,
    Payload,
    CompliantPlate,
    Tilt,
)

KINDS: Mapping[str, type[Effect]] = {effect.kind: effect for effect in EFFECTS}
"""Every effect that an experiment file can ask for, by kind."""


def effect_of(table: object) -> Effect:
    """An effect of its table.

    Args:
        table: `kind` and the kind's own keys; an effect is returned as it is.

    Raises:
        SettingsError: The kind or a key is not known, or a value is none that it takes.
    """
    if isinstance(table, Effect):
        return table
    return of_table(table, "an effect", "stribeck_friction", effect_named)


def effect_named(kind: str) -> type[Effect]:
    """The effects of a kind.

    Args:
        kind: Its name.

    Raises:
        SettingsError: There is none.
    """
    if kind not in KINDS:
        raise SettingsError(f"{UnknownName('kind of effect', kind, KINDS)}; see `testbed list`")
    return KINDS[kind]
