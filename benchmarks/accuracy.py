"""How small errors are: beside what the plate's noise allows, and beside those without a fault.

Motions are random ones with the noise of table6; every seed is another motion and other noise.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

import testbed as tb
from benchmarks.random_recordings import PLATE, ROBOTS, happened, recorded
from testbed.arrays import Array
from testbed.dynamics.inverse_dynamics import linear
from testbed.dynamics.motion import Motion
from testbed.identification.estimate import Estimate
from testbed.instruments.encoders import EncoderZeroError
from testbed.instruments.fault import Fault
from testbed.instruments.plate import PlateOriginHeight, PlatePose
from testbed.instruments.plate_clock import PlateAntiAliasFilter, PlateDelay
from testbed.instruments.plate_noise import PlateBias, PlateDrift

EVERY = 10
"""Samples of which one is looked at for the least error: motions are slow beside 1 kHz."""

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
        ratios.append(_error(tree, estimate) / _least(tree, estimate, seconds, seed))
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


def remedied(fault: str, first: int, runs: int, seconds: float) -> dict[str, Any]:
    """Errors of the PUMA's nine with a fault and its nuisances, and without either.

    Args:
        fault: One of REMEDIES.
        first: The first seed.
        runs: How many.
        seconds: Duration of every recording.
    """
    tree = tb.load_tree(ROBOTS["puma"])
    faults, nuisances = REMEDIES[fault]
    found: dict[str, list[float]] = {"clean": [], "faulty": [], "remedied": []}
    for seed in range(first, first + runs):
        for name, wrong, asked in (
            ("clean", (), ()),
            ("faulty", faults, ()),
            ("remedied", faults, nuisances),
        ):
            settings = tb.Settings(zeros=True, nuisances=asked)
            recording = recorded(tree, "default", "white", seconds, seed, wrong)
            estimate = tb.identify(tree, recording, settings=settings)
            error = _error(tree, estimate) / estimate.minimal.values(tb.barycentric(tree))
            found[name].append(float(np.sqrt(np.mean(np.square(error[:9])))))
    rms = {name: float(np.sqrt(np.mean(np.square(each)))) for name, each in found.items()}
    return {
        "fault": fault,
        "seconds": seconds,
        "runs": runs,
        "seeds": f"{first} to {first + runs - 1}",
        **{name: float(f"{value:.3g}") for name, value in rms.items()},
        "ratio": round(rms["remedied"] / rms["clean"], 2),
    }


def _error(tree: tb.Tree, estimate: Estimate) -> Array:
    return np.asarray(estimate.values - estimate.minimal.values(tb.barycentric(tree)))


def _least(tree: tb.Tree, estimate: Estimate, seconds: float, seed: int) -> Array:
    """Standard deviations that no unbiased estimate falls below."""
    time, truth, _ = happened(tree, "default", seconds, seed)
    part = slice(None, None, EVERY)
    assert truth.velocity is not None
    assert truth.acceleration is not None
    motion = Motion(
        time[part], truth.position[part], truth.velocity[part], truth.acceleration[part]
    )
    lift = estimate.minimal.lift.reshape(tree.n, 10, -1)
    columns = linear(tree, motion, lift, tree.gravity)[1]
    sigma = np.repeat([PLATE.force_noise, PLATE.moment_noise], 3)
    rows = (columns / sigma[:, None]).reshape(-1, columns.shape[2])
    return np.asarray(np.sqrt(np.diagonal(np.linalg.inv(EVERY * rows.T @ rows))))
