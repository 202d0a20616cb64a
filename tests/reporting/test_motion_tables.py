"""A designed motion on the terminal."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from testbed.arrays import Array
from testbed.excitation.proof import Margin, Proof
from testbed.parameters.minimal_set import minimal_set
from testbed.reporting.motion_tables import print_excitation
from tests.helpers.console import printed
from tests.helpers.runs import ROBOTS, robot


def numbers(count: int) -> Array:
    """Sigma, its share of the value, and that of another motion, (3, count)."""
    return 10 ** np.random.default_rng(0).uniform(-6, 2, (3, count))


def told(
    names: list[str],
    margins: list[Margin],
    columns: int,
    *,
    everything: bool = True,
    **changed: Any,
) -> str:
    """What is said of a design that promises random numbers."""
    sigma, relative, other = numbers(len(names))
    design = {
        "motion": SimpleNamespace(harmonics=5, fundamental=0.1),
        "searches": (1, 2),
        "complete": True,
        "proof": Proof(tuple(margins), 1000, 0),
    }
    found: Any = SimpleNamespace(
        predicted=SimpleNamespace(
            names=names, sigma=sigma, relative=relative, rms=1.0, condition=1.0
        ),
        random_predicted=SimpleNamespace(relative=other, rms=2.0),
        beside_random="2.00 times smaller than that of the best of 40 random motions (2)",
        design=SimpleNamespace(**design | changed),
    )
    return printed(
        columns,
        lambda out: print_excitation(out, found, Path("motion.toml"), everything=everything),
    )


@pytest.mark.parametrize("columns", [60, 72, 80, 110, 140])
@pytest.mark.parametrize("name", ROBOTS)
def test_no_number_of_a_design_is_cut_or_broken(name: str, columns: int) -> None:
    tree, rng = robot(name), np.random.default_rng(1)
    names = minimal_set(tree, "reaction").names
    sigma, relative, other = numbers(len(names))
    margins = [
        Margin(f"{what} of '{joint}'", float(rng.normal()), float(rng.uniform(0, 100)))
        for what in ("velocity", "acceleration", "effort")
        for joint in tree.names
    ]
    said = told(list(names), margins, columns)
    assert "…" not in said
    lines = [set(line.split()) for line in said.splitlines()]
    for k, parameter in enumerate(names):
        row = {parameter, f"{sigma[k]:.2g}", f"{relative[k]:.2%}", f"{other[k]:.2%}"}
        assert any(row <= line for line in lines), parameter
    assert {"limit", "on", "left", "at", "t", "[s]"} in lines


ROOM = Margin("velocity of 'a'", 0.25, 1.5)
NONE = Margin("velocity of 'b'", -0.125, 2.5)


def test_searches_that_were_stopped_are_said() -> None:
    assert "stopped before they ended" not in told(["I1"], [ROOM], 100)
    assert "the best of 2 searches (stopped before they ended)" in told(
        ["I1"], [ROOM], 100, complete=False
    )
    assert "one search" in told(["I1"], [ROOM], 100, searches=(1,))


def test_a_motion_is_proven_or_it_is_said_what_is_not() -> None:
    assert "proven at every moment: 1 limit" in told(["I1"], [ROOM], 100)
    said = told(["I1"], [ROOM, NONE], 100)
    assert "proven at every moment" not in said
    assert f"NOT proven: 1 of 2 limits; {NONE.words}" in " ".join(said.split())
    table = [line.split() for line in said.splitlines() if "velocity of" in line]
    assert table[0][-2:] == ["-12.50%", "2.500"]  # what fails comes first
    assert table[1][-2:] == ["25.00%", "1.500"]


def test_what_is_known_least_and_left_least_is_shown_first_and_the_rest_counted() -> None:
    margins = [Margin(f"effort of '{k}'", 0.1 * k, 0.0) for k in range(1, 16)]
    names = [f"I{k}" for k in range(40)]
    said = told(names, margins, 100, everything=False)
    shown = [
        line.split()[0]
        for line in said.splitlines()
        if line.split()[:1] and line.split()[0] in names
    ]
    relative = dict(zip(names, numbers(len(names))[1], strict=True))
    assert shown == sorted(names, key=lambda name: -relative[name])[:10]
    assert "(30 more" in said
    assert "(3 more limits" in said
    assert "effort of '12'" in said
    assert "effort of '13'" not in said
    every = told(names, margins, 100)
    assert "more" not in every
    assert "effort of '15'" in every
