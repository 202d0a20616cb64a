"""The motion that a recording shows, whatever its length."""

from __future__ import annotations

import numpy as np

from testbed.dynamics.motion import Motion
from testbed.errors import RecordingError
from testbed.identification.predict import motion_in
from testbed.identification.settings import Settings
from testbed.recordings.recording import Recording


def shown_motion(recording: Recording, settings: Settings) -> tuple[Motion, slice]:
    """A recording's motion, and the samples it covers; unfiltered where filters do not fit.

    Args:
        recording: Two samples or more.
        settings: Whose filter on positions to use.
    """
    try:
        return motion_in(recording, settings)
    except RecordingError:
        step = 1 / recording.rate
        speed = np.gradient(recording.position, step, axis=0)
        rates = speed, np.gradient(speed, step, axis=0)
        return Motion(recording.time, recording.position, *rates), slice(0, recording.samples)
