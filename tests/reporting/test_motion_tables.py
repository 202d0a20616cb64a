"""A designed motion on the terminal."""

from __future__ import annotations

from io import StringIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from testbed.excitation.proof import Margin, Proof
from testbed.parameters.minimal_set import minimal_set
from testbed.reporting.motion_tables import print_excitation
from tests.helpers.runs import ROBOTS, robot


@pytest.mark.parametrize("columns", [60, 72, 80, 110, 140])
@pytest.mark.parametrize("name", ROBOTS)
def test_no_number_of_a_design_is_cut_or_broken(name: str, columns: int) -> None:
    tree, rng = robot(name), np.random.default_rng(0)
    names = minimal_set(tree, "reaction").names
    sigma, relative, other = 10 ** rng.uniform(-6, 2, (3, len(names)))
    margins = [
        Margin(f"{what} of '{joint}'", float(rng.normal()), float(rng.uniform(0, 100)))
        for what in ("velocity", "acceleration", "effort")
        for joint in tree.names
    ]
    found: Any = SimpleNamespace(
        predicted=SimpleNamespace(
            names=names, sigma=sigma, relative=relative, rms=1.0, condition=1.0
        ),
        random_predicted=SimpleNamespace(relative=other, rms=2.0),
        beside_random="2.00 times smaller than that of the best of 40 random motions (2)",
        design=SimpleNamespace(
            motion=SimpleNamespace(harmonics=5, fundamental=0.1),
            searches=(1, 2),
            complete=True,
            proof=Proof(tuple(margins), 1000, 0),
        ),
    )
    console = Console(markup=False, width=columns, record=True, file=StringIO())
    print_excitation(console, found, Path("motion.toml"))
    said = console.export_text()
    assert "…" not in said
    lines = [set(line.split()) for line in said.splitlines()]
    for k, parameter in enumerate(names):
        row = {parameter, f"{sigma[k]:.2g}", f"{relative[k]:.2%}", f"{other[k]:.2%}"}
        assert any(row <= line for line in lines), parameter
    assert {"limit", "on", "left", "at", "t", "[s]"} in lines
