"""Catalogue of sensor errors: every class in a module of `testbed/sensors/errors`."""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Mapping
from functools import cache
from importlib import import_module
from pkgutil import iter_modules
from typing import cast

from testbed.core.base.errors import UnknownName
from testbed.core.robot.tree import Tree
from testbed.sensors import errors
from testbed.sensors.sensor_error import SensorError
from testbed.sensors.systematic_error import SystematicError


@cache
def sensor_errors() -> tuple[type[SensorError], ...]:
    """All sensor errors, the last stage of a measuring chain first, encoders' after the plate's."""

    def classes() -> Iterator[type[SensorError]]:
        for module in iter_modules(errors.__path__, f"{errors.__name__}."):
            for _, value in inspect.getmembers(
                import_module(module.name), inspect.isclass
            ):
                if issubclass(value, SensorError) and value.__module__ == module.name:
                    yield value

    signals = ("wrench", "tare", "torque", "position")
    return tuple(
        sorted(classes(), key=lambda e: (-e.stage, signals.index(e.signal), e.kind))
    )


@cache
def simulated_errors() -> Mapping[str, type[SensorError]]:
    """Sensor errors that can be simulated, by kind, in the order of the measuring chain."""
    return {e.kind: e for e in reversed(sensor_errors()) if not inspect.isabstract(e)}


@cache
def systematic_errors() -> Mapping[str, type[SystematicError]]:
    """Sensor errors with coefficients, by term, in the order in which they are taken back."""
    every = (e for e in sensor_errors() if issubclass(e, SystematicError))
    return {e.term: e for e in cast(Iterator[type[SystematicError]], every)}


def estimable_errors() -> tuple[type[SystematicError], ...]:
    """Systematic errors whose coefficients an estimate may have among its unknowns."""
    return tuple(e for e in systematic_errors().values() if e.estimated)


def candidate_errors() -> tuple[type[SystematicError], ...]:
    """Systematic errors that every estimate tests its residuals for."""
    return tuple(e for e in systematic_errors().values() if e.tested)


def terms() -> Mapping[str, str]:
    """Terms that can be estimated, by the names of kinds and by themselves."""
    by_kind = {e.kind: e.estimated_as or e.term for e in systematic_errors().values()}
    own = {e.term: e.term for e in estimable_errors()}
    return {name: term for name, term in (by_kind | own).items() if term in own}


def term_of(name: str) -> str:
    """Term of a sensor error.

    Args:
        name: Of the kind or of the term, as "plate_bias" or "bias".

    Raises:
        UnknownName: No sensor error of that name can be estimated.
    """
    known = terms()
    if name not in known:
        raise UnknownName("nuisance", name, known)
    return known[name]


def errors_of(
    tree: Tree, names: Mapping[str, float]
) -> Mapping[type[SystematicError], list[float]]:
    """Values of the coefficients of sensor errors, those that are not named neutral.

    Args:
        tree: The robot.
        names: Values by names of coefficients, as "pose/rx".

    Raises:
        UnknownName: No sensor error has such a coefficient.
    """
    coefficients = {e: e.coefficients(tree) for e in estimable_errors()}
    known = [each.name for own in coefficients.values() for each in own]
    for name in names:
        if name not in known:
            raise UnknownName("nuisance", name, known)
    return {
        error: [names.get(each.name, each.neutral) for each in own]
        for error, own in coefficients.items()
        if any(each.name in names for each in own)
    }
