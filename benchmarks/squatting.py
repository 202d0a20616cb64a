"""How far estimates of a humanoid on a base that moves are from the truth, in sigmas."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any

import numpy as np
import typer
from scipy import stats

import testbed as tb
from benchmarks.lines import print_lines
from testbed.core.base.arrays import Array
from testbed.core.recordings.views import on_its_base
from testbed.core.robot.force_sensor import ForceSensor, beyond_sensor
from testbed.core.robot.free_root import on_free_base
from testbed.core.robot.model_file import ModelFile
from tests.helpers.humanoid import G1, humanoid


def scores(first: int, runs: int, noise: float = 1.0, joint: str = "") -> Iterator[dict[str, Any]]:
    """A line a recording of 40 s at 50 Hz, then all of them beside normal errors."""
    every = []
    for seed in range(first, first + runs):
        tree, recording = humanoid(40.0, 50.0, seed, noise, joint)
        free = on_free_base(tree)
        if joint:
            sensor = ForceSensor(tree.joints[tree.index(joint)].body)
            free = beyond_sensor(free, ModelFile(G1, weld_root=True).links(), sensor)
        found = tb.identify(free, on_its_base(recording, free))
        z = (found.values - found.minimal.values(tb.barycentric(free))) / found.sigma
        every.append(z)
        yield {"seed": seed, **_summary(z)}
    largest = [float(np.abs(z).max()) for z in every]
    count, half = len(every[0]), (0.5, 0.95)
    normal = [float(stats.norm.isf((1 - share ** (1 / count)) / 2)) for share in half]
    yield {
        "runs": runs,
        **_summary(np.concatenate(every)),
        "normal_within_3": float(1 - 2 * stats.norm.sf(3)),
        "median_largest": round(float(np.median(largest)), 2),
        "normal_median_largest": round(normal[0], 2),
        "normal_largest_95": round(normal[1], 2),
    }


def _summary(z: Array) -> dict[str, Any]:
    return {
        "parameters": len(z),
        "rms_z": round(float(np.sqrt(np.mean(z**2))), 3),
        "within_3": round(float(np.mean(np.abs(z) <= 3)), 4),
        "within_1.96": round(float(np.mean(np.abs(z) <= 1.96)), 4),
        "largest": round(float(np.abs(z).max()), 2),
    }


def main(
    runs: Annotated[int, typer.Option(min=1, help="Recordings of 40 s at 50 Hz.")] = 12,
    first: Annotated[int, typer.Option(help="The first seed, of motion and noise.")] = 7200,
    noise: Annotated[float, typer.Option(help="Times that of the instruments.")] = 1.0,
    joint: Annotated[
        str, typer.Option(help="In the air, with a force sensor at it, e.g. left_hip_yaw_joint.")
    ] = "",
) -> None:
    """Errors in sigmas of a humanoid on plates with a measured pose, beside normal ones."""
    print_lines(scores(first, runs, noise, joint))
