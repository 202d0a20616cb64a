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
    """Classes of all sensor errors, the last stage of the measuring chain first.

    Within a stage, errors of the wrench come before errors of tare, torques and positions; then by
    kind. The classes include abstract ones, which cannot be simulated.
    """

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
    """Sensor errors with coefficients, by term, in the order of their correction."""
    errors_with_coefficients = (
        e for e in sensor_errors() if issubclass(e, SystematicError)
    )
    return {
        e.term: e
        for e in cast(Iterator[type[SystematicError]], errors_with_coefficients)
    }


def estimable_errors() -> tuple[type[SystematicError], ...]:
    """Systematic errors whose coefficients can be unknowns of an estimate (`estimated`)."""
    return tuple(e for e in systematic_errors().values() if e.estimated)


def candidate_errors() -> tuple[type[SystematicError], ...]:
    """Systematic errors for which the residuals of every estimate are tested (`tested`)."""
    return tuple(e for e in systematic_errors().values() if e.tested)


def terms_by_name() -> Mapping[str, str]:
    """Terms that can be estimated, by the names of kinds and by the terms.

    A kind that is estimated by a more general term (`estimated_as`) has that term.
    """
    by_kind = {e.kind: e.estimated_as or e.term for e in systematic_errors().values()}
    estimable_terms = {e.term: e.term for e in estimable_errors()}
    return {
        name: term
        for name, term in (by_kind | estimable_terms).items()
        if term in estimable_terms
    }


def term_by_name(name: str) -> str:
    """Term of a sensor error among the unknowns of an estimate.

    Args:
        name: Name of the kind or of the term, as "plate_bias" or "bias".

    Raises:
        UnknownName: No sensor error of that name can be estimated.
    """
    known = terms_by_name()
    if name not in known:
        raise UnknownName("nuisance", name, known)
    return known[name]


def coefficients_by_error(
    tree: Tree, values: Mapping[str, float]
) -> Mapping[type[SystematicError], list[float]]:
    """Values of the coefficients by sensor error, neutral where not given.

    Of errors that can be estimated; sensor errors without a given coefficient are left out.

    Args:
        tree: The robot.
        values: Values by coefficient name, as "pose/rx".

    Returns:
        Values in the order of the error's `coefficients`, by class.

    Raises:
        UnknownName: No sensor error has such a coefficient.
    """
    coefficients = {e: e.coefficients(tree) for e in estimable_errors()}
    known = [
        coefficient.name
        for error_coefficients in coefficients.values()
        for coefficient in error_coefficients
    ]
    for name in values:
        if name not in known:
            raise UnknownName("nuisance", name, known)
    return {
        error: [
            values.get(coefficient.name, coefficient.neutral)
            for coefficient in error_coefficients
        ]
        for error, error_coefficients in coefficients.items()
        if any(coefficient.name in values for coefficient in error_coefficients)
    }
