"""Catalogue of effects in the plant, and their construction from tables."""

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
from testbed.sensors.kind_reader import value_from_table

EFFECT_KINDS: Mapping[str, type[Effect]] = {
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
"""Classes of effects that an experiment file can configure, by kind."""


def effect_from_table(table: object) -> Effect:
    """Build an effect from its table in an experiment file.

    Args:
        table: Table with `kind` and the keys of this kind; an `Effect` is returned unchanged.

    Raises:
        SettingsError: The kind or a key is unknown, or a value is not allowed.
    """
    return value_from_table(table, "effect", EFFECT_KINDS)
