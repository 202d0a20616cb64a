"""One file adds one sensor error: simulated, estimated, tested for, proposed, taken back, listed.

If one fails, an error of a sensor has to be written down in more than one place.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import testbed as tb
from testbed.core.base.arrays import Array
from testbed.importing.check.assessment import assess_recording
from testbed.sensors import catalogue, errors
from testbed.sensors.kind_reader import sensor_error_from_table
from testbed.sensors.kinds_in_words import describe_kind
from testbed.sensors.sensor_error import SensorError
from tests.helpers.foreign_files import imported, npz, some_log
from tests.helpers.measured import measured
from tests.helpers.runs import robot

KIND, RATE = "plate_gain_drift", 1e-2
CLASS = '''
from dataclasses import dataclass
from typing import Annotated, ClassVar

from testbed.sensors.kind_table import RANDOM_SIGN, PerChannel
from testbed.sensors.sensor_error import StageOrder
from testbed.sensors.systematic_error import PlateError, channel_coefficients


@dataclass(frozen=True)
class PlateGainDrift(PlateError):
    """Sensitivities that drift in proportion to time.

    Source    A test.

    Attributes:
        rate: Relative [1/s].
    """

    kind: ClassVar[str] = "plate_gain_drift"
    fixed: ClassVar = channel_coefficients("plate_gain_drift", ["1/s"] * 6)
    stage: ClassVar[StageOrder] = StageOrder.SENSOR
    rate: Annotated[PerChannel, RANDOM_SIGN] = 1e-3

    @classmethod
    def effect(cls, signal, time, values):
        return signal * (1 + time[:, None] * values)
'''


@pytest.fixture
def drift(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[type[SensorError]]:
    """The error, in a module of its own."""
    (tmp_path / f"{KIND}.py").write_text(CLASS)
    monkeypatch.setattr(errors, "__path__", [*errors.__path__, str(tmp_path)])
    importlib.invalidate_caches()
    cached = (catalogue.sensor_errors, catalogue.simulated_errors, catalogue.systematic_errors)
    for each in cached:
        each.cache_clear()
    yield catalogue.simulated_errors()[KIND]
    for each in cached:
        each.cache_clear()


def centred(time: Array) -> Array:
    return np.asarray((time - time.mean())[:, None])


def test_one_file_adds_one_error_everywhere(drift: type[SensorError], tmp_path: Path) -> None:
    """Witness: the recording is spoilt here, channel by channel, without the class."""
    tree, fx = robot("puma"), np.eye(6)[0]
    good = measured(tree, 3, duration=20.0)
    wrench, time = good.measured("wrench"), good.time
    bad = replace(good, wrench=wrench * (1 + RATE * centred(time) * fx))
    table = {"kind": KIND, "rate": [RATE, 0, 0, 0, 0, 0]}
    shown = sensor_error_from_table(table).apply(wrench, time, np.random.default_rng(0))
    np.testing.assert_allclose(shown, wrench * (1 + RATE * time[:, None] * fx), rtol=1e-14)
    plain = tb.identify(tree, bad)
    assert KIND in {each.family for each in plain.model_errors}
    found = tb.identify(tree, bad, terms=[KIND])
    number = {each.name: each for each in found.nuisances}[f"{KIND}/Fx"]
    assert abs(number.value - RATE) < 4 * number.sigma < 0.1 * RATE
    proposed = [
        each
        for each in assess_recording(tree, bad).diagnostics
        if each.code == "plate.sensor-error"
    ]
    assert [each.causes for each in proposed] == [(KIND,)]
    assert f'[errors] "{KIND}/Fx" = ' in proposed[0].remedy
    assert not any(
        each.code == "plate.sensor-error" for each in assess_recording(tree, good).diagnostics
    )
    assert describe_kind(drift).summary.startswith("Sensitivities that drift")
    # simulated from time 0, proposed from the middle on, relative to the gain there
    late = replace(good, wrench=wrench * (1 + RATE * time[:, None] * np.eye(6)[2]))
    line = next(
        d.remedy for d in assess_recording(tree, late).diagnostics if d.code == "plate.sensor-error"
    )
    value = float(line.partition('/Fz" = ')[2].partition(",")[0])
    gain = 1 + RATE * time.mean()
    assert value == pytest.approx(RATE / gain, rel=0.005)
    back = wrench * (1 + RATE * time[:, None] * np.eye(6)[2]) / (1 + value * centred(time))
    again = assess_recording(
        tree, replace(good, wrench=np.where(np.eye(6)[2], back / gain, wrench))
    )
    assert not any(each.code.startswith("plate.") for each in again.diagnostics)
    log = some_log()
    text = f'errors = {{ "{KIND}/Fx" = 0.1 }}\n' + npz(tmp_path, log)
    back = imported(tmp_path, text)
    wanted = log.w / (1 + 0.1 * centred(back.time) * fx)
    np.testing.assert_allclose(back.measured("wrench"), wanted, rtol=1e-11)
