"""Validation of an estimate on another recording."""

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
    """Validate an estimate on a recording that was not used to make it.

    Args:
        estimate: Estimate returned by `identify`.
        data: Another recording of the same robot and sensors.
        settings: Filters applied to the recording's signals; default those of the estimate.

    Returns:
        Residuals on the recording for each channel, and their expected size.

    Raises:
        RecordingError: The recording cannot be used for the estimate's signal.
        SettingsError: `estimate` is not an `Estimate`.
    """
    if not isinstance(estimate, Estimate):
        raise SettingsError(
            "validate(estimate, data): the estimate is one of `identify`, a "
            f"{type(estimate).__name__} was given in its place"
        )
    return validate_robot(estimate.minimal.robot, data, estimate, settings=settings)
