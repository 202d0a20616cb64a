"""Campaigns whose runs cost next to nothing, and engines that go other ways."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from testbed.campaigns.bundle import Bundle, Outcome, carry_out_bundle
from testbed.campaigns.cluster import Work
from testbed.campaigns.conduct import Answers, Supply
from tests.helpers.paths import ROOT

QUICK = (
    "motion.duration=1.5",
    "motion.candidates=1",
    "simulation.warm_up=0.2",
    "simulation.step=1e-3",
    "excitation.clearance=off",
    "measurement.torque_constant_error={}",
    "identification.engine=numpy",
)
"""Words of a run of a tenth of a second."""


def campaign_file(
    folder: Path, replicates: int = 3, factors: str = "", more: str = "", words: Iterable[str] = ()
) -> Path:
    """A campaign of quick runs of the PUMA.

    Args:
        folder: Where to write it.
        replicates: Of each cell.
        factors: Tables of factors, and others.
        more: Keys before the tables.
        words: Besides QUICK.
    """
    listed = ",\n".join(repr(word) for word in (*QUICK, *words))
    path = folder / "quick.toml"
    path.write_text(
        f'name = "quick"\nexperiment = "{ROOT / "experiments/table6.toml"}"\n'
        f'set = [{listed}]\nmethods = ["external"]\nreplicates = {replicates}\n{more}\n{factors}\n'
    )
    return path


NOISES = """
[[factor]]
name = "noise"
set = ["measurement.force_noise=$", "measurement.moment_noise=$*0.2"]
values = [0.5, 2.0]
"""


def made_up(bundle: Bundle) -> tuple[list[Outcome], float]:
    """Outcomes that only the hash of a run decides; no simulation."""
    found = []
    for run, _ in bundle.runs:
        rng = np.random.default_rng(int(run, 16))
        truth, sigma = np.array([1.0, -2.0]), np.array([0.1, 0.3])
        values = truth + sigma * rng.normal(size=2)
        estimate = {
            "names": ["a", "b"],
            "truth": truth.tolist(),
            "values": values.tolist(),
            "sigma": sigma.tolist(),
            "relative_error": ((values - truth) / truth).tolist(),
        }
        error = float(np.abs(values - truth).max())
        metrics = {"external_rms_relative_error": error}
        found.append(Outcome(run, "done", metrics=metrics, estimates={"external": estimate}))
    return found, 0.01 * len(found)


class Odd:
    """Bundles of another size, in another order, by other work."""

    def __init__(self, work: Work = made_up, size: int | None = None, seed: int = 0) -> None:
        """Nothing asked for yet.

        Args:
            work: What is done with a bundle.
            size: Runs of a bundle; default as they are handed out.
            seed: Of the order.
        """
        self.work, self.size, self.rng = work, size, np.random.default_rng(seed)
        self.asked: list[str] = []

    def answers(self, supply: Supply) -> Answers:
        """Outcomes of all that a supply hands out, in an order of our own."""
        bundles = []
        while (bundle := supply.take(3)) is not None:
            size = self.size or len(bundle.runs)
            for first in range(0, len(bundle.runs), size):
                part = bundle.runs[first : first + size]
                bundles.append(replace(bundle, runs=part))
        for k in self.rng.permutation(len(bundles)):
            self.asked += [run for run, _ in bundles[k].runs]
            yield self.work(bundles[k])


real = carry_out_bundle
"""The work itself."""
