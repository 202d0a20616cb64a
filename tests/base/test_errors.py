"""Errors carry what they are about, and say what to do."""

from __future__ import annotations

import inspect

import pytest

from testbed import errors
from testbed.errors import (
    FreeRootError,
    InertiaError,
    MimicError,
    UnknownName,
    UnseenParameters,
    plural,
    printable,
)

KINDS = [
    each for each in vars(errors).values() if inspect.isclass(each) and issubclass(each, Exception)
]


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_every_error_is_one_of_the_projects(kind: type[Exception]) -> None:
    assert issubclass(kind, errors.TestbedError)
    assert kind.__doc__


def test_flaws_are_kept_and_listed() -> None:
    error = InertiaError("arm.urdf", ["link 'a' is wrong", "link 'b' is wrong"])
    assert error.flaws == ("link 'a' is wrong", "link 'b' is wrong")
    assert "arm.urdf: link 'a' is wrong; link 'b' is wrong. " in str(error)
    assert "`testbed new`" in str(error)


def test_a_free_root_is_named_with_the_way_out() -> None:
    error = FreeRootError("humanoid.xml", "root")
    assert error.joint == "root"
    assert "humanoid.xml" in str(error)
    assert "'root'" in str(error)
    assert "--weld-root" in str(error)


def test_a_name_nearly_known_is_proposed_and_a_strange_one_is_not() -> None:
    near = UnknownName("joint", "elbw", iter(["waist", "elbow"]))
    assert (near.name, near.known) == ("elbw", ("waist", "elbow"))
    assert str(near) == "unknown joint 'elbw'; did you mean 'elbow'? (known: waist, elbow)"
    assert str(UnknownName("joint", "xyz", ["waist"])) == "unknown joint 'xyz' (known: waist)"


@pytest.mark.parametrize(("count", "rest"), [(30, ""), (31, ", ...")])
def test_of_many_names_the_first_are_listed_and_any_may_be_meant(count: int, rest: str) -> None:
    """Names too long to be searched are not listed either."""
    names = ["w" * 201, *(f"column {k}" for k in range(count - 1)), "elbow torque"]
    listed = ", ".join(names[1:31])
    error = UnknownName("column", "elbow torqe", names)
    assert error.known == tuple(names)
    assert str(error).endswith(f"; did you mean 'elbow torque'? (known: {listed}{rest})")
    assert "did you mean" not in str(UnknownName("column", "w" * 201, names))


def test_unseen_parameters_are_counted_and_named() -> None:
    error = UnseenParameters(["K1zz", "mb2x"], 5, 7, 100)
    assert error.names == ("K1zz", "mb2x")
    assert error.rank == 5
    assert "100 samples determine only 5 of 7 unknowns" in str(error)
    assert "K1zz, mb2x" in str(error)


MIMICS = {f"finger{k}": f"knuckle{k}" for k in range(1, 6)}


def test_joints_that_follow_are_named_with_all_ways_out() -> None:
    one = MimicError("hand.urdf", {"left": "right"}, ["right", "left", "right"])
    assert one.masters == {"left": "right"}
    assert str(one).startswith(
        "hand.urdf: joint 'left' follows 'right', which a tree cannot express. "
        "--lock right --lock left holds followed and followers; --lock-mimic holds followers only"
    )
    assert "lock={'right': None}" in str(one)


def test_of_many_joints_that_follow_the_first_few_are_spelled_out() -> None:
    said = str(MimicError("hand.urdf", MIMICS, list(MIMICS)))
    assert "joint 'finger1' follows 'knuckle1' (5 such joints), which" in said
    assert "--lock finger1 --lock finger2 --lock finger3 --lock finger4 ... holds" in said
    assert "--lock finger4 holds" in str(MimicError("hand.urdf", MIMICS, list(MIMICS)[:4]))


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("plain text, with ümlauts and 漢字", "plain text, with ümlauts and 漢字"),
        ("  two\nlines\t and \u2028 more  ", "two lines and more"),
        ("\x1b[31mred\x1b[0m", r"\x1b[31mred\x1b[0m"),
        ("a\x9bb", r"a\x9bb"),
        ("right\u202eleft", r"right\u202eleft"),
        ("zero\x00byte", r"zero\x00byte"),
        ("", ""),
    ],
)
def test_what_a_terminal_would_obey_is_spelled_out(text: str, shown: str) -> None:
    assert printable(text) == shown
    assert printable(text).isprintable()


def test_long_text_keeps_its_ends_and_says_how_long_it_was() -> None:
    text = "".join(chr(ord("a") + k % 26) for k in range(10_000))
    shown = printable(text)
    assert len(shown) == 500
    start, end = shown.split(" ... (10000 characters in all) ... ")
    assert text.startswith(start)
    assert text.endswith(end)
    assert 0 <= len(start) - len(end) <= 1
    assert printable(text[:500]) == text[:500]
    assert printable(text[:501]) != text[:501]


@pytest.mark.parametrize("limit", [20, 21, 60, 90, 100])
def test_the_limit_holds_and_spelled_characters_stay_whole(limit: int) -> None:
    """The result is as long as it may be, but for a spelled character that does not fit."""
    for text in ("x" * 1000, "\x1b" * 1000, "ab\x1b" * 300):
        shown = printable(text, limit)
        assert limit - 6 <= len(shown) <= limit
        assert shown.isprintable()
        start, _, end = shown.partition("...")
        whole = "".join(c if c.isprintable() else r"\x1b" for c in text)
        assert whole.startswith(start.partition(" ")[0])
        assert whole.endswith(end.rpartition(" ")[2].lstrip("."))
        assert not start.rstrip(" ").endswith(("\\", "\\x", "\\x1"))
    assert ("characters in all" in printable("x" * 1000, limit)) == (limit > 70)


@pytest.mark.parametrize(("count", "said"), [(0, "0 samples"), (1, "1 sample"), (2, "2 samples")])
def test_one_of_a_kind_is_no_plural(count: int, said: str) -> None:
    assert plural(count, "sample") == said
