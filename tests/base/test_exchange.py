"""Folders take each other's place on systems that cannot exchange two names, too."""

from __future__ import annotations

import ctypes
import errno
from pathlib import Path

import pytest

from testbed.files import replacing


class Lacking:
    """A library of C without what exchanges names, or that refuses to."""

    def __init__(self, code: int | None) -> None:
        if code is not None:
            self.renameat2 = self.renamex_np = lambda *arguments: self._refuse(code)

    def _refuse(self, code: int) -> int:
        ctypes.set_errno(code)
        return -1


@pytest.mark.parametrize("code", [None, errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP])
def test_a_full_folder_is_replaced_all_the_same(
    code: int | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = tmp_path / "place"
    for content in ("old", "new"):
        with replacing(place, folder=True) as fresh:
            fresh.mkdir()
            (fresh / content).write_text(content)
        monkeypatch.setattr(ctypes, "CDLL", lambda *name, **kept: Lacking(code))
    assert [path.name for path in place.iterdir()] == ["new"]
    assert [path.name for path in tmp_path.iterdir()] == ["place"]
