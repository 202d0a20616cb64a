"""Validate an estimate on a recording that it has not seen."""

from __future__ import annotations

from pathlib import Path

from testbed.applications.validate import Validation
from testbed.applications.validate import validate as validate_robot
from testbed.core.base.errors import SettingsError
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.settings import Settings
from testbed.core.recordings.recording import Recording


def validate(
    estimate: Estimate, data: Recording | str | Path, settings: Settings | None = None
) -> Validation:
    """What an estimate leaves of a recording that it has not seen.

    Args:
        estimate: Of `identify`.
        data: Another recording of the same robot and sensors.
        settings: How its signals are treated; default as those of the estimate.

    Raises:
        RecordingError: The recording cannot be used for the estimate's signal.
    """
    if not isinstance(estimate, Estimate):
        raise SettingsError(
            "validate(estimate, data): the estimate is one of `identify`, a "
            f"{type(estimate).__name__} was given in its place"
        )
    return validate_robot(estimate.minimal.robot, data, estimate, settings=settings)
