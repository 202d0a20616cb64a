"""Wrong mappings are refused with their cure, right ones are not, whatever the masses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import testbed as tb
from testbed.errors import RecordingError, printable
from testbed.sanity.accept import UNCHECKED, accept
from testbed.sanity.sanity import check_sanity
from tests.helpers.cases import cases
from tests.helpers.measured import measured
from tests.helpers.paths import REAL, ROOT
from tests.helpers.runs import robot, without

TX40 = ROOT / "examples/tx40"
ROBOTS = ("tx40", "ur5", "panda", "puma")


@cache
def right(name: str) -> tuple[tb.Tree, tb.Recording]:
    """A robot and a recording that is true of it; the TX40's is real."""
    if name == "tx40":
        tree = tb.load_tree(TX40 / "tx40.urdf")
        return tree, tb.Recording.from_mapping(TX40 / "tx40.toml")
    if name == "panda":
        fingers = dict.fromkeys(("panda_finger_joint1", "panda_finger_joint2"))
        tree = tb.load_tree(REAL / "panda_description/urdf/panda.urdf", lock=fingers)
    else:
        tree = robot(name)
    return tree, without(measured(tree, duration=12.0), "wrench")


def of_joint(recording: tb.Recording, joint: int, *, torque: float = 1, position: float = 1,
             zero: float = 0) -> tb.Recording:  # fmt: skip
    """One joint read in another way."""
    mark = np.eye(len(recording.names))[joint]
    return replace(
        recording,
        position=recording.position * (1 + (position - 1) * mark) + zero * mark,
        torque=recording.measured("torque") * (1 + (torque - 1) * mark),
    )


def in_order(recording: tb.Recording) -> tb.Recording:
    """The second and third joint taken for each other."""
    order = np.arange(len(recording.names))
    order[[1, 2]] = 2, 1
    torque = recording.measured("torque")[:, order]
    return replace(recording, position=recording.position[:, order], torque=torque)


def torque_over(recording: tb.Recording, size: tuple[float, float]) -> tb.Recording:
    """Each torque as many times smaller."""
    factors = np.linspace(*size, len(recording.names))
    return replace(recording, torque=recording.measured("torque") / factors)


def as_degrees(recording: tb.Recording) -> tb.Recording:
    """Radians that the mapping takes for degrees; its offsets are in radians all the same."""
    said = recording.facts.get("mapping", {}).get("position", {}).get("offset", 0.0)
    moved = np.deg2rad(recording.position - np.array(said)) + np.array(said)
    return replace(recording, position=moved)


WRONG: dict[str, tuple[Callable[[tb.Recording], tb.Recording], str]] = {
    "all torques' signs": (
        lambda r: replace(r, torque=-r.measured("torque")), "[torque] sign = [-1, -1, -1"
    ),
    "a torque's sign": (lambda r: of_joint(r, 1, torque=-1), "[torque] sign = [1, -1, 1"),
    "a position's sign": (lambda r: of_joint(r, 1, position=-1), "[position] sign = [1, -1, 1"),
    "degrees": (
        lambda r: replace(r, position=np.rad2deg(r.position)), '[position] unit = "deg"'
    ),
    "radians as degrees": (as_degrees, '[position] unit = "rad"'),
    "order": (in_order, "in another order"),
    "motor side": (lambda r: torque_over(r, (50, 80)), '[torque] side = "motor"'),
    "currents": (lambda r: torque_over(r, (8, 11)), 'unit = "A" with gain about ['),
    "a zero": (lambda r: of_joint(r, 1, zero=np.pi / 2), "[position] offset = [0, "),
    "two zeros": (
        lambda r: of_joint(of_joint(r, 1, zero=np.pi / 2), 2, zero=-np.pi / 2),
        "[position] offset = [0, ",
    ),
}  # fmt: skip
SLOW = ("two zeros", "order", "a zero")
"""Mistakes that take long to find; of the others, one robot's do without `slow`."""

MISTAKES = [(name, mistake) for mistake in WRONG for name in ROBOTS]
MISTAKES.sort(key=lambda pair: pair[0] != "puma" or pair[1] in SLOW)


@pytest.mark.slow
@pytest.mark.parametrize("case", cases(MISTAKES, len(WRONG) - len(SLOW)), ids=", ".join)
def test_a_wrong_mapping_is_refused_with_its_cure(case: tuple[str, str]) -> None:
    name, mistake = case
    tree, recording = right(name)
    spoil, cure = WRONG[mistake]
    with pytest.raises(RecordingError, match="cannot be true of this robot") as found:
        accept(tree, spoil(recording))
    assert cure in str(found.value)
    assert len(printable(str(found.value), 10_000)) < 800


