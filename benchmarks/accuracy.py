"""How small errors are: beside what the plate's noise allows, and beside those without a fault.

The instrument has the noise of table6; every seed is another motion and other noise.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any

import numpy as np
import typer

import testbed as tb
from benchmarks.bounds import least
from benchmarks.lines import print_lines
from benchmarks.random_recordings import MOTIONS, ROBOTS, recorded
from testbed.core.base.arrays import Array
from testbed.core.estimation.estimate import Estimate
from testbed.sensors.sensor_error import SensorError

REDRAWN = 4000
"""Times that seeds are drawn again for an interval."""

UNDECIDED = 0.5
"""Weight of the answer with constants below which they count as not estimated."""

REMEDIES: Mapping[str, tuple[tuple[SensorError, ...], tuple[str, ...]]] = {
    "bias": ((tb.PlateBias(),), ("bias",)),
    "drift": ((tb.PlateDrift(),), ("bias", "slope")),
    "pose": ((tb.PlatePose(rotation=3.5e-3, translation=1e-3),), ("pose",)),
    "height": ((tb.PlatePose(rotation=0.0, translation=(0.0, 0.0, 5e-3)),), ("height",)),
    "skew 1 ms": ((tb.PlateDelay(delay=1e-3),), ("skew",)),
    "filter 100 Hz": ((tb.PlateAntiAliasFilter(cutoff=100.0),), ("skew",)),
    "joint zeros": ((tb.EncoderZeroError(),), ("joint_zeros",)),
    "pose, skew and bias": (
        (
            tb.PlateBias(),
            tb.PlatePose(rotation=3.5e-3, translation=1e-3),
            tb.PlateDelay(delay=1e-3),
        ),
        ("pose", "skew", "bias"),
    ),
}
"""Faults, and the nuisances that cure them."""


def efficiency(robot: str, first: int, runs: int, seconds: float) -> dict[str, Any]:
    """Rms of errors over the Cramer-Rao bound of the plate's white noise, columns exact."""
    tree = tb.load_tree(ROBOTS[robot])
    settings = tb.Settings(zeros=robot == "puma")
    ratios, without = [], []
    for seed in range(first, first + runs):
        estimate = tb.identify(
            tree, recorded(tree, "default", "white", seconds, seed), settings=settings
        )
        bound = least(tree, estimate.minimal, "default", seconds, seed)
        ratios.append(_error(tree, estimate) / bound)
        assert estimate.noise is not None
        without.append(estimate.noise.bias_weight < UNDECIDED)
    squares = np.square(ratios)
    kept = squares[np.array(without)]
    return {
        "robot": robot,
        "seconds": seconds,
        "seeds": f"{first} to {first + runs - 1}",
        "over_bound": round(float(np.sqrt(squares.mean())), 3),
        "runs_without_constants": len(kept),
        "over_bound_without_constants": round(float(np.sqrt(kept.mean())), 3),
        "error_of_mean_square": round(float(kept.mean(axis=1).std() / np.sqrt(len(kept)) / 2), 3),
    }


def remedies(
    only: Sequence[str], motion: str, first: int, runs: int, seconds: float
) -> Iterator[dict[str, Any]]:
    """Errors of the PUMA's nine with a fault and its nuisances, and without either.

    Beside them is what the nuisances cost whoever estimates them: the Cramer-Rao bound with
    them over that without. No estimate that is right on average has a smaller ratio.
    """
    tree = tb.load_tree(ROBOTS["puma"])
    minimal = tb.minimal_set(tree, "wrench", zeros=True)
    truth = minimal.values(tb.barycentric(tree))

    def of_nine(errors: Array) -> float:
        return _rms((errors / truth)[:9])

    found: dict[str, list[tuple[float, ...]]] = {fault: [] for fault in only}
    for seed in range(first, first + runs):

        def error(faults: Sequence[SensorError], asked: Sequence[str], seed: int = seed) -> float:
            settings = tb.Settings(zeros=True, nuisances=asked)
            recording = recorded(tree, motion, "white", seconds, seed, faults)
            return of_nine(_error(tree, tb.identify(tree, recording, settings=settings)))

        def bound(asked: Sequence[str], seed: int = seed) -> float:
            return of_nine(least(tree, minimal, motion, seconds, seed, asked))

        clean = error((), ()), bound(())
        for fault, lines in found.items():
            faults, asked = REMEDIES[fault]
            lines.append((*clean, error(faults, ()), error(faults, asked), bound(asked)))
    for fault, lines in found.items():
        clean_, least_, faulty, remedied, allowed = np.array(lines).T
        yield {
            "fault": fault,
            "motion": motion,
            "seconds": seconds,
            "runs": runs,
            "seeds": f"{first} to {first + runs - 1}",
            "clean": _digits(_rms(clean_)),
            "faulty": _digits(_rms(faulty)),
            "remedied": _digits(_rms(remedied)),
            "median": _digits(float(np.median(remedied))),
            "ratio": round(_rms(remedied) / _rms(clean_), 3),
            "interval": _interval(remedied, clean_),
            "bound": _digits(_rms(allowed)),
            "ratio_of_bounds": round(_rms(allowed) / _rms(least_), 3),
            "over_bound": round(_rms(remedied) / _rms(allowed), 3),
        }


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _digits(value: float) -> float:
    return float(f"{value:.3g}")


def _interval(above: Array, below: Array) -> list[float]:
    """Of the ratio of two rms over the same seeds, 95 %: seeds are drawn again, in pairs."""
    drawn = np.random.default_rng(0).integers(0, len(above), (REDRAWN, len(above)))
    ratio = [_rms(above[pick]) / _rms(below[pick]) for pick in drawn]
    return [round(float(x), 3) for x in np.quantile(ratio, [0.025, 0.975])]


def _error(tree: tb.Tree, estimate: Estimate) -> Array:
    return np.asarray(estimate.values - estimate.minimal.values(tb.barycentric(tree)))


def main(
    runs: Annotated[int, typer.Option(min=2, help="Recordings of each kind.")] = 40,
    first: Annotated[int, typer.Option(help="The first seed.")] = 9000,
    seconds: Annotated[float, typer.Option(help="Duration of the recordings.")] = 60.0,
    only: Annotated[str, typer.Option(help="Only lines whose words hold this.")] = "",
    motion: Annotated[str, typer.Option(help="Of the remedies' lines.")] = "chosen",
) -> None:
    """Errors over the Cramer-Rao bound, and of remedies over those without a fault."""
    if motion not in MOTIONS:
        raise typer.BadParameter(f"{motion} is none of {', '.join(MOTIONS)}")
    robots = [robot for robot in ("puma", "ur5") if only in f"bound {robot}"]
    print_lines(efficiency(robot, first, runs, seconds) for robot in robots)
    asked = [fault for fault in REMEDIES if only in f"remedy {fault}"]
    if asked:
        print_lines(remedies(asked, motion, first, runs, seconds))
