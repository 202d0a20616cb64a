"""Wrong mappings are refused with the line that cures them; right ones are not, by rough masses.

Each mistake is made on a recording that is right; the TX40's is a real one.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import hypothesis
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import testbed as tb
from benchmarks.inverse_recordings import RATE, truth
from testbed.core.base.arrays import Array
from testbed.core.base.errors import RecordingError
from testbed.core.recordings.metadata import Metadata
from testbed.core.recordings.views import with_base_joints
from testbed.core.robot.free_base import N_BASE_COORDINATES, base_coordinates, base_poses
from testbed.core.robot.rotations import matrix_to_rpy
from testbed.importing.check.assessment import assess_recording
from testbed.importing.check.check import check_recording
from testbed.importing.check.plate import ORDER_AS_READ, PLATE_ORDERS
from testbed.importing.check.plate_frame import plate_frame_of
from testbed.importing.check.remedies import (
    Hypothesis,
    corrected_positions,
    mapping_with_lines,
    merge_hypotheses,
    remedies_for,
)
from testbed.importing.check.time_offset import TimeOffset, alignment_lines
from testbed.importing.foreign_table import FORCE_UNITS, MOMENT_UNITS
from testbed.importing.mapping import WrenchTable
from testbed.importing.signal_maps import wrench_from_columns
from tests.helpers.foreign_files import npz, some_log
from tests.helpers.measured import measured
from tests.helpers.paths import ROOT
from tests.helpers.riding import riding
from tests.helpers.runs import robot, without
from tests.helpers.strategies import few, rngs, seeds

Spoil = Callable[[tb.Recording], tb.Recording]


@cache
def right(name: str, lacks: str = "") -> tuple[tb.Tree, tb.Recording]:
    """A robot and a recording that is true of it."""
    if name == "tx40":
        folder = ROOT / "examples/tx40"
        return tb.load_tree(folder / "tx40.urdf"), tb.import_recording(folder / "tx40.toml")
    recording = measured(robot(name), 2, duration=12.0 if name == "puma" else 8.0)
    return robot(name), without(recording, lacks) if lacks else recording


def of_joint(joint: int, *, torque: float = 1, position: float = 1, zero: float = 0) -> Spoil:
    """One joint read in another way."""

    def spoil(r: tb.Recording) -> tb.Recording:
        mark = np.eye(len(r.names))[joint]
        return replace(
            r,
            position=r.position * (1 + (position - 1) * mark) + zero * mark,
            torque=None if r.torque is None else r.torque * (1 + (torque - 1) * mark),
        )

    return spoil


def torques(first: float, last: float) -> Spoil:
    """Each torque so many times as large, from the first joint's to the last's."""
    return lambda r: replace(
        r, torque=r.measured("torque") * np.linspace(first, last, len(r.names))
    )


def plate(force: float = 1, moment: float = 1, order: tuple[int, ...] = (0, 1, 2, 3, 4, 5)
          ) -> Spoil:  # fmt: skip
    """The plate read in other units or in another order."""
    size = np.repeat([force, moment], 3)
    return lambda r: replace(r, wrench=(r.measured("wrench") * size)[:, list(order)])


def as_degrees(r: tb.Recording) -> tb.Recording:
    """Radians that the mapping takes for degrees; its offsets are in radians all the same."""
    said = np.array((r.metadata.mapping or {}).get("position", {}).get("offset", 0.0))
    return replace(r, position=np.deg2rad(r.position - said) + said)


def exchanged(r: tb.Recording) -> tb.Recording:
    """The second and third joint taken for each other."""
    order = [0, 2, 1, *range(3, len(r.names))]
    return replace(r, position=r.position[:, order], torque=r.measured("torque")[:, order])


QUARTER = np.pi / 2
AXES = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
WRONG: dict[str, tuple[str, str, Spoil, tuple[tuple[str, str, Any], ...]]] = {
    "all torques' signs": ("ur5", "wrench", torques(-1, -1), (("torque", "sign", [-1] * 6),)),
    "a torque's sign": (
        "tx40", "", of_joint(1, torque=-1), (("torque", "sign", [1, -1, 1, 1, 1, 1]),)
    ),
    "radians as degrees": ("tx40", "", as_degrees, (("position", "unit", "rad"),)),
    "a zero": (
        "tx40", "", of_joint(1, zero=QUARTER), (("position", "offset", None),)
    ),
    "an odd zero": (
        "ur5", "", of_joint(3, zero=np.deg2rad(-40)),
        (("position", "offset", [0, 0, 0, np.deg2rad(40), 0, 0]),),
    ),
    "a zero and a torque's sign": (
        "ur5", "wrench", lambda r: of_joint(2, torque=-1)(of_joint(1, zero=QUARTER)(r)),
        (("torque", "sign", [1, 1, -1, 1, 1, 1]),
         ("position", "offset", [0, -QUARTER, 0, 0, 0, 0])),
    ),
    "sense": ("puma", "torque", plate(-1, -1), (("wrench", "sense", "on_plate"),)),
    "N mm as N m": ("gantry", "torque", plate(moment=1e3), (("wrench", "units", ["N", "N mm"]),)),
    "moments first": (
        "gantry", "torque", plate(order=(3, 4, 5, 0, 1, 2)),
        (("wrench", "columns", [AXES[k] for k in (3, 4, 5, 0, 1, 2)]),),
    ),
    "axes turned": (
        "puma", "torque", plate(order=(2, 0, 1, 5, 3, 4)),
        (("wrench", "place", {"xyz": [0, 0, 0], "rpy": [0, -QUARTER, -QUARTER]}),),
    ),
}  # fmt: skip
"""Robot, what the recording lacks, what is done to it, and what its mapping should say then."""


def near(said: Any, wanted: Any) -> bool:
    """Whether a mapping's value is the wanted one, numbers of angles to what rough masses tell."""
    if isinstance(wanted, dict):
        return all(near(said[key], value) for key, value in wanted.items())
    if isinstance(wanted, list) and not isinstance(wanted[0], str):
        return bool(np.allclose(said, wanted, atol=0.3 if 0 in wanted else 1e-9))
    return bool(said == wanted)


