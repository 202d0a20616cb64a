"""What a cure says is what the mapping must hold for the data to be without the mistake."""

from __future__ import annotations

import re
import tomllib
from typing import Any

import numpy as np
import pytest

from testbed.arrays import Array
from testbed.sanity.cure_words import gain_finding
from testbed.sanity.cures import cures_of, remedy, with_lines
from testbed.sanity.mistakes import Mistake, joint_map
from tests.helpers.runs import robot

JOINTS = ("elbow", "waist", "shoulder")
"""The mapping's own order."""

LEFT = np.ones(3)

TABLES: tuple[dict[str, Any], ...] = (
    {},
    {"sign": [1, -1, 1]},
    {"offset": [0.0, -1.5, 0.2]},
    {"sign": [-1, 1, -1], "offset": [0.3, 0.0, 0.0]},
)
MISTAKES = (
    Mistake("position_sign", (1,)),
    Mistake("position_sign", (0, 2)),
    Mistake("zero", (2,), (np.pi / 2,)),
    Mistake("zero", (0, 1), (-np.pi / 2, np.pi)),
)


def mapped(raw: Array, table: dict[str, Any]) -> Array:
    """Positions by the mapping, in the robot's order of joints; raw ones are in the mapping's."""
    values = raw * np.array(table.get("sign", [1.0] * 3)) + np.array(table.get("offset", [0.0] * 3))
    return np.asarray(values[:, [JOINTS.index(name) for name in robot("puma").names]])


@pytest.mark.parametrize("table", TABLES, ids=str)
@pytest.mark.parametrize("mistake", MISTAKES, ids=str)
def test_a_mapping_with_its_cure_makes_the_data_right(
    mistake: Mistake, table: dict[str, Any]
) -> None:
    raw = np.random.default_rng(0).normal(size=(4, 3))
    mapping = {"joints": list(JOINTS), "position": table}
    (cure,) = cures_of(robot("puma"), [mistake], LEFT, 0 * LEFT, mapping, 3)
    changed = dict(table)
    for line in re.findall(r"\[position\] ([^;]*)", remedy([cure])):
        changed |= tomllib.loads(line)
    scale, added = joint_map(mistake, 3, np.zeros(3))
    wanted = mapped(raw, table) @ scale.T + added
    assert with_lines(mapping, cure.lines)["position"].keys() == changed.keys()
    np.testing.assert_allclose(mapped(raw, changed), wanted, atol=1e-4)  # as it is printed


@pytest.mark.parametrize(("joints", "said"), [((0, 1, 2), "deg"), ((0,), ["rad", "deg", "rad"])])
def test_a_unit_of_all_joints_is_said_once(joints: tuple[int, ...], said: Any) -> None:
    mapping = {"joints": list(JOINTS), "position": {}}
    (cure,) = cures_of(robot("puma"), [Mistake("degrees", joints)], LEFT, 0 * LEFT, mapping, 3)
    assert cure.lines == (("position", "unit", said),)


def test_lines_of_several_mistakes_build_on_each_other() -> None:
    """The sign turns the zero that is there, and another zero is added to that."""
    mapping = {"joints": list(JOINTS), "position": {"offset": [0.0, 0.5, 0.0]}}
    made = [Mistake("position_sign", (0,)), Mistake("zero", (0,), (1.0,))]
    lines = [
        line
        for cure in cures_of(robot("puma"), made, LEFT, 0 * LEFT, mapping, 3)
        for line in cure.lines
    ]
    assert with_lines(mapping, lines)["position"] == {"sign": [1, -1, 1], "offset": [0.0, 0.5, 0.0]}


def test_programs_can_compare_cures() -> None:
    made = [Mistake("turn", (), (0.0, 0.0, 1.5)), Mistake("sense")]
    one, other = (
        cures_of(robot("puma"), made, np.ones(9), np.full(9, 0.1), {}, 3) for _ in range(2)
    )
    assert one == other
    assert [cure.kind for cure in one] == ["turn", "sense"]
    assert {(cure.before, cure.after) for cure in one} == {(1.0, 0.1)}
    assert len({hash(str(cure.lines)) for cure in one}) == 2


@pytest.mark.parametrize("torques", [0, 6])
def test_a_cure_of_a_plate_names_a_channel_of_the_plate(torques: int) -> None:
    before, after = np.ones(torques + 6), np.ones(torques + 6)
    after[torques + 1] = 0.1
    cures = cures_of(robot("ur5"), [Mistake("sense")], before, after, {}, torques)
    assert [(each.channel, each.after) for each in cures] == [("Fy", 0.1)]


NAN = float("nan")


@pytest.mark.parametrize(
    ("sizes", "said", "side", "number"),
    [
        ((0.02, 1.1, 0.05), "is too small: .*make: waist 0.02, elbow 0.05$", "motor", 0.02),
        ((0.02, 1.1, NAN), "is too small: .*make: waist 0.02$", "motor", 0.02),
        ((NAN, 40.0, 900.0), "is too large: .*make: shoulder 40, elbow 9e\\+02$", "unit", 40.0),
        ((0.02, 40.0, 1.0), "is too large: .*make: waist 0.02, shoulder 40$", "unit", 0.02),
        ((1.0, 0.1, 1.0), "is too small: .*make: shoulder 0.1$", "motor", 0.1),
    ],
)
def test_torques_of_another_size_are_named_with_what_makes_them_so(
    sizes: tuple[float, ...], said: str, side: str, number: float
) -> None:
    """Small ones are on the motors' side, or currents; others are in another unit."""
    found = gain_finding(robot("puma"), np.array(sizes), 0.2, 5.0, {})
    assert re.search(said, found.found)
    assert found.number == number
    assert found.subject == "the torque"
    if side == "motor":
        gears = ", ".join(f"{1 / size:.5g}" if np.isfinite(size) else "0" for size in sizes)
        assert 'side = "motor"' in found.remedy
        assert f"ratio about [{gears}]" in found.remedy
        assert "currents taken for torques" in found.causes
    else:
        assert "[torque] unit" in found.remedy
        assert "motor" not in found.remedy
        assert "masses of another robot" in found.causes
