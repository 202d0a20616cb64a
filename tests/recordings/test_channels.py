"""Faults of single channels are named with their joint, and estimates leave their samples out."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import testbed as tb
from benchmarks.channels import PLANTED, named, planted, sound
from testbed.core.base.arrays import Array
from testbed.core.base.errors import UnknownName
from testbed.core.estimation.identify import identify
from testbed.core.estimation.problem import Problem
from testbed.core.recordings.channels import channel_faults
from testbed.core.recordings.metadata import Metadata
from testbed.importing.check.assessment import assess_recording
from tests.helpers.measured import measured
from tests.helpers.paths import ROOT
from tests.helpers.strategies import few, seeds, trees

IMPORTED = Metadata(mapping={})


def of_joint(recording: tb.Recording, joint: int, torque: Array) -> tb.Recording:
    """Another torque of one joint."""
    values = recording.measured("torque").copy()
    values[:, joint] = torque
    return replace(recording, torque=values)


@few(12)
@given(tree=trees((2, 6)), seed=seeds, share=st.floats(0.08, 0.4), data=st.data())
def test_a_plateau_is_named_with_its_joint_its_level_and_its_share(
    tree: tb.Tree, seed: int, share: float, data: st.DataObject
) -> None:
    """A clipped torque is else a wrong inertia, a wrong friction, or a delay that is none."""
    recording = measured(tree, seed, rate=100.0, noise=0.05)
    joint = data.draw(st.integers(0, tree.n - 1))
    torque = recording.measured("torque")[:, joint]
    limit = float(np.quantile(torque, 1 - share))
    (fault,) = channel_faults(of_joint(recording, joint, np.minimum(torque, limit)))
    assert (fault.kind, fault.signal, fault.name) == ("clipped", "torque", tree.names[joint])
    assert fault.share == pytest.approx(share, abs=0.01)
    assert float(fault.facts["size"]) == pytest.approx(limit, rel=1e-3)


@few(20)
@given(tree=trees((1, 8)), seed=seeds, rate=st.sampled_from([30.0, 100.0, 500.0]))
def test_of_sound_channels_nothing_is_said(tree: tb.Tree, seed: int, rate: float) -> None:
    """False alarms teach people to read no warnings, and take data from estimates."""
    recording = measured(tree, seed, rate=rate, noise=0.1)
    assert not [named(each) for each in channel_faults(recording)]


@pytest.mark.parametrize("plant", [each for each in PLANTED if each != "another zero"])
def test_a_fault_is_named_with_its_kind_and_its_joint_alone(plant: str) -> None:
    """Of the arms of three makers."""
    for name in ("ur5", "panda", "puma562"):
        spoiled, fault = planted(sound(name, 1), plant, 3)
        found = [named(each) for each in channel_faults(spoiled)]
        assert found == [fault], name


def test_another_zero_is_named_where_the_joint_moves() -> None:
    """At a reversal the jump may be friction's."""
    made = sound("ur5", 1)
    for joint in range(6):
        speed = np.abs(np.diff(made.position[:, joint]))
        at = 1000 + int(np.argmax(speed[1000:2000]))
        torque = made.measured("torque")[:, joint]
        size = float(np.ptp(torque))
        later = np.arange(len(torque)) > at
        (fault,) = channel_faults(of_joint(made, joint, torque + size * later))
        assert (fault.kind, fault.name) == ("offset-step", made.names[joint])
        assert fault.first == pytest.approx(made.time[at + 1])


def test_copies_are_both_named_since_either_may_be_the_copy() -> None:
    """Torques and positions, and negatives."""
    for signal in ("torque", "position"):
        for sign in (1, -1):
            values = sound("ur5", 0).measured(signal).copy()
            values[:, 4] = sign * values[:, 1]
            names = sound("ur5", 0).names
            copied: dict[str, Any] = {signal: values}
            found = channel_faults(replace(sound("ur5", 0), **copied))
            wanted = {f"{signal} copied {names[1]}", f"{signal} copied {names[4]}"}
            assert wanted <= {named(each) for each in found}


def test_a_joint_that_rests_may_have_a_constant_torque() -> None:
    """And a gripper that is open or closed, a joint that nobody moved."""
    made = sound("ur5", 2)
    position, torque = made.position.copy(), made.measured("torque").copy()
    position[:, 5], torque[:, 5] = 0.3, 0.0
    rests = slice(500, None)
    position[rests, 4], torque[rests, 4] = position[500, 4], torque[500, 4]
    assert not channel_faults(replace(made, position=position, torque=torque))


def test_real_recordings_of_sound_robots_are_not_accused() -> None:
    """Noise, ripple, quantisation and filters of real drives."""
    real = [f"benchmarks/recordings/{name}/motion.toml" for name in ("ur10", "med7")]
    for path in (*real, "examples/tx40/tx40.toml", "examples/ur5e_plate/ur5e.toml"):
        assert not channel_faults(tb.import_recording(ROOT / path)), path


