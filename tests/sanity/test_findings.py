"""What is found of torques' sizes and of positions, in words and with its cure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from testbed.sanity.cure_words import gain_finding, position_finding
from testbed.sanity.sanity import check_sanity
from tests.helpers.measured import measured
from tests.helpers.runs import robot

SCALE = np.repeat([1.0, 0.1], 3)
"""Of forces and moments among each other [1, m]."""


@pytest.mark.parametrize(
    ("unit", "smaller"), [("N m", "N mm"), ("A", "mA"), ("V", "mV"), ("kN m", "N m")]
)
def test_torques_a_thousand_times_too_large_are_in_the_smaller_unit(
    unit: str, smaller: str
) -> None:
    tree = robot("puma")
    sizes = np.array([1010.0, np.nan, 980.0])
    found = gain_finding(tree, sizes, 0.2, 5.0, {"torque": {"unit": unit}})
    assert found.remedy == f'in the mapping: [torque] unit = "{smaller}"'
    assert "the torque is too large" in found.text
    assert "waist 1e+03, elbow 9.8e+02" in found.text
    assert "a unit such as N mm" in found.text
    assert found.number == 1010.0


@pytest.mark.parametrize(("size", "unit"), [(40.0, "N m"), (1000.0, "in lbf"), (2500.0, "N m")])
def test_torques_of_other_sizes_are_in_no_unit_that_is_known(size: float, unit: str) -> None:
    found = gain_finding(robot("puma"), np.full(3, size), 0.2, 5.0, {"torque": {"unit": unit}})
    assert found.remedy == "in the mapping: [torque] unit"


def test_small_torques_are_a_motors_or_currents() -> None:
    """Those that are right are not named; what cannot be told needs no gear."""
    sizes = np.array([0.01, 1.1, np.nan])
    found = gain_finding(robot("puma"), sizes, 0.2, 5.0, {})
    assert "the torque is too small" in found.text
    assert "waist 0.01" in found.text
    assert "shoulder" not in found.text
    assert "torques on the motors' side of the gears, or currents taken for torques" in found.text
    numbers = "[100, 0.90909, 0]"
    assert f'(ratio about {numbers}), or unit = "A" with gain about {numbers}' in found.remedy
    assert found.number == 0.01


def test_positions_beyond_all_ranges_are_named_with_their_units() -> None:
    tree = robot("gantry")  # three joints slide, three turn
    low, high = np.array([joint.position_range for joint in tree.joints]).T
    inside = np.stack([low, high])
    assert not list(position_finding(tree, inside, 0.1))
    just = inside + 0.09 * (high - low) * [[-1], [1]]
    assert not list(position_finding(tree, just, 0.1))
    beyond = inside.copy()
    beyond[1, 1] = high[1] + 0.2 * (high[1] - low[1])
    (found,) = position_finding(tree, beyond, 0.1)
    assert f"'j2' {low[1]:.4g} to {beyond[1, 1]:.4g}" in found.text
    assert f"(its range is {low[1]:.4g} to {high[1]:.4g} m)" in found.text
    assert "more" not in found.text
    assert "positions in mm" in found.text
    assert found.number == 1.0
    beyond[0, [0, 4]] = low[[0, 4]] - 5 * (high - low)[[0, 4]]
    (found,) = position_finding(tree, beyond, 0.1)
    assert found.text.count("its range is") == 2
    assert " and 1 more" in found.text
    assert "positions in deg" in found.text
    assert found.number == 3.0
    beyond = inside.copy()
    beyond[0, 3] = low[3] - 5 * (high - low)[3]
    (found,) = position_finding(tree, beyond, 0.1)
    assert f"{high[3]:.4g} rad)" in found.text


@pytest.mark.parametrize("share", [0.03, 0.1])
def test_crosstalk_is_told_and_no_cure_is_proposed(share: float) -> None:
    """No turn, unit or order mends a plate that mixes its channels; a matrix of all six does."""
    recording = measured(robot("ur5"), 2, duration=10.0)
    mixed = np.eye(6) + share * np.random.default_rng(5).normal(size=(6, 6))
    wrench = np.array(recording.wrench) @ (mixed * np.outer(SCALE, 1 / SCALE)).T
    found = check_sanity(robot("ur5"), replace(recording, wrench=wrench))
    assert found.cures == ()
    (told,) = (*found.certain, *found.likely)
    assert told.causes[0] == "crosstalk"


@pytest.mark.parametrize("sense", [1.0, -1.0])
@pytest.mark.parametrize("seed", [0, 1])
def test_a_plate_turned_by_any_angle_is_found_in_either_sense(seed: int, sense: float) -> None:
    recording = measured(robot("ur5"), 3, duration=10.0)
    turn = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    wrench = np.array(recording.wrench).reshape(-1, 2, 3) @ turn
    turned = replace(recording, wrench=sense * wrench.reshape(-1, 6))
    cures = check_sanity(robot("ur5"), turned).cures
    assert [each.kind for each in cures] == ["turn", *["sense"] * (sense < 0)]
    told = Rotation.from_euler("xyz", cures[0].values).as_matrix()
    np.testing.assert_allclose(told, turn, atol=5e-3)
