"""Catalogue of the families: every class in `families`, and sensors' errors."""

from __future__ import annotations

import inspect
from functools import cache
from importlib import import_module
from pkgutil import iter_modules

from testbed.core.estimation.model_errors import families
from testbed.core.estimation.model_errors.family import ModelErrorFamily
from testbed.core.estimation.model_errors.sensor_family import SensorFamily
from testbed.sensors.catalogue import candidate_errors


def model_error_families() -> tuple[ModelErrorFamily, ...]:
    """All families, those of sensors last."""
    return (*_own_families(), *(SensorFamily(error) for error in candidate_errors()))


@cache
def _own_families() -> tuple[ModelErrorFamily, ...]:
    """Families of the modules."""
    classes = [
        value
        for module in iter_modules(families.__path__, f"{families.__name__}.")
        for _, value in inspect.getmembers(import_module(module.name), inspect.isclass)
        if issubclass(value, ModelErrorFamily) and not inspect.isabstract(value)
    ]
    return tuple(each() for each in dict.fromkeys(classes))