@pytest.mark.slow
@pytest.mark.parametrize("mistake", WRONG)
def test_a_wrong_mapping_is_refused_with_the_line_that_cures_it(mistake: str) -> None:
    name, lacks, spoil, wanted = WRONG[mistake]
    tree, recording = right(name, lacks)
    found = assess_recording(tree, spoil(recording))
    lines = [line for each in found.remedies for line in each.lines]
    assert [line[:2] for line in lines] == [line[:2] for line in wanted]
    for (_, _, value), (_, _, expected) in zip(lines, wanted, strict=True):
        if expected is None:  # a quarter turn less than the mapping of a real robot says
            said = np.array((recording.metadata.mapping or {})["position"]["offset"], dtype=float)
            said[1] -= QUARTER
            np.testing.assert_allclose(value, said, atol=1e-3)
        else:
            assert near(value, expected), (value, expected)
    with pytest.raises(RecordingError) as refused:
        found.raise_errors()
    assert all(f"[{table}] {key}" in str(refused.value) for table, key, _ in wanted)
    assert "\n" not in str(refused.value)


@pytest.mark.slow
def test_zeros_that_data_do_not_decide_are_named() -> None:
    """Some of a wrist without a plate; with one, none; nor the shoulder's."""
    tree, recording = right("tx40")
    for joint, angle in ((2, -QUARTER), (3, QUARTER), (4, QUARTER)):
        found = assess_recording(tree, of_joint(joint, zero=angle)(recording))
        assert (found.errors, found.remedies) == ((), ())
        (said,) = found.diagnostics
        assert (said.code, said.level) == ("recording.undecided", "info")
        assert tree.names[joint] in said.subject
        assert tree.names[1] not in said.subject
    (said,) = assess_recording(tree, of_joint(1, zero=QUARTER)(recording)).diagnostics
    assert said.subject == "joint 'joint_2'"  # not the elbow, as if masses were far off
    assert assess_recording(*right("ur5")).diagnostics == ()


