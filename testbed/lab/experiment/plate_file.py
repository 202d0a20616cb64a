"""A plate's calibration as a TOML file, for `--plate`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import tomli_w
from pydantic import BaseModel

from testbed.applications.calibration import Calibration
from testbed.core.base.arrays import Array
from testbed.core.base.errors import ExperimentError
from testbed.core.base.installation import version
from testbed.core.base.toml_text import KNOWN_KEYS, Finite, checked, read_toml
from testbed.core.base.whole_files import write_whole
from testbed.core.estimation.sensor.estimates import NuisanceEstimate
from testbed.core.robot.tree import Tree
from testbed.lab.experiment.robot_tables import StrictTable
from testbed.sensors.catalogue import estimable_errors

_HEAD = """\
# A plate, calibrated by the motion of the robot on it (testbed {version}, calibrate).
# It shows C w + bias of a wrench w, skew seconds late: gain/Fx is C's element of Fx by Fx,
# crosstalk/Fx/Fz that of Fx by Fz. Numbers that are not here are as they should be.
# known: value and sigma before; correlation: of the numbers, in their order.
"""


class _Number(StrictTable):
    value: Finite
    sigma: Finite = 0.0
    unit: str = ""


class _Plate(BaseModel):
    model_config = KNOWN_KEYS
    robot: str = ""
    known: dict[str, tuple[Finite, Finite]] = {}
    numbers: dict[str, _Number]
    correlation: list[list[Finite]] = []


def write_plate(plate: Calibration, path: Path) -> None:
    """Write a plate's numbers.

    Args:
        plate: The calibration.
        path: The file; what stands there is replaced.
    """
    numbers = {
        n.name: _Number(value=n.value, sigma=n.sigma, unit=n.unit)
        for n in plate.numbers
    }
    rows = [] if plate.correlation is None else plate.correlation.tolist()
    known = dict(plate.known)
    content = _Plate(robot=plate.robot, known=known, numbers=numbers, correlation=rows)
    text = _HEAD.format(version=version()) + tomli_w.dumps(
        content.model_dump(mode="json")
    )
    write_whole(path, text)


def read_plate(path: Path, tree: Tree) -> Calibration:
    """A plate's numbers.

    Args:
        path: A file that `write_plate` wrote, or one of the same form.
        tree: The robot on it.

    Raises:
        ExperimentError: It is no such file.
    """
    found = checked(_Plate, read_toml(path, "plate's calibration"), str(path))
    terms = {
        c.name: error.term
        for error in estimable_errors()
        for c in error.coefficients(tree)
    }
    numbers = tuple(
        NuisanceEstimate(terms.get(name, name), name, each.unit, each.value, each.sigma)
        for name, each in found.numbers.items()
    )
    correlation = _correlation(found.correlation, len(numbers), path)
    return Calibration(found.robot, found.known, numbers, correlation=correlation)


def _correlation(rows: list[list[float]], count: int, path: Path) -> Array | None:
    """Of the numbers, (k, k); None where the file has none.

    Raises:
        ExperimentError: It is no correlation of these numbers.
    """
    if not rows:
        return None
    square = [len(row) for row in rows] == [count] * count
    found = np.array(rows) if square else np.zeros((0, 0))
    if not square or np.abs(found).max() > 1 or not np.allclose(found, found.T):
        raise ExperimentError(
            f"{path}: correlation is a symmetric matrix of {count} rows with nothing beyond one; "
            "leave it out for independent numbers"
        )
    return found
