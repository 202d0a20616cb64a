"""Edits of XML as bytes: what was asked is there, and nothing else has changed."""

from __future__ import annotations

import pytest

from testbed.errors import ModelError
from testbed.robot.formats.xml_bytes import XmlBytes, comment

TEXT = b"""<?xml version="1.0"?>
<!-- a <link name="no"/> here -->
<robot name = "r">
  <link name='a' note="x > y"><mass value="1" /></link>
\t<link name="b"
        note='"'   />
  <link/><link></link>
</robot>
"""


def edits(data: bytes = TEXT) -> XmlBytes:
    return XmlBytes(data, "r.urdf")


def test_elements_are_where_they_stand() -> None:
    root = edits().root
    assert (root.tag, dict(root.attributes)) == ("robot", {"name": "r"})
    a, b, alone, empty = root.named("link")
    assert root.named("mass") == []
    assert dict(a.attributes) == {"name": "a", "note": "x > y"}
    assert TEXT[a.start : a.opened] == b"<link name='a' note=\"x > y\">"
    assert TEXT[b.start : b.opened].endswith(b"/>")
    assert [each.alone for each in (a, b, alone, empty)] == [False, True, True, False]
    assert [child.tag for child in a.children] == ["mass"]
    assert len(root.named("link", "mass")) == 4


def test_nothing_asked_is_nothing_changed() -> None:
    found = edits()
    found.set(found.root.children[0], other=None)
    assert found.edited() == TEXT


@pytest.mark.parametrize(
    ("place", "values", "old", "new"),
    [
        (0, {"name": "c"}, b"'a'", b"'c'"),
        (0, {"note": None}, b' note="x > y"', b""),
        (0, {"name": None, "note": "z"}, b" name='a' note=\"x > y\"", b' note="z"'),
        (1, {"more": "1 2"}, b"note='\"'   />", b'note=\'"\' more="1 2"   />'),
        (2, {"p": "1", "q": "2"}, b"<link/>", b'<link p="1" q="2"/>'),
        (3, {"p": "1"}, b"<link></link>", b'<link p="1"></link>'),
        (1, {"note": "n", "name": "m"}, b'"b"\n        note=\'"\'', b"\"m\"\n        note='n'"),
    ],
)
def test_attributes_are_set_added_and_taken_out(
    place: int, values: dict[str, str | None], old: bytes, new: bytes
) -> None:
    found = edits()
    found.set(found.root.children[place], **values)
    assert TEXT.count(old) == 1
    assert found.edited() == TEXT.replace(old, new)


def test_what_is_put_first_stands_on_its_own_line() -> None:
    """Indented as its element is; one without an end tag gets one."""
    found = edits()
    a, b, alone, empty = found.root.children
    found.insert(a, "<first/>")
    found.insert(b, "<second/>")
    found.insert(empty, "<third/>")
    wanted = TEXT.replace(b'y">', b'y">\n    <first/>')
    wanted = wanted.replace(b"note='\"'   />", b"note='\"'>\n\t  <second/>\n\t</link>")
    wanted = wanted.replace(b"<link></link>", b"<link>\n  <third/></link>")
    assert found.edited() == wanted
    assert alone.alone


def test_lines_end_as_they_do_in_the_file() -> None:
    found = edits(TEXT.replace(b"\n", b"\r\n"))
    found.insert(found.root.children[1], "<second/>")
    assert b"'\"'>\r\n\t  <second/>\r\n\t</link>\r\n" in found.edited()
    assert b"\n" not in found.edited().replace(b"\r\n", b"")


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (TEXT.decode().encode("utf-16"), "r.urdf: only files in UTF-8 or another encoding of by"),
        (TEXT.decode().encode("utf-16-le"), "only files in UTF-8"),
        (b"<robot>", "r.urdf: not well-formed XML"),
        (b"", "r.urdf: not well-formed XML"),
        (b"<!DOCTYPE robot><robot/>", "r.urdf: a file with a DOCTYPE is not edited; take it out"),
    ],
)
def test_files_that_cannot_be_edited_are_refused(data: bytes, said: str) -> None:
    with pytest.raises(ModelError, match=said):
        edits(data)


def test_comments_hold_any_text() -> None:
    text = comment(["a -- b", "  c---d", "ü"])
    assert text == "<!-- a - - b c- - -d \\xfc -->"
    assert "--" not in text[4:-3]
