"""What estimating a fault of the instrument brings: the error of an instrument without it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache

import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.experiment.score import relative_errors
from testbed.identification.estimate import Estimate
from testbed.identification.nuisances.all_nuisances import NUISANCES
from testbed.instruments.encoders import EncoderZeroError
from testbed.instruments.fault import Fault
from testbed.instruments.plate import PlateOriginHeight, PlatePose
from testbed.instruments.plate_clock import PlateDelay
from testbed.instruments.plate_noise import PlateBias, PlateDrift
from testbed.recordings.recording import Recording
from tests.helpers.faulty import clean, with_faults
from tests.helpers.runs import ROBOTS, robot

pytestmark = pytest.mark.slow

SEEDS = range(3)
KINDS = {nuisance.kind: nuisance for nuisance in NUISANCES}

SIZES: Mapping[str, Callable[[int], Array]] = {
    "bias": lambda n: np.array([2.0, -2.0, 2.0, 0.5, 0.5, -0.5]),
    "slope": lambda n: np.array([0.05, -0.05, 0.05, 0.01, 0.01, -0.01]),
    "pose": lambda n: np.array([3.5e-3, -3.5e-3, 3.5e-3, 1e-3, 1e-3, -1e-3]),
    "height": lambda n: np.array([5e-3]),
    "skew": lambda n: np.array([1e-3]),
    "joint_zeros": lambda n: np.asarray(3.5e-3 * (-1.0) ** np.arange(n), dtype=np.float64),
}
"""Usual sizes (docs/instruments.md), in the order of the nuisances' numbers."""

FAULTS: Mapping[str, Callable[[Sequence[float]], Fault]] = {
    "bias": lambda v: PlateBias(force=tuple(v[:3]), moment=tuple(v[3:])),
    "slope": lambda v: PlateDrift(force=tuple(v[:3]), moment=tuple(v[3:])),
    "pose": lambda v: PlatePose(rotation=tuple(v[:3]), translation=tuple(v[3:])),
    "height": lambda v: PlateOriginHeight(height=v[0]),
    "skew": lambda v: PlateDelay(delay=v[0]),
    "joint_zeros": lambda v: EncoderZeroError(error=tuple(v)),
}


def identified(name: str, recording: Recording, *kinds: str) -> Estimate:
    """By the plate; the PUMA's zeros are known, as in table6."""
    settings = tb.Settings(zeros=name == "puma", nuisances=kinds)
    return tb.identify(robot(name), recording, settings=settings)


@cache
def recorded(name: str, seed: int, duration: float, rate: float) -> Recording:
    return clean(robot(name), seed, duration=duration, rate=rate)


@cache
def told(name: str, *kinds: str) -> frozenset[str]:
    """Numbers of the instrument that a robot's motion can tell at all."""
    found = identified(name, recorded(name, 0, 20.0, 250.0).blind(), *kinds)
    return frozenset(each.name for each in found.nuisances)


def truths(name: str, *kinds: str) -> dict[str, float]:
    """Numbers of usual faults; those that no motion tells are right."""
    tree = robot(name)
    found: dict[str, float] = {}
    for kind in kinds:
        names = [part.name for part in KINDS[kind].parts(tree)]
        sizes = SIZES[kind](tree.n).tolist()
        found |= {n: s * (n in told(name, *kinds)) for n, s in zip(names, sizes, strict=True)}
    return found


def error(name: str, estimate: Estimate) -> float:
    """Rms relative error; apart from the total mass, which a constant may hide."""
    base = estimate.base
    true = estimate.minimal.values(tb.barycentric(robot(name)))
    relative = relative_errors(base.values, true, base.units)
    seen = [not n.startswith("mbar") for n in base.names]
    return float(np.sqrt(np.nanmean(relative[seen] ** 2)))


@cache
def clean_errors(name: str, seeds: range, duration: float, rate: float) -> Array:
    return np.array(
        [
            error(name, identified(name, recorded(name, seed, duration, rate).blind()))
            for seed in seeds
        ]
    )


