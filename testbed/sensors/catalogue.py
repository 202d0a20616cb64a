"""Catalogue of sensor errors: all classes in the modules of `testbed/sensors/errors`."""

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
    """Classes of all sensor errors, beginning with the last stage of the measuring chain.

    Within a stage, errors are sorted by signal (wrench, tare, torques, positions) and then by kind.
    The classes include abstract classes, which cannot be simulated.
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
    """Sensor errors that can be simulated, keyed by kind, in measuring chain order."""
    return {e.kind: e for e in reversed(sensor_errors()) if not inspect.isabstract(e)}


@cache
def systematic_errors() -> Mapping[str, type[SystematicError]]:
    """Sensor errors with coefficients, keyed by term, in the order of their correction."""
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
    """Terms that can be estimated, keyed by the names of kinds and of terms.

    A kind that is estimated through a more general term (`estimated_as`) is mapped to that term.
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
        name: Name of the kind or of the term, such as "plate_bias" or "bias".

    Raises:
        UnknownName: No sensor error of this name can be estimated.
    """
    known = terms_by_name()
    if name not in known:
        raise UnknownName("nuisance", name, known)
    return known[name]


def coefficients_by_error(
    tree: Tree, values: Mapping[str, float]
) -> Mapping[type[SystematicError], list[float]]:
    """Values of the coefficients, keyed by sensor error; missing values are neutral.

    The result contains the errors that can be estimated and that have at least one given value.

    Args:
        tree: The robot.
        values: Values keyed by coefficient name, such as "pose/rx".

    Returns:
        Values in the order of the error's `coefficients`, keyed by class.

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