@pytest.mark.slow
def test_torques_that_are_none_and_exchanged_joints_are_refused() -> None:
    """On the motors' side, or currents; columns of other joints; a plate of another robot."""
    tree, recording = right("puma", "wrench")
    for factors in ((1 / 50, 1 / 80), (1 / 8, 1 / 11)):
        (found,) = assess_recording(tree, torques(*factors)(recording)).errors
        assert "side" in found.remedy
        assert "gain" in found.remedy
    (found,) = assess_recording(tree, torques(1000, 1000)(recording)).errors
    assert "[torque] unit" in found.remedy
    kinds = {each.kind for each in assess_recording(tree, exchanged(recording)).remedies}
    assert kinds == {"position_order", "torque_order"}
    other = robot("random")
    alien = measured(other, 2, duration=12.0)
    both = replace(right("puma")[1], torque=None)
    with pytest.raises(RecordingError):
        assess_recording(tree, replace(both, wrench=alien.measured("wrench"))).raise_errors()


@pytest.mark.slow
@few(4)
@given(seed=seeds, name=st.sampled_from(["tx40", "ur5", "puma", "gantry", "random"]))
@hypothesis.example(seed=0, name="tx40")
def test_rough_masses_alone_refuse_nothing(seed: int, name: str) -> None:
    """Wrong by up to a factor two, with inertias that go with them or stay."""
    tree, recording = right(name)
    rng = np.random.default_rng(seed)
    factors, whole = 2.0 ** rng.uniform(-1, 1, tree.n), rng.random() < 0.5
    scaled = (
        tb.Inertia(i.mass * x, i.first_moment * x, i.tensor * (x if whole else 1))
        for i, x in zip(tree.inertias, factors, strict=True)
    )
    assert assess_recording(replace(tree, inertias=tuple(scaled)), recording).errors == ()
    sizes = assess_recording(tree, recording).torque_scales
    if name != "tx40":
        np.testing.assert_allclose(sizes[np.isfinite(sizes)], 1, atol=0.2)


@pytest.mark.slow
@few(2)
@given(seed=seeds, sense=st.sampled_from([1.0, -1.0]))
def test_a_plate_turned_by_any_angle_is_found_in_either_sense(seed: int, sense: float) -> None:
    tree, recording = right("ur5")
    turn = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    wrench = recording.measured("wrench").reshape(-1, 2, 3) @ turn
    remedies = assess_recording(
        tree, replace(recording, wrench=sense * wrench.reshape(-1, 6))
    ).remedies
    assert [each.kind for each in remedies] == ["turn", *["sense"] * (sense < 0)]
    told = Rotation.from_euler("xyz", remedies[0].values).as_matrix()
    np.testing.assert_allclose(told, turn, atol=5e-3)


@pytest.mark.slow
def test_a_plate_that_mixes_its_channels_needs_a_matrix_and_no_cure() -> None:
    tree, recording = right("ur5")
    scale = np.repeat([1.0, 0.1], 3)
    mixing = np.eye(6) + 0.1 * np.random.default_rng(5).normal(size=(6, 6))
    mixed = recording.measured("wrench") @ (mixing * np.outer(scale, 1 / scale)).T
    found = assess_recording(tree, replace(recording, wrench=mixed))
    assert found.remedies == ()
    assert [each.code for each in (*found.errors, *found.warnings)] == ["plate.crosstalk"]


@pytest.mark.slow
def test_spoiled_channels_are_named_before_mappings_are_doubted() -> None:
    """A spike with its channel and instant; an encoder that stands; a plate that does."""
    tree, recording = right("puma")

    def checked(signals: dict[str, Any], lacks: str = "") -> Any:
        changed = replace(recording, **signals)
        found = assess_recording(tree, without(changed, lacks) if lacks else changed)
        assert found.remedies == ()
        return found

    for signal, channel in (("position", tree.names[2]), ("wrench", "Fz")):
        values = np.array(recording.measured(signal))
        values[700, 2] += 10 * np.ptp(values[:, 2])
        (said,) = checked({signal: values}).errors
        assert said.causes == ("spikes",)
        assert channel in said.subject
        assert f"{recording.time[700]:.6g} s" in said.text
    dead = recording.position * [1, 0, 1]
    for lacks in ("", "wrench"):
        found = checked({"position": dead}, lacks)
        (doubt,) = (each for each in found.diagnostics if each.level != "info")
        assert tree.names[1] in doubt.subject
    still: dict[str, Any] = {
        name: np.repeat(recording.measured(name)[:1], recording.samples, axis=0)
        for name in ("position", "torque", "wrench")
    }
    found = checked({"wrench": still["wrench"]})
    assert [each.subject for each in found.errors] == ["the plate"]
    found = checked(still)
    assert found.errors == ()
    assert [each.subject for each in found.warnings] == ["the robot"]