def remedied(
    name: str, kinds: Sequence[str], seeds: range, duration: float, rate: float
) -> tuple[Array, Array]:
    """Errors once the faults are estimated, and errors of the faults' numbers in sigmas."""
    true = truths(name, *kinds)
    faults = [
        FAULTS[kind]([v for n, v in true.items() if n.split("/")[0] == kind]) for kind in kinds
    ]
    errors, scores = [], []
    for seed in seeds:
        faulty = with_faults(recorded(name, seed, duration, rate), seed, *faults)
        estimate = identified(name, faulty, *kinds)
        errors.append(error(name, estimate))
        scores += [(n.value - true[n.name]) / n.sigma for n in estimate.nuisances]
    return np.array(errors), np.array(scores)


@pytest.mark.parametrize("kind", ["bias", "pose", "height", "skew", "joint_zeros"])
def test_an_estimated_fault_is_as_good_as_none(kind: str) -> None:
    """On the PUMA, over three motions; the fault's own numbers are found within four sigma."""
    errors, scores = remedied("puma", [kind], SEEDS, 20.0, 250.0)
    usual = clean_errors("puma", SEEDS, 20.0, 250.0)
    assert np.sqrt(np.mean(errors**2)) <= 1.3 * np.sqrt(np.mean(usual**2))
    assert np.abs(scores).max() < 4.0


@pytest.mark.parametrize("kind", ["bias", "pose", "height", "skew", "joint_zeros"])
@pytest.mark.parametrize("name", ROBOTS)
def test_what_a_fault_costs_is_counted_or_said(name: str, kind: str) -> None:
    """Robots whose parameters show nearly the same as a fault are less certain, and told so."""
    true = truths(name, kind)
    sizes = [v for n, v in true.items() if n.split("/")[0] == kind]
    minimal = tb.minimal_set(robot(name), "reaction", zeros=name == "puma")
    for seed in SEEDS:
        faulty = with_faults(recorded(name, seed, 20.0, 250.0), seed, FAULTS[kind](sizes))
        found = identified(name, faulty, kind)
        if any(w.startswith("hardly told") for w in found.warnings):
            continue
        assert all(abs(n.value - true[n.name]) < 4.5 * n.sigma for n in found.nuisances)
        gap = found.base.values - minimal.values(tb.barycentric(robot(name)))
        assert np.sqrt(np.mean((gap / found.base.sigma) ** 2)) < 1.8


def test_what_is_hardly_told_is_named() -> None:
    """Three slides show what a shift of the plate shows, but for their accelerations."""
    faulty = with_faults(recorded("gantry", 0, 20.0, 250.0), 0)
    said = [w for w in identified("gantry", faulty, "pose").warnings if w.startswith("hardly told")]
    assert len(said) == 1
    assert "pose/px, pose/py, pose/pz" in said[0]
    assert not any("hardly" in w for w in identified("puma", faulty_puma(), "pose").warnings)


def faulty_puma() -> Recording:
    return with_faults(recorded("puma", 0, 20.0, 250.0), 0)


@pytest.mark.parametrize("name", ROBOTS)
def test_a_drift_is_found(name: str) -> None:
    """A slope from the middle of the recording, and the constant that this leaves."""
    kinds, end = ("bias", "slope"), 20.0
    known = told(name, *kinds)
    rates = {n: v * (n in known) for n, v in truths(name, "slope").items()}
    middle = (end - 1 / 250.0) / 2
    true = rates | {n.replace("slope", "bias"): middle * v for n, v in rates.items()}
    errors = []
    for seed in SEEDS:
        fault = FAULTS["slope"](list(rates.values()))
        estimate = identified(
            name, with_faults(recorded(name, seed, end, 250.0), seed, fault), *kinds
        )
        errors.append(error(name, estimate))
        assert all(abs(n.value - true[n.name]) < 4 * n.sigma for n in estimate.nuisances)
    usual = clean_errors(name, SEEDS, end, 250.0)
    assert np.sqrt(np.mean(np.square(errors))) <= 1.3 * np.sqrt(np.mean(usual**2))


def test_three_faults_at_once_cost_little() -> None:
    """Median over five motions: what they cost scatters from motion to motion."""
    seeds, kinds = range(5), ["pose", "skew", "bias"]
    errors, scores = remedied("puma", kinds, seeds, 20.0, 250.0)
    assert np.median(errors / clean_errors("puma", seeds, 20.0, 250.0)) <= 1.15
    assert np.abs(scores).max() < 4.0
