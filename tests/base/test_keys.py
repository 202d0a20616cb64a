"""What a key of a kind's table takes, and what is said of all else."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import pytest

from testbed.errors import SettingsError
from testbed.keys import COUNTS, LARGEST, Key, hidden, key
from testbed.kind_table import KindTable

SIX = [[float(6 * row + column) for column in range(6)] for row in range(6)]


@pytest.mark.parametrize(
    ("members", "value", "kept"),
    [
        ("", 3, 3.0),
        ("word", "waist", "waist"),
        ("axes", [1, 2, 3], (1.0, 2.0, 3.0)),
        ("channels", 2, 2.0),
        ("channels", (1,) * 6, (1.0,) * 6),
        ("joints", [1, 2], (1.0, 2.0)),
        ("joints", {"waist": 1}, {"waist": 1.0}),
        ("matrix", SIX, tuple(map(tuple, SIX))),
    ],
)
def test_values_are_kept_as_floats_tuples_and_tables(members: str, value: Any, kept: Any) -> None:
    assert Key(members).checked(value, "gain") == kept


@pytest.mark.parametrize(
    ("members", "value", "wanted"),
    [
        ("", "3", "a number"),
        ("", True, "a number"),
        ("", [1.0], "a number"),
        ("", {"waist": 1.0}, "a number"),
        ("", None, "a number"),
        ("", 1.01 * LARGEST, "a number"),
        ("", float("nan"), "a number"),
        ("word", 3, "a name"),
        ("axes", [1, 2], "a number, or a list of three"),
        ("channels", [1] * 5, "a number, or a list of six"),
        ("axes", {"x": 1}, "a number, or a list of three"),
        ("joints", [], "a number, a list of one a joint"),
        ("joints", {"waist": "far"}, "a number, a list of one a joint"),
        ("matrix", SIX[:5], "six lists of six numbers"),
        ("matrix", [row[:5] for row in SIX], "six lists of six numbers"),
        ("matrix", 3.0, "six lists of six numbers"),
    ],
)
def test_what_it_does_not_take_is_said_with_what_it_takes(
    members: str, value: Any, wanted: str
) -> None:
    with pytest.raises(SettingsError) as told:
        Key(members).checked(value, "bias: size")
    assert str(told.value).startswith(f"bias: size is {wanted}")
    assert f"found {value!r}"[:40] in str(told.value)


def test_what_was_found_is_cut_where_it_is_long() -> None:
    with pytest.raises(SettingsError) as told:
        Key("word").checked([0.125] * 100, "a")
    assert len(str(told.value)) < 100
    assert str(told.value).endswith("...")


@pytest.mark.parametrize(
    ("bounds", "good", "bad", "words"),
    [
        ({"least": 2.0}, (2.0, 5.0), (1.99, -3.0), "a number at least 2"),
        ({"most": 2.0}, (2.0, -5.0), (2.01,), "a number at most 2"),
        ({"least": 0.0, "most": 1.0}, (0.0, 1.0), (-0.1, 1.1), "a number at least 0 and at most 1"),
        ({"positive": True}, (1e-9, 1e9), (0.0, -1.0, 1e-10), "a positive number"),
        ({"whole": True}, (-3, 4.0), (0.5,), "a whole number"),
        ({"positive": True, "whole": True}, (1,), (0, 1.5), "a positive whole number"),
    ],
)
def test_bounds_belong_to_what_they_bound(
    bounds: dict[str, Any], good: tuple[float, ...], bad: tuple[float, ...], words: str
) -> None:
    for value in good:
        kept = Key(**bounds).checked(value, "n")
        assert kept == value
        assert isinstance(kept, int) == ("whole" in bounds)
    for value in bad:
        with pytest.raises(SettingsError, match=f"^n is {words}, found"):
            Key(**bounds).checked(value, "n")


def test_lists_of_joints_have_any_length_and_others_their_own() -> None:
    for members in ("axes", "channels", "joints"):
        for count in range(1, 9):
            takes = count == COUNTS.get(members, count)
            if takes:
                assert len(Key(members).checked([1.0] * count, "n")) == count
            else:
                with pytest.raises(SettingsError):
                    Key(members).checked([1.0] * count, "n")


@dataclass(frozen=True, eq=False)
class Ramp(KindTable):
    """Made up for this test."""

    kind: ClassVar[str] = "ramp"
    slope: float | dict[str, float] = key(1.0, "joints")
    start: float | None = key(None)
    seed: int = hidden(7)


def test_values_are_their_tables_whatever_they_are_installed_on() -> None:
    one, other = Ramp({"waist": 2}), Ramp({"waist": 2.0}, seed=8)
    assert one == other
    assert hash(one) == hash(other)
    assert len({one, other, Ramp()}) == 2
    assert one.table() == {"kind": "ramp", "slope": {"waist": 2.0}}
    assert Ramp(start=3.0).table() == {"kind": "ramp", "slope": 1.0, "start": 3.0}
    assert one != one.table()
    assert set(Ramp.known_keys()) == {"slope", "start"}
    assert one.by_joint == {"slope": {"waist": 2.0}}
    with pytest.raises(SettingsError, match="^ramp: start is a number, found 'now'"):
        Ramp(start="now")  # type: ignore[arg-type]