@pytest.mark.slow
def test_signs_of_a_joint_that_carries_nearly_nothing_are_told_apart() -> None:
    """Its torque is a thousandth of the shoulder's; a unit of all positions hides neither."""
    made = truth("panda", 1, seconds=12.0)
    time = np.arange(len(made.position)) / RATE
    recording = tb.Recording(made.tree.names, time, made.position, made.torque, made.wrench)
    for spoil, unit, kinds in (
        (of_joint(6, torque=-1), 1.0, ["torque_sign"]),
        (of_joint(6, position=-1), np.rad2deg(1.0), ["degrees", "position_sign"]),
    ):
        wrong = spoil(recording)
        found = assess_recording(made.tree, replace(wrong, position=wrong.position * unit))
        assert found.errors
        assert [each.kind for each in found.remedies] == kinds


def test_a_joint_that_rests_indeed_is_none_with_a_dead_encoder() -> None:
    """Witness: MuJoCo's inverse dynamics of an arm whose fourth joint is held."""
    made = truth("ur5", 1, seconds=8.0, moving=(0, 1, 2, 4, 5))
    time = np.arange(len(made.position)) / RATE
    recording = tb.Recording(
        made.tree.names, time, made.position, made.torque, made.wrench, tare=np.zeros(6)
    )
    found = assess_recording(made.tree, recording)
    assert (found.errors, found.warnings, found.remedies) == ((), (), ())
    (rests,) = (each for each in found.diagnostics if each.code == "position.held")
    assert made.tree.names[3] in rests.subject


@pytest.mark.parametrize("unit", [1.0, np.rad2deg(1.0)])
def test_of_a_robot_at_rest_nothing_is_said_but_that(unit: float) -> None:
    """Else noise of its encoders, in degrees, passes for a motion and its mapping is refused."""
    made = truth("ur5", 305, seconds=8.0, moving=())
    noise = np.random.default_rng(1).normal(scale=2e-5, size=made.position.shape)
    q, time = unit * (made.position + noise), np.arange(len(noise)) / RATE
    recording = tb.Recording(made.tree.names, time, q, made.torque, made.wrench)
    said = check_recording(made.tree, recording).diagnostics
    assert [each.code for each in said] == ["robot.rest"]


def of_base(size: float, order: tuple[int, ...] = (0, 1, 2, 3)) -> Spoil:
    """The pose of a base in another unit, its quaternion in another order."""

    def spoil(r: tb.Recording) -> tb.Recording:
        base = r.measured("base")
        return replace(r, base=np.hstack([base[:, :3] * size, base[:, 3:][:, list(order)]]))

    return spoil


