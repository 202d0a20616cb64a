"""Recordings of robots on a base that moves: held against the model as others are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import testbed as tb
from testbed.arrays import Array
from testbed.errors import RecordingError
from testbed.excitation.fourier import Fourier
from testbed.recordings.measured_base import with_base_joints
from testbed.robot.free_base import FREE, coordinates, on_free_base, poses
from testbed.sanity.accept import accept
from testbed.sanity.sanity import check_sanity
from tests.helpers.measured import random_fourier
from tests.helpers.robots import random_robot


@cache
def right(seed: int) -> tuple[tb.Tree, tb.Recording]:
    """A random tree that rides on a base, and a recording that is true of it."""
    rng = np.random.default_rng(seed)
    tree = random_robot(rng, 3).tree()
    free = on_free_base(tree)
    whole = random_fourier(free, rng, 1.0)
    share = np.where(np.arange(free.n) < FREE, 0.3, 1.0)[:, None]
    motion = Fourier(
        whole.fundamental, share[:, 0] * whole.offset, share * whole.sine, share * whole.cosine
    )
    time = np.arange(0, 12, 5e-3)
    path = motion.at(time)
    wrench = tb.base_wrench(free, path) + rng.normal(size=(len(time), 6)) * 0.05
    base = poses(path.q[:, :FREE])
    recording = tb.Recording(
        tree.names, time, path.q[:, FREE:], wrench=wrench, tare=np.zeros(6), base=base
    )
    return free, recording


def of_base(
    size: float = 1, order: tuple[int, ...] = (0, 1, 2, 3)
) -> Callable[[tb.Recording], tb.Recording]:
    """The pose in another unit, its quaternion in another order."""

    def spoilt(recording: tb.Recording) -> tb.Recording:
        base = recording.measured("base")
        return replace(recording, base=np.hstack([base[:, :3] * size, base[:, 3:][:, list(order)]]))

    return spoilt


WRONG: dict[str, tuple[Callable[[tb.Recording], tb.Recording], str]] = {
    "mm as m": (of_base(1e3), '[base] unit = "mm"'),
    "x y z w": (of_base(order=(1, 2, 3, 0)), '[base] quaternion = ["w", "x", "y", "z"]'),
    "sense": (lambda r: replace(r, wrench=-r.measured("wrench")), '[wrench] sense = "on_robot"'),
    "degrees": (
        lambda r: replace(r, position=r.position * [np.rad2deg(1), 1, np.rad2deg(1)]),
        '[position] unit = ["deg", "m", "deg"]',
    ),
    "a sign": (
        lambda r: replace(r, position=r.position * [1, -1, 1]),
        "[position] sign = [1, -1, 1]",
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("mistake", WRONG)
def test_a_wrong_mapping_is_refused_with_its_cure(mistake: str) -> None:
    free, recording = right(11)
    spoil, cure = WRONG[mistake]
    told = {"joints": list(recording.names), "wrench": {"sense": "on_plate"}}
    spoilt = replace(spoil(recording), facts={"mapping": told})
    with pytest.raises(RecordingError, match="cannot be true of this robot") as found:
        accept(free, spoilt)
    assert cure in str(found.value)


@pytest.mark.parametrize("seed", range(11, 15))
def test_a_right_one_is_not_refused_whatever_the_masses(seed: int) -> None:
    free, recording = right(seed)
    factors = 2.0 ** np.random.default_rng(seed).uniform(-1, 1, free.n)
    scaled = [
        tb.Inertia(i.mass * x, i.first_moment * x, i.tensor * x)
        for i, x in zip(free.inertias, factors, strict=True)
    ]
    rough = replace(free, inertias=tuple(scaled))
    assert check_sanity(rough, with_base_joints(recording)).certain == ()


@pytest.mark.slow
def test_several_plates_are_named_in_the_cure() -> None:
    free, recording = right(11)
    plates = {name: {"sense": "on_robot", "units": ["N", "N m"]} for name in ("left", "right")}
    told = {"mapping": {"joints": list(recording.names), "plates": plates}}
    turned = replace(recording, wrench=-recording.measured("wrench"), facts=told)
    with pytest.raises(RecordingError) as found:
        accept(free, turned)
    assert '[plates.left] sense = "on_plate"; [plates.right] sense = "on_plate"' in str(found.value)


@pytest.mark.slow
def test_a_moving_base_that_is_taken_as_welded_is_refused() -> None:
    """Unless it is to be only warned of; a pose that stays where it is says nothing."""
    free, recording = right(11)
    welded = tb.Tree(
        free.name,
        tuple(replace(j, parent=max(j.parent - FREE, -1)) for j in free.joints[FREE:]),
        free.inertias[FREE:],
    )
    with pytest.raises(RecordingError, match="robot.base=measured"):
        accept(welded, recording)
    assert any(
        "robot.base=measured" in w for w in accept(welded, recording, unchecked=True).warnings
    )


@pytest.mark.parametrize("seed", range(3))
def test_poses_are_coordinates_undone(seed: int) -> None:
    given: Array = np.random.default_rng(seed).uniform(-1.3, 1.3, (50, FREE))
    np.testing.assert_allclose(coordinates(poses(given)), given, atol=1e-12)
