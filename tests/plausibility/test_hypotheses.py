"""What is tried for what robots, and that a mapping with its cure is without the mistake.

If one fails, the line that a person copies makes the mapping wrong in another way.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import testbed as tb
from testbed.core.base.arrays import Array
from testbed.core.robot.free_base import on_free_base
from testbed.core.robot.inertia import to_rpy
from testbed.importing.check.plate import AS_READ, PLATE_ORDERS, frame_of
from testbed.importing.check.remedies import (
    Hypothesis,
    corrected,
    merge,
    position_hypotheses,
    rarer_hypotheses,
    remedies_for,
    with_lines,
)
from testbed.importing.check.time_offset import TimeOffset, alignment
from testbed.importing.foreign_table import FORCES, MOMENTS
from testbed.importing.mapping import WrenchTable
from testbed.importing.signal_maps import wrench_of
from tests.helpers.foreign_files import npz, some_log
from tests.helpers.runs import robot
from tests.helpers.strategies import few, rngs, trees

JOINTS = ("elbow", "waist", "shoulder")
"""Of a PUMA, in the mapping's own order."""

signs = st.tuples(*[st.sampled_from([1, -1])] * 3).map(list)
offsets = st.tuples(*[st.sampled_from([0.0, 0.3, -1.5])] * 3).map(list)
joint_hypotheses = st.one_of(
    st.builds(Hypothesis, st.just("position_sign"), st.integers(0, 2).map(lambda k: (k,))),
    st.builds(
        Hypothesis,
        st.just("zero"),
        st.integers(0, 2).map(lambda k: (k,)),
        st.sampled_from([np.pi / 2, -np.pi / 2, 0.5]).map(lambda angle: (angle,)),
    ),
)


def mapped(raw: Array, table: dict[str, Any]) -> Array:
    """Positions by the mapping, in the robot's order of joints; raw ones are in the mapping's."""
    values = raw * np.array(table.get("sign", 1)) + np.array(table.get("offset", 0.0))
    return np.asarray(values[:, [JOINTS.index(name) for name in robot("puma").names]])


@given(
    mistakes=st.lists(joint_hypotheses, min_size=1, max_size=4, unique=True),
    sign=signs,
    offset=offsets,
)
def test_a_mapping_with_its_cures_makes_the_positions_right(
    mistakes: list[Hypothesis], sign: list[int], offset: list[float]
) -> None:
    """Signs and zeros one after the other, each building on what the last has left; merged, too."""
    raw = np.random.default_rng(0).normal(size=(4, 3))
    mapping: dict[str, Any] = {"joints": list(JOINTS), "position": {"sign": sign, "offset": offset}}
    if min(sign) > 0:  # then it need not be said
        del mapping["position"]["sign"]
    wanted = mapped(raw, mapping["position"])
    for each in mistakes:
        wanted = corrected(each, wanted, np.zeros(3))
    together = merge(mistakes)
    assert len({each.kind for each in together}) == len(together)
    for said in (mistakes, together):
        remedies = remedies_for(robot("puma"), list(said), np.ones(3), np.zeros(3), mapping, 3)
        cured = with_lines(mapping, [line for each in remedies for line in each.lines])
        np.testing.assert_allclose(mapped(raw, cured["position"]), wanted, atol=1e-4)