@pytest.mark.parametrize("engine", ["numpy", "compiled"])
def test_samples_that_are_left_out_may_hold_anything(engine: str) -> None:
    """Equations are exact sums over the samples that count: no value beside them enters."""
    made, tree = sound("ur5", 1), tb.load_tree(ROOT / "tests/golden/robots/ur5.urdf")
    settings = tb.Settings(engine="numpy" if engine == "numpy" else "compiled")
    found = []
    for value in (0.0, 7.5):
        torque = made.measured("torque")[:, 2].copy()
        torque[400:700] = value
        problem = Problem.from_recording(tree, of_joint(made, 2, torque), "torque", settings)
        assert [each.name for each in problem.channel_faults] == [tree.names[2]]
        found.append(problem.equations(problem.passes(1, whole=True)))
    whole = Problem.from_recording(tree, made, "torque", settings)
    every = whole.equations(whole.passes(1, whole=True))
    np.testing.assert_array_equal(found[0].normal, found[1].normal)
    np.testing.assert_array_equal(found[0].right, found[1].right)
    lost = every.used - found[0].used
    np.testing.assert_array_equal(np.delete(lost, 2), 0)
    assert lost[2] == pytest.approx(0.1 * every.used[2], rel=0.2)
    others, size = np.delete(every.normal - found[0].normal, 2, axis=0), every.normal.max()
    np.testing.assert_allclose(others, 0, atol=1e-12 * size)


def test_engines_make_the_same_rows_where_samples_are_left_out() -> None:
    """Clipped samples come and go within a row's filter."""
    made, tree = sound("ur5", 1), tb.load_tree(ROOT / "tests/golden/robots/ur5.urdf")
    spoiled, _ = planted(made, "limit, both sides, 30 %", 3)
    both = []
    for settings in (tb.Settings(engine="numpy"), tb.Settings(engine="compiled")):
        problem = Problem.from_recording(tree, spoiled, "torque", settings)
        both.append(problem.equations(problem.passes(1, whole=True)))
    size = np.abs(both[0].normal).max()
    np.testing.assert_allclose(both[0].normal, both[1].normal, atol=1e-9 * size)
    np.testing.assert_array_equal(both[0].used, both[1].used)


@pytest.mark.parametrize("plant", ["limit, both sides, 30 %", "zero mostly", "every fourth new"])
def test_estimates_of_what_is_left_are_as_good_as_they_say(plant: str) -> None:
    """And much better than with the samples that are wrong."""
    made, tree = sound("ur5", 1), tb.load_tree(ROOT / "tests/golden/robots/ur5.urdf")
    best = identify(tree, made, "torque")
    spoiled, _ = planted(made, plant, 3)
    left, with_all = (
        identify(tree, spoiled, "torque", settings=tb.Settings(leave_out=each))
        for each in ((), ("nothing",))
    )
    z, worse = ((each.values - best.values) / left.sigma for each in (left, with_all))
    assert np.sqrt(np.mean(z**2)) < 1.3
    assert np.sqrt(np.mean(worse**2)) > 1.5 * np.sqrt(np.mean(z**2))


def test_where_an_encoder_is_stuck_no_torque_counts() -> None:
    """All torques depend on its joint, as far as the filter on positions reaches."""
    made, tree = sound("ur5", 1), tb.load_tree(ROOT / "tests/golden/robots/ur5.urdf")
    position = made.position.copy()
    position[1000:1150, 1] = position[1000, 1]
    spoiled = replace(made, position=position)
    (fault,) = channel_faults(spoiled)
    assert named(fault) == f"position stuck {made.names[1]}"
    best, left, with_all = (
        identify(tree, each, "torque", settings=tb.Settings(leave_out=out))
        for each, out in ((made, ()), (spoiled, ()), (spoiled, ("nothing",)))
    )
    assert (np.array(left.samples) < best.samples).all()
    z, worse = ((each.values - best.values) / left.sigma for each in (left, with_all))
    assert np.sqrt(np.mean(z**2)) < 1 < np.sqrt(np.mean(worse**2))


def test_channels_are_left_out_by_name_and_unknown_ones_refused() -> None:
    """A pattern that names nothing would leave nothing out, unnoticed."""
    made, tree = sound("ur5", 1), tb.load_tree(ROOT / "tests/golden/robots/ur5.urdf")
    settings = tb.Settings(leave_out=("torque/*1",))
    problem = Problem.from_recording(tree, made, "torque", settings)
    used = problem.equations(problem.passes(1, whole=True)).used
    assert used[tree.index("j1")] == 0
    assert np.count_nonzero(used) == tree.n - 1
    with pytest.raises(UnknownName, match="torque/elbow"):
        Problem.from_recording(tree, made, "torque", tb.Settings(leave_out=("torque/elbow",)))


def test_the_check_of_a_log_names_its_channels_first() -> None:
    """What may follow from them comes after."""
    made, tree = sound("ur5", 1), tb.load_tree(ROOT / "tests/golden/robots/ur5.urdf")
    spoiled, fault = planted(made, "limit, both sides, 30 %", 3)
    first = assess_recording(tree, spoiled).diagnostics[0]
    assert first.code == "torque-column.clipped"
    assert fault.rpartition(" ")[2] in first.subject
