"""How small errors are: beside what the plate's noise allows, and beside those without a fault.

The instrument has the noise of table6; every seed is another motion and other noise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

import testbed as tb
from benchmarks.bounds import least
from benchmarks.random_recordings import ROBOTS, recorded
from testbed.arrays import Array
from testbed.identification.estimate import Estimate
from testbed.instruments.encoders import EncoderZeroError
from testbed.instruments.fault import Fault
from testbed.instruments.plate import PlateOriginHeight, PlatePose
from testbed.instruments.plate_clock import PlateAntiAliasFilter, PlateDelay
from testbed.instruments.plate_noise import PlateBias, PlateDrift

REDRAWN = 4000
"""Times that seeds are drawn again for an interval."""

UNDECIDED = 0.5
"""Weight of the answer with constants below which they count as not estimated."""

REMEDIES: Mapping[str, tuple[tuple[Fault, ...], tuple[str, ...]]] = {
    "bias": ((PlateBias(),), ("bias",)),
    "drift": ((PlateDrift(),), ("bias", "slope")),
    "pose": ((PlatePose(rotation=3.5e-3, translation=1e-3),), ("pose",)),
    "height": ((PlateOriginHeight(),), ("height",)),
    "skew 1 ms": ((PlateDelay(delay=1e-3),), ("skew",)),
    "filter 100 Hz": ((PlateAntiAliasFilter(cutoff=100.0),), ("skew",)),
    "joint zeros": ((EncoderZeroError(),), ("joint_zeros",)),
    "pose, skew and bias": (
        (
            PlateBias(),
            PlatePose(rotation=3.5e-3, translation=1e-3),
            PlateDelay(delay=1e-3),
        ),
        ("pose", "skew", "bias"),
    ),
}
"""Faults, and the nuisances that cure them."""


def efficiency(robot: str, first: int, runs: int, seconds: float) -> dict[str, Any]:
    """Rms of errors over the Cramer-Rao bound of the plate's white noise, columns exact.

    Args:
        robot: One of ROBOTS.
        first: The first seed.
        runs: How many.
        seconds: Duration of every recording.
    """
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


def remedied(fault: str, motion: str, first: int, runs: int, seconds: float) -> dict[str, Any]:
    """Errors of the PUMA's nine with a fault and its nuisances, and without either.

    Beside them is what the nuisances cost whoever estimates them: the Cramer-Rao bound with
    them over that without. No estimate that is right on average has a smaller ratio.

    Args:
        fault: One of REMEDIES.
        motion: One of MOTIONS.
        first: The first seed.
        runs: How many.
        seconds: Duration of every recording.
    """
    tree = tb.load_tree(ROBOTS["puma"])
    faults, nuisances = REMEDIES[fault]
    found: dict[str, list[float]] = {"clean": [], "faulty": [], "remedied": []}
    bounds: dict[str, list[float]] = {"clean": [], "remedied": []}
    for seed in range(first, first + runs):
        for name, wrong, asked in (
            ("clean", (), ()),
            ("faulty", faults, ()),
            ("remedied", faults, nuisances),
        ):
            settings = tb.Settings(zeros=True, nuisances=asked)
            recording = recorded(tree, motion, "white", seconds, seed, wrong)
            estimate = tb.identify(tree, recording, settings=settings)
            found[name].append(_of_nine(tree, estimate, _error(tree, estimate)))
            if name in bounds:
                spread = least(tree, estimate.minimal, motion, seconds, seed, asked)
                bounds[name].append(_of_nine(tree, estimate, spread))
    rms = {name: _rms(each) for name, each in found.items()}
    cost = _rms(bounds["remedied"]) / _rms(bounds["clean"])
    return {
        "fault": fault,
        "motion": motion,
        "seconds": seconds,
        "runs": runs,
        "seeds": f"{first} to {first + runs - 1}",
        **{name: float(f"{value:.3g}") for name, value in rms.items()},
        "ratio": round(rms["remedied"] / rms["clean"], 3),
        "interval": [round(x, 3) for x in _interval(found["remedied"], found["clean"])],
        "bound": float(f"{_rms(bounds['remedied']):.3g}"),
        "ratio_of_bounds": round(cost, 3),
        "over_bound": round(rms["remedied"] / _rms(bounds["remedied"]), 3),
    }


def _of_nine(tree: tb.Tree, estimate: Estimate, error: Array) -> float:
    """Rms of the first nine as shares of their values."""
    return _rms((error / estimate.minimal.values(tb.barycentric(tree)))[:9])


def _rms(values: Sequence[float] | Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _interval(above: Sequence[float], below: Sequence[float]) -> tuple[float, float]:
    """Of the ratio of two rms over the same seeds, 95 %: seeds are drawn again, in pairs."""
    drawn = np.random.default_rng(0).integers(0, len(above), (REDRAWN, len(above)))
    ratio = [_rms(np.take(above, pick)) / _rms(np.take(below, pick)) for pick in drawn]
    low, high = np.quantile(ratio, [0.025, 0.975])
    return float(low), float(high)


def _error(tree: tb.Tree, estimate: Estimate) -> Array:
    return np.asarray(estimate.values - estimate.minimal.values(tb.barycentric(tree)))
