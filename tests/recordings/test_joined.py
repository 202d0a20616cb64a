"""Recordings as one: what one of them lacks, none of them has."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from testbed.recordings.joined import Joined
from tests.helpers.measured import measured
from tests.helpers.runs import robot, without


def test_a_signal_that_one_part_lacks_is_in_none() -> None:
    tree = robot("puma")
    whole = measured(tree, 1, duration=1.0)
    both = Joined([whole, without(measured(tree, 2, duration=1.0), "torque")])
    assert "torque" not in both.signals
    for first, last in both.segments:
        part = both.part(first, last)
        assert part.torque is None
        assert part.wrench is not None


def test_parts_have_the_first_ones_tare() -> None:
    tree = robot("puma")
    parts = [measured(tree, seed, duration=1.0) for seed in (1, 2)]
    assert parts[1].tare is not None
    shift = np.arange(6.0)
    moved = replace(
        parts[1], tare=parts[1].tare + shift, wrench=parts[1].measured("wrench") + shift
    )
    plain, both = Joined(parts), Joined([parts[0], moved])
    for first, last in plain.segments:
        np.testing.assert_allclose(
            both.part(first, last).measured("wrench"),
            plain.part(first, last).measured("wrench"),
            atol=1e-9,
        )
