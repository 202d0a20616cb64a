"""Read and write a force plate's calibration as a TOML file, for `--plate`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import tomli_w
from pydantic import BaseModel

from testbed.applications.calibration import Calibration
from testbed.core.base.arrays import Array
from testbed.core.base.errors import ExperimentError
from testbed.core.base.installation import installed_version
from testbed.core.base.toml_text import STRICT_TABLE, Finite, read_toml, validate_tables
from testbed.core.base.whole_files import write_atomically
from testbed.core.estimation.sensor.estimates import NuisanceEstimate
from testbed.core.robot.tree import Tree
from testbed.lab.experiment.robot_tables import StrictTable
from testbed.sensors.catalogue import estimable_errors

_HEADER = """\
# A plate, calibrated by the motion of the robot on it (testbed {version}, calibrate).
# It shows C w + bias of a wrench w, skew seconds late: gain/Fx is C's element of Fx by Fx,
# crosstalk/Fx/Fz that of Fx by Fz. Numbers that are not here are as they should be.
# known: value and sigma before; correlation: of the numbers, in their order.
"""


class _CoefficientTable(StrictTable):
    """Calibrated coefficient with standard deviation and unit."""

    value: Finite
    sigma: Finite = 0.0
    unit: str = ""


class _CalibrationTable(BaseModel):
    """Content of a calibration file."""

    model_config = STRICT_TABLE
    robot: str = ""
    known: dict[str, tuple[Finite, Finite]] = {}
    numbers: dict[str, _CoefficientTable]
    correlation: list[list[Finite]] = []


def write_calibration(plate: Calibration, path: Path) -> None:
    """Write the calibration of a force plate as TOML: coefficients, known values, correlations.

    Args:
        plate: Calibration.
        path: Output; an existing file is replaced.
    """
    numbers = {
        n.name: _CoefficientTable(value=n.value, sigma=n.sigma, unit=n.unit)
        for n in plate.numbers
    }
    rows = [] if plate.correlation is None else plate.correlation.tolist()
    known = dict(plate.known)
    content = _CalibrationTable(
        robot=plate.robot, known=known, numbers=numbers, correlation=rows
    )
    text = _HEADER.format(version=installed_version()) + tomli_w.dumps(
        content.model_dump(mode="json")
    )
    write_atomically(path, text)


def read_calibration(path: Path, tree: Tree) -> Calibration:
    """Read the calibration of a force plate.

    Args:
        path: File written by `write_calibration`, or a file of the same form.
        tree: Robot on the plate; it determines which coefficients exist.

    Raises:
        ExperimentError: The file is not a valid calibration.
    """
    content = validate_tables(
        _CalibrationTable, read_toml(path, "plate's calibration"), str(path)
    )
    terms = {
        c.name: error.term
        for error in estimable_errors()
        for c in error.coefficients(tree)
    }
    numbers = tuple(
        NuisanceEstimate(terms.get(name, name), name, each.unit, each.value, each.sigma)
        for name, each in content.numbers.items()
    )
    correlation = _correlation_matrix(content.correlation, len(numbers), path)
    return Calibration(content.robot, content.known, numbers, correlation=correlation)


def _correlation_matrix(
    rows: list[list[float]], count: int, path: Path
) -> Array | None:
    """Correlation matrix of the k coefficients, (k, k); None if the file has none.

    Raises:
        ExperimentError: The matrix is not a correlation of k coefficients.
    """
    if not rows:
        return None
    is_square = [len(row) for row in rows] == [count] * count
    matrix = np.array(rows) if is_square else np.zeros((0, 0))
    if not is_square or np.abs(matrix).max() > 1 or not np.allclose(matrix, matrix.T):
        raise ExperimentError(
            f"{path}: correlation is a symmetric matrix of {count} rows with nothing beyond one; "
            "leave it out for independent numbers"
        )
    return matrix
