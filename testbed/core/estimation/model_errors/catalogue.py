"""Catalogue of model error families: classes in `families`, and systematic sensor errors."""

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
    """Instances of every family of model errors; families of sensor errors come last."""
    return (*_module_families(), *(SensorFamily(error) for error in candidate_errors()))


@cache
def _module_families() -> tuple[ModelErrorFamily, ...]:
    """Instances of the concrete families in the modules of `families`, in order of module names."""
    classes = [
        value
        for module in iter_modules(families.__path__, f"{families.__name__}.")
        for _, value in inspect.getmembers(import_module(module.name), inspect.isclass)
        if issubclass(value, ModelErrorFamily) and not inspect.isabstract(value)
    ]
    return tuple(each() for each in dict.fromkeys(classes))
