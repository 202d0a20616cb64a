"""All kinds of effects in the plant, and an effect of the table that an experiment file has."""

from __future__ import annotations

from collections.abc import Mapping

from testbed.lab.simulation.bodies import CompliantPlate, GearedRotor, Payload, Tilt
from testbed.lab.simulation.effect import Effect
from testbed.lab.simulation.joint_friction import (
    FrictionTerm,
    LoadFriction,
    LuGreFriction,
    Stribeck,
    WarmingDrives,
)
from testbed.sensors.kind_reader import of_table

KINDS: Mapping[str, type[Effect]] = {
    effect.kind: effect
    for effect in (
        Stribeck,
        FrictionTerm,
        LoadFriction,
        WarmingDrives,
        LuGreFriction,
        GearedRotor,
        Payload,
        CompliantPlate,
        Tilt,
    )
}
"""Every effect that an experiment file can ask for, by kind."""


def effect_of(table: object) -> Effect:
    """An effect of its table.

    Args:
        table: `kind` and the kind's own keys; an effect is returned as it is.

    Raises:
        SettingsError: The kind or a key is not known, or a value is none that it takes.
    """
    return of_table(table, "effect", KINDS)
