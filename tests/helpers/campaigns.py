"""Campaigns whose runs cost next to nothing."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from testbed.campaigns.campaign import Campaign
from testbed.campaigns.conduct import CampaignRun
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
        f'set = [{listed}]\nmethods = ["wrench"]\nreplicates = {replicates}\n{more}\n{factors}\n'
    )
    return path


NOISES = """
[[factor]]
name = "noise"
set = ["measurement.force_noise=$", "measurement.moment_noise=$*0.2"]
values = [0.5, 2.0]
"""

TRUTH, SIGMA = np.array([1.0, -2.0]), np.array([0.1, 0.3])


def made_up(campaign: Campaign, place: CampaignRun) -> dict[str, Any]:
    """Row that only the hash of a run decides; no simulation."""
    values = TRUTH + SIGMA * np.random.default_rng(int(place.digest, 16)).normal(size=2)
    columns = zip("ab", TRUTH, values, SIGMA, (values - TRUTH) / TRUTH, strict=True)
    names = ("parameter", "truth", "value", "sigma", "relative_error")
    return {
        "run": place.digest,
        "status": "done",
        "error": "",
        "command": campaign.command(place.cell, place.replicate),
        "seed": campaign.tables.seed + place.replicate,
        "metric/wrench_rms_relative_error": float(np.abs(values - TRUTH).max()),
        "estimates": [{"method": "wrench"} | dict(zip(names, row, strict=True)) for row in columns],
    }
