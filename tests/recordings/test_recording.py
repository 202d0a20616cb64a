"""Recordings come back as they were saved, and say what is wrong with them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

import testbed as tb
from testbed.errors import RecordingError
from testbed.instruments.chain import Instrument, measure
from testbed.recordings.geometry import check_robot, geometry
from testbed.recordings.recording import Recording, Truth
from tests.helpers.robots import random_robot


def truth(samples: int = 50, n: int = 2) -> Truth:
    rng = np.random.default_rng(0)
    q, qd, qdd, torque, friction = (rng.normal(size=(samples, n)) for _ in range(5))
    return Truth(q, qd, qdd, torque, friction, rng.normal(size=(samples, 6)))


def recording(instrument: Instrument | None = None, seed: int = 1) -> Recording:
    facts = {"seed": seed, "geometry": {}}
    time = np.arange(50) / 100
    return measure(
        instrument or Instrument(), ("a", "b"), time, truth(), np.arange(6.0), facts, seed
    )


def arrays(item: Recording) -> dict[str, np.ndarray]:
    groups = ("time", "position", "torque", "wrench", "velocity", "acceleration", "tare")
    found = {g: getattr(item, g) for g in groups if getattr(item, g) is not None}
    return found | {f"truth/{k}": v for k, v in vars(item.truth).items()}


def test_a_recording_comes_back_bit_for_bit(tmp_path: Path) -> None:
    for senses in (False, True):
        saved = recording(Instrument(senses_kinematics=senses, force_noise=1.0))
        saved.save(tmp_path / "r.parquet")
        loaded = Recording.load(tmp_path / "r.parquet")
        assert loaded.names == saved.names
        assert loaded.facts == saved.facts
        assert arrays(loaded).keys() == arrays(saved).keys()
        for key, values in arrays(saved).items():
            np.testing.assert_array_equal(arrays(loaded)[key], values)


def test_every_column_has_its_unit(tmp_path: Path, puma_recording: Recording) -> None:
    puma_recording.save(tmp_path / "r.parquet")
    schema = pq.read_schema(tmp_path / "r.parquet")
    units = {field.name: field.metadata[b"unit"].decode() for field in schema}
    assert units["time"] == "s"
    assert units["position/waist"] == "rad"
    assert units["torque/waist"] == "N m"
    assert units["truth/acceleration/elbow"] == "rad/s^2"
    assert units["truth/friction/elbow"] == "N m"
    assert (units["wrench/Fx"], units["wrench/Mx"]) == ("N", "N m")


def test_a_recording_knows_its_robot_seed_and_versions(puma_recording: Recording) -> None:
    facts = puma_recording.facts
    assert facts["seed"] == 1996
    assert set(facts["geometry"]) == {"waist", "shoulder", "elbow"}
    assert len(facts["model_sha256"]) == 64
    assert {"mujoco", "numpy", "testbed", "python"} <= set(facts["versions"])


def test_channels_have_noise_of_their_own() -> None:
    """Switching the plate's noise off leaves the drives' noise as it was."""
    both = recording(Instrument(torque_noise=1.0, force_noise=1.0, encoder_noise=1.0))
    one = recording(Instrument(torque_noise=1.0))
    np.testing.assert_array_equal(both.measured("torque"), one.measured("torque"))
    assert not np.array_equal(both.measured("wrench"), one.measured("wrench"))


def test_the_same_seed_gives_the_same_noise_and_another_another() -> None:
    noisy = Instrument(encoder_noise=1e-3, torque_noise=1.0, force_noise=1.0, moment_noise=1.0)
    for group in ("position", "torque", "wrench"):
        one, same, other = (getattr(recording(noisy, s), group) for s in (1, 1, 2))
        np.testing.assert_array_equal(one, same)
        assert not np.array_equal(one, other)


def test_noise_and_gain_are_what_was_asked() -> None:
    clean, n = truth(20_000), 20_000
    instrument = Instrument(
        encoder_resolution=1e-3,
        torque_noise=0.5,
        torque_constant_error={"b": 0.08},
        force_noise=2.0,
        moment_noise=0.1,
    )
    r = measure(instrument, ("a", "b"), np.arange(n) / 1e3, clean, np.zeros(6), {}, 3)
    np.testing.assert_allclose(r.position, clean.position, atol=0.5e-3 * (1 + 1e-9))
    np.testing.assert_allclose(r.position / 1e-3, np.round(r.position / 1e-3), atol=1e-6)
    assert np.std(r.measured("torque")[:, 0] - clean.torque[:, 0]) == pytest.approx(0.5, rel=0.03)
    assert np.std(r.measured("torque")[:, 1] - 1.08 * clean.torque[:, 1]) == pytest.approx(
        0.5, rel=0.03
    )
    spread = np.std(r.measured("wrench") - clean.wrench, axis=0)
    np.testing.assert_allclose(spread, [2, 2, 2, 0.1, 0.1, 0.1], rtol=0.03)


def test_a_value_that_is_no_number_is_named_with_its_sample_and_time(tmp_path: Path) -> None:
    bad = recording().measured("wrench").copy()
    bad[7, 2] = np.nan
    replace(recording(), wrench=bad).save(tmp_path / "r.parquet")
    with pytest.raises(RecordingError, match=r"'wrench/Fz' is nan at sample 7 \(t = 0\.07 s\)"):
        Recording.load(tmp_path / "r.parquet")


def test_uneven_sampling_is_named(tmp_path: Path) -> None:
    time = recording().time.copy()
    time[20:] += 0.005
    replace(recording(), time=time).save(tmp_path / "r.parquet")
    with pytest.raises(RecordingError, match="not uniform: 0.015 s after sample 19"):
        Recording.load(tmp_path / "r.parquet")


def test_a_missing_channel_is_named(tmp_path: Path) -> None:
    recording().save(tmp_path / "r.parquet")
    table = pq.read_table(tmp_path / "r.parquet").drop_columns(["wrench/My"])
    pq.write_table(table, tmp_path / "less.parquet")
    with pytest.raises(RecordingError, match="channel 'wrench/My' is missing"):
        Recording.load(tmp_path / "less.parquet")


@pytest.mark.parametrize("content", [b"", b"PAR1 truncated", b"time,position\n0,1\n"])
def test_a_damaged_file_is_said_to_be_damaged(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "r.parquet"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match="not a readable Parquet recording"):
        Recording.load(path)


def test_a_failed_save_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "r.parquet"
    recording().save(path)
    before = path.read_bytes()
    with pytest.raises(TypeError):
        replace(recording(), facts={"what": object()}).save(path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["r.parquet"]


def test_another_robot_is_recognised_by_names_and_by_geometry() -> None:
    tree = random_robot(np.random.default_rng(1), 2).tree()
    stranger = recording()
    with pytest.raises(RecordingError, match="another robot: it has the joints a, b"):
        check_robot(stranger, tree)
    mine = replace(stranger, names=tree.names, facts={"geometry": geometry(tree)})
    check_robot(mine, tree)
    other = geometry(tree)
    other[tree.names[1]]["offset"] = [9.0, 9.0, 9.0]
    with pytest.raises(RecordingError, match=f"joint '{tree.names[1]}' has offset"):
        check_robot(replace(mine, facts={"geometry": other}), tree)


def test_columns_are_mapped_by_name_never_by_position(puma: tb.Tree) -> None:
    names = ("elbow", "waist", "shoulder")
    position = np.tile([3.0, 1.0, 2.0], (50, 1))
    shuffled = Recording(names, np.arange(50.0), position, position, np.zeros((50, 6)))
    np.testing.assert_array_equal(shuffled.ordered(puma).position[0], [1, 2, 3])
    np.testing.assert_array_equal(shuffled.ordered(puma).measured("torque")[0], [1, 2, 3])


@pytest.mark.parametrize("content", [b"time,position\n0,1\n", b"", b"PAR"])
def test_what_is_no_recording_is_not_written_over(content: bytes, tmp_path: Path) -> None:
    """An older recording is; another file was somebody's."""
    path = tmp_path / "notes.csv"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match="is there and is no recording"):
        recording().save(path)
    assert path.read_bytes() == content
