"""What laws are tried on, by Hypothesis: robots, motions, recordings, settings, wrong numbers.

The suite draws few, the same each time; with `HYPOTHESIS_PROFILE=nightly` there are many.
"""

from __future__ import annotations

import os
from typing import Any

import hypothesis
import numpy as np
from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy

import testbed as tb
from tests.helpers.measured import measured
from tests.helpers.robots import Robot, random_robot, random_states, with_zeros


def few(examples: int) -> hypothesis.settings:
    """So many examples of a law that is dear; in the nightly run times more, as of all laws.

    Args:
        examples: In the suite.
    """
    times = 5 if os.environ.get("HYPOTHESIS_PROFILE") == "nightly" else 1
    return hypothesis.settings(max_examples=times * examples)


seeds: SearchStrategy[int] = st.integers(0, 2**32 - 1)
"""Of a random generator; what is drawn from it is of general position."""

Rng = np.random.Generator

rngs: SearchStrategy[Rng] = seeds.map(np.random.default_rng)
"""Random generators."""


@st.composite
def robots(draw: st.DrawFn, joints: tuple[int, int] = (1, 8), *, bare: bool = False) -> Robot:
    """Random robots, each as URDF, MJCF and tree, under any gravity.

    Args:
        draw: Hypothesis'.
        joints: Fewest and most.
        bare: With bodies of which much is exactly zero.
    """
    rng = draw(rngs)
    gravity = draw(st.sampled_from([(0.0, 0.0, -9.81), (3.0, -4.0, 8.0), (0.0, 0.0, 0.0)]))
    found = random_robot(rng, draw(st.integers(*joints)), gravity=gravity)
    return with_zeros(rng, found) if bare else found


def trees(joints: tuple[int, int] = (1, 8), *, bare: bool = False) -> SearchStrategy[tb.Tree]:
    """Random trees; as `robots`."""
    return robots(joints, bare=bare).map(Robot.tree)


def motions(tree: tb.Tree, samples: int = 10) -> SearchStrategy[tb.Motion]:
    """Random states of a robot, one after the other."""
    return rngs.map(
        lambda rng: tb.Motion(np.arange(samples, dtype=float), *random_states(rng, samples, tree.n))
    )


@st.composite
def recordings(
    draw: st.DrawFn, joints: tuple[int, int] = (1, 4), duration: float = 4.0
) -> tuple[tb.Tree, tb.Recording]:
    """A random robot on its plate and what a noisy instrument records of it at 100 Hz."""
    tree = random_robot(draw(rngs), draw(st.integers(*joints))).tree()
    return tree, measured(tree, draw(seeds), duration=duration, rate=100.0)


settings: SearchStrategy[tb.Settings] = st.builds(
    tb.Settings,
    cutoff=st.sampled_from(["off", 5.0, 10.0]),
    position_cutoff=st.sampled_from(["off", 20.0, 40.0]),
    zeros=st.booleans(),
    deadband=st.sampled_from([0.0, 0.05]),
)
"""How signals may be treated."""

wrong_numbers: SearchStrategy[Any] = st.sampled_from(
    [float("nan"), float("inf"), -float("inf"), -1.0, True, None, "text", "", [], {}, [1.0], 1j]
)
"""What is no positive number."""