@pytest.mark.slow
def test_a_robot_on_a_base_that_moves_is_held_against_its_model_as_others_are() -> None:
    """Right whatever the masses; wrong units and orders of the pose, a sense, a sign, a weld."""
    free, recording = riding(11)
    factors = 2.0 ** np.random.default_rng(11).uniform(-1, 1, free.n)
    scaled = (tb.Inertia(i.mass * x, i.first_moment * x, i.tensor * x)
              for i, x in zip(free.inertias, factors, strict=True))  # fmt: skip
    rough = replace(free, inertias=tuple(scaled))
    assert assess_recording(rough, with_base_joints(recording)).errors == ()
    sides = {f"plates.{name}": {"sense": "on_robot", "units": ["N", "N m"]} for name in "lr"}
    plates = {"plates": {name[7:]: said for name, said in sides.items()}}
    cases: list[tuple[Spoil, dict[str, Any], list[tuple[str, str, Any]]]] = [
        (of_base(1e3), {}, [("base", "unit", "mm")]),
        (of_base(1, (1, 2, 3, 0)), {}, [("base", "quaternion", ["w", "x", "y", "z"])]),
        (plate(-1, -1), plates, [(name, "sense", "on_plate") for name in sides]),
        (of_joint(1, position=-1), {}, [("position", "sign", [1, -1, 1])]),
    ]
    for spoil, mapping, wanted in cases:
        told = Metadata(mapping={"joints": list(recording.names), **mapping})
        found = assess_recording(free, with_base_joints(replace(spoil(recording), metadata=told)))
        assert [line for each in found.remedies for line in each.lines] == wanted
        assert found.errors
    welded = tb.Tree(
        free.name,
        tuple(
            replace(j, parent=max(j.parent - N_BASE_COORDINATES, -1))
            for j in free.joints[N_BASE_COORDINATES:]
        ),
        free.inertias[N_BASE_COORDINATES:],
    )
    with pytest.raises(RecordingError) as refused:
        check_recording(welded, recording)
    assert "robot.base=measured" in str(refused.value)
    turns = np.random.default_rng(0).uniform(-1.3, 1.3, (50, N_BASE_COORDINATES))
    np.testing.assert_allclose(base_coordinates(base_poses(turns)), turns, atol=1e-12)


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
        wanted = corrected_positions(each, wanted, np.zeros(3))
    together = merge_hypotheses(mistakes)
    assert len({each.kind for each in together}) == len(together)
    for said in (mistakes, together):
        remedies = remedies_for(robot("puma"), list(said), np.ones(3), np.zeros(3), mapping, 3)
        cured = mapping_with_lines(mapping, [line for each in remedies for line in each.lines])
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
        return wrench_from_columns(read, np.column_stack([by_name[name] for name in read.columns]))

    frame, orders = plate_frame_of(mapping), (ORDER_AS_READ, *PLATE_ORDERS)
    for _ in range(10):
        turn = Rotation.random(rng=rng).as_matrix() @ frame.rotation
        units = (rng.choice([*FORCE_UNITS]), rng.choice([*MOMENT_UNITS]))
        order = orders[rng.integers(len(orders))]
        hypotheses = (
            Hypothesis("plate_order", (), order),
            Hypothesis("units", (), units),
            Hypothesis("turn", (), matrix_to_rpy(turn)),
        )
        remedies = remedies_for(robot("ur5"), hypotheses, np.ones(6), np.ones(6), mapping, 0)
        said = mapping_with_lines(mapping, [line for each in remedies for line in each.lines])
        wanted = made(given) @ frame.map(turn, units, order).T
        scale = np.abs(wanted).max()
        np.testing.assert_allclose(made(said["wrench"]), wanted, rtol=1e-4, atol=1e-4 * scale)


def test_delays_that_were_found_are_added_to_those_that_the_mapping_knew(tmp_path: Path) -> None:
    """All plates get their sum's; a clock that positions share does not drift; noise is none."""
    text = npz(tmp_path, some_log())
    before, wrench = text.split("[wrench]\n")
    two = f"{before}[plates.left]\ndelay = 0.004\n{wrench}\n[plates.right]\n{wrench}"

    def aligned(text: str, signal: str, delay: float, skew: float = 0.0) -> Any:
        offset = TimeOffset(signal, delay, 1e-5, skew, 1e-7, 10.0, 0.5, 0.01)
        return mapping_with_lines(
            tomllib.loads(text), alignment_lines(offset, tomllib.loads(text), {})
        )

    found = aligned(text, "wrench", 0.003, 1e-4)
    assert found["wrench"]["delay"] == 0.003
    assert "skew" not in found["sources"]["log"]
    assert found["torque"] == tomllib.loads(text)["torque"]
    delays = {n: t["delay"] for n, t in aligned(two, "wrench", 0.003)["plates"].items()}
    assert delays == {"left": 0.007, "right": 0.003}
    found = aligned(two, "torque", 0.003)
    assert found["torque"]["delay"] == 0.003
    assert found["plates"] == tomllib.loads(two)["plates"]
