"""What is known of a plate, as a file: TOML that a person can read and change."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict

from testbed.arrays import Array
from testbed.errors import ExperimentError
from testbed.experiment.versions import versions
from testbed.files import replacing
from testbed.identification.calibration import Calibration
from testbed.identification.sensor.catalogue import NUISANCES
from testbed.identification.sensor.estimates import NuisanceEstimate
from testbed.robot.tree import Tree
from testbed.toml_text import Finite, checked, read_toml

_HEAD = """\
# A plate, calibrated by the motion of the robot on it (testbed {version}, calibrate).
# It shows C w + bias of a wrench w, skew seconds late: gain/Fx is C's element of Fx by Fx,
# crosstalk/Fx/Fz that of Fx by Fz. Numbers that are not here are as they should be.
"""


class _Number(BaseModel):
    model_config = ConfigDict(frozen=True, strict=True, extra="forbid")
    value: Finite
    sigma: Finite = 0.0
    unit: str = ""


class _Plate(BaseModel):
    model_config = ConfigDict(frozen=True, strict=True, extra="forbid")
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
    lines = [_HEAD.format(version=versions()["testbed"]), f"robot = {json.dumps(plate.robot)}"]
    lines += ["", "[known]  # before: value, sigma"]
    lines += [f"{json.dumps(name)} = [{v!r}, {s!r}]" for name, (v, s) in plate.known.items()]
    lines += ["", "[numbers]"]
    for each in plate.numbers:
        unit = f", unit = {json.dumps(each.unit)}" if each.unit else ""
        number = f"{{ value = {each.value!r}, sigma = {each.sigma!r}{unit} }}"
        lines.append(f"{json.dumps(each.name)} = {number}")
    if plate.correlation is not None:
        head = "correlation = [  # of the numbers, in their order, up to the diagonal"
        rows = [
            ", ".join(f"{value:.5g}" for value in row[: k + 1])
            for k, row in enumerate(plate.correlation.tolist())
        ]
        lines[1:1] = [head, *(f"  [{row}]," for row in rows), "]"]
    with replacing(path) as fresh:
        fresh.write_text("\n".join(lines) + "\n", encoding="utf-8")


def read_plate(path: Path, tree: Tree) -> Calibration:
    """A plate's numbers.

    Args:
        path: A file that `write_plate` wrote, or one of the same form.
        tree: The robot on it.

    Raises:
        ExperimentError: It is no such file.
    """
    found = checked(_Plate, read_toml(path, "plate"), str(path))
    kinds = {part.name: n.kind for n in NUISANCES for part in n.parts(tree)}
    numbers = tuple(
        NuisanceEstimate(kinds.get(name, name), name, each.unit, each.value, each.sigma)
        for name, each in found.numbers.items()
    )
    return Calibration(
        found.robot,
        found.known,
        numbers,
        correlation=_correlation(found.correlation, numbers, path),
    )


def _correlation(
    rows: list[list[float]], numbers: tuple[NuisanceEstimate, ...], path: Path
) -> Array | None:
    """Of its lower triangle; None where the file has none.

    Raises:
        ExperimentError: It is no correlation of these numbers.
    """
    if not rows:
        return None
    count = len(numbers)
    found = np.eye(count)
    fits = [len(row) for row in rows] == list(range(1, count + 1))
    if fits:
        for k, row in enumerate(rows):
            found[k, : k + 1] = found[: k + 1, k] = row
    if not fits or np.abs(found).max() > 1 or (np.diagonal(found) != 1).any():
        raise ExperimentError(
            f"{path}: correlation is the lower triangle of {count} rows, ones at their ends, "
            "nothing beyond one; leave it out for independent numbers"
        )
    return found