@pytest.mark.slow
def test_the_cure_is_the_mappings_own_line() -> None:
    """Of the TX40: with the signs, offsets and columns that its mapping has."""
    tree, recording = right("tx40")
    without_zero = of_joint(recording, 1, zero=np.pi / 2)
    mapping = dict(recording.facts["mapping"])
    mapping["position"] = {**mapping["position"], "offset": [0.0, 0.0, np.pi / 2, 0.0, 0.0, 0.0]}
    told = replace(without_zero, facts={**recording.facts, "mapping": mapping})
    with pytest.raises(RecordingError, match=r"offset = \[0, -1.5708, 1.5708, 0, 0, 0\]"):
        accept(tree, told)
    order = np.array([0, 2, 1, 3, 4, 5])
    swapped = replace(recording, torque=recording.measured("torque")[:, order])
    with pytest.raises(RecordingError, match='columns = ."Joint_1", "Joint_3", "Joint_2"'):
        accept(tree, swapped)


@pytest.mark.parametrize("sense", [1, -1])
def test_the_sense_of_a_plate_is_told(sense: int) -> None:
    tree = robot("puma")
    recording = without(measured(tree, duration=12.0), "torque")
    turned = replace(recording, wrench=sense * recording.measured("wrench"))
    found = check_sanity(tree, turned).certain
    assert bool(found) == (sense < 0)
    assert [cure.kind for cure in check_sanity(tree, turned).cures] == ["sense"] * (sense < 0)


def of_plate(force: float = 1, moment: float = 1, order: tuple[int, ...] = (0, 1, 2, 3, 4, 5)
             ) -> Callable[[tb.Recording], tb.Recording]:  # fmt: skip
    """The plate read in other units or in another order."""
    size = np.array([force] * 3 + [moment] * 3)
    return lambda r: replace(r, wrench=(r.measured("wrench") * size)[:, list(order)])


PLATES: dict[str, tuple[Callable[[tb.Recording], tb.Recording], str]] = {
    "N mm as N m": (of_plate(moment=1e3), '[wrench] units = ["N", "N mm"]'),
    "N m as N mm": (of_plate(moment=1e-3), '[wrench] units = ["N", "kN m"]'),
    "kN as N": (of_plate(force=1e-3), '[wrench] units = ["kN", "N m"]'),
    "moments first": (of_plate(order=(3, 4, 5, 0, 1, 2)), '["Mx", "My", "Mz", "Fx", "Fy", "Fz"]'),
    "axes turned": (
        of_plate(order=(2, 0, 1, 5, 3, 4)), "rpy = [0, -1.5708, -1.5708]"
    ),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("mistake", PLATES)
@pytest.mark.parametrize("name", ["puma", "ur5", "gantry"])
def test_a_plate_in_other_units_or_order_is_refused(name: str, mistake: str) -> None:
    tree = robot(name)
    recording = without(measured(tree, duration=12.0), "torque")
    assert check_sanity(tree, recording).certain == ()
    spoil, cure = PLATES[mistake]
    with pytest.raises(RecordingError, match="cannot be true of this robot") as found:
        accept(tree, spoil(recording))
    assert cure in str(found.value)


def with_masses(tree: tb.Tree, seed: int) -> tb.Tree:
    """Masses wrong by up to a factor two; every other time the inertias stay as they are."""
    factors = 2.0 ** np.random.default_rng(seed).uniform(-1, 1, tree.n)
    scaled = [
        tb.Inertia(i.mass * x, i.first_moment * x, i.tensor * (x if seed % 2 else 1))
        for i, x in zip(tree.inertias, factors, strict=True)
    ]
    return replace(tree, inertias=tuple(scaled))


RIGHT = [(name, seed) for seed in range(13) for name in ROBOTS][:50]


@pytest.mark.parametrize("case", cases(RIGHT, 8), ids=str)
def test_rough_masses_alone_refuse_nothing(case: tuple[str, int]) -> None:
    name, seed = case
    tree, recording = right(name)
    assert check_sanity(with_masses(tree, seed), recording).certain == ()


@pytest.mark.parametrize("name", ["gantry", "random"])
def test_other_robots_are_not_refused(name: str) -> None:
    tree = robot(name)
    recording = measured(tree, duration=12.0)
    found = check_sanity(tree, recording)
    assert found.certain == ()
    np.testing.assert_allclose(found.sizes[np.isfinite(found.sizes)], 1, atol=0.2)


@pytest.mark.slow
def test_a_humanoid_is_not_refused() -> None:
    """More joints than pairs are tried of; a torque of opposite sign is found all the same."""
    tree = tb.load_tree(REAL / "g1_description/urdf/g1_29dof_rev_1_0.urdf", weld_root=True)
    recording = without(measured(tree, duration=8.0, rate=100.0), "wrench")
    assert check_sanity(tree, recording).certain == ()


@pytest.mark.slow
def test_unchecked_recordings_are_not_searched() -> None:
    tree, recording = right("puma")
    wrong = replace(recording, torque=-recording.measured("torque"))
    found = accept(tree, wrong, unchecked=True)
    assert found.warnings[0] == UNCHECKED