@few(8)
@given(rng=rngs, turned=st.booleans())
def test_a_plates_lines_are_the_map_that_was_judged(rng: np.random.Generator, turned: bool) -> None:
    """The mapping with the lines makes of the file what the map makes of the recording."""
    given = {
        "source": "log", "columns": ["Fx", "Fy", "Fz", "Mx", "My", "Mz"],
        "units": ["lbf", "N mm"], "sense": "on_robot",
        "place": {"xyz": [0.1, -0.2, 0.3], "rpy": [0.3, -0.2, 1.1] if turned else [0.0] * 3},
    }  # fmt: skip
    mapping: dict[str, Any] = {"wrench": given}
    by_name = dict(zip(given["columns"], rng.normal(size=(6, 5)), strict=True))

    def made(table: dict[str, Any]) -> Array:
        read = WrenchTable.model_validate(table)
        return wrench_of(read, np.column_stack([by_name[name] for name in read.columns]))

    frame, orders = frame_of(mapping), (AS_READ, *PLATE_ORDERS)
    for _ in range(10):
        turn = Rotation.random(rng=rng).as_matrix() @ frame.turn
        units = (rng.choice([*FORCES]), rng.choice([*MOMENTS]))
        order = orders[rng.integers(len(orders))]
        hypotheses = (
            Hypothesis("plate_order", (), order),
            Hypothesis("units", (), units),
            Hypothesis("turn", (), to_rpy(turn)),
        )
        remedies = remedies_for(robot("ur5"), hypotheses, np.ones(6), np.ones(6), mapping, 0)
        said = with_lines(mapping, [line for each in remedies for line in each.lines])
        wanted = made(given) @ frame.map(turn, units, order).T
        scale = np.abs(wanted).max()
        np.testing.assert_allclose(made(said["wrench"]), wanted, rtol=1e-4, atol=1e-4 * scale)


@given(tree=trees((2, 6)), size=st.sampled_from([0.05, 2.0, 300.0]), rng=rngs)
def test_what_slides_has_no_angles_and_changes_place_with_what_slides(
    tree: tb.Tree, size: float, rng: np.random.Generator
) -> None:
    """Units of angles are doubted where all are very large or very small, whatever slides."""
    turning = {k for k, joint in enumerate(tree.joints) if joint.revolute}
    slides = np.array([not joint.revolute for joint in tree.joints])
    values = rng.uniform(0.5, 1, (1, tree.n)) * np.linspace(-1, 1, 50)[:, None]
    position = values * np.where(slides, rng.choice([0.05, 2.0, 300.0]), size)
    tried = [*position_hypotheses(tree, position, ()), *rarer_hypotheses(tree, pairs=True)]
    for mistake in tried:
        if mistake.kind in ("degrees", "radians", "zero"):
            assert turning.issuperset(mistake.joints), mistake
        if mistake.kind == "position_order":
            kinds = [tree.joints[k].kind for k in mistake.values]
            assert kinds == [joint.kind for joint in tree.joints], mistake
    assert [m.joints for m in tried if m.kind == "position_sign"] == [(k,) for k in range(tree.n)]
    units = {m.kind for m in tried} & {"degrees", "radians"}
    expected = {0.05: {"radians"}, 2.0: set(), 300.0: {"degrees"}}[size]
    assert units == (expected if turning else set())
    free = [m.kind for m in position_hypotheses(on_free_base(tree), np.zeros((9, tree.n + 6)), ())]
    assert (free.count("base_unit"), free.count("quaternion_order")) == (4, 1)
    assert free.count("position_sign") == tree.n


def test_delays_that_were_found_are_added_to_those_that_the_mapping_knew(tmp_path: Path) -> None:
    """All plates get their sum's; a clock that positions share does not drift; noise is none."""
    text = npz(tmp_path, some_log())
    before, wrench = text.split("[wrench]\n")
    two = f"{before}[plates.left]\ndelay = 0.004\n{wrench}\n[plates.right]\n{wrench}"

    def aligned(text: str, signal: str, delay: float, skew: float = 0.0) -> Any:
        offset = TimeOffset(signal, delay, 1e-5, skew, 1e-7, 10.0, 0.5, 0.01)
        return with_lines(tomllib.loads(text), alignment(offset, tomllib.loads(text), {}))

    found = aligned(text, "wrench", 0.003, 1e-4)
    assert found["wrench"]["delay"] == 0.003
    assert "skew" not in found["sources"]["log"]
    assert found["torque"] == tomllib.loads(text)["torque"]
    delays = {n: t["delay"] for n, t in aligned(two, "wrench", 0.003)["plates"].items()}
    assert delays == {"left": 0.007, "right": 0.003}
    found = aligned(two, "torque", 0.003)
    assert found["torque"]["delay"] == 0.003
    assert found["plates"] == tomllib.loads(two)["plates"]
