"""docs/extending.md: a format of recordings as printed, at work; its blocks run with all others."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import testbed as tb
from testbed.recordings import formats
from tests.helpers.ideal import ideal
from tests.helpers.paths import ROOT

TEXT = (ROOT / "docs/extending.md").read_text()


def test_a_format_is_one_module_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, puma: tb.Tree
) -> None:
    name, source = re.findall(r"```python file=(\S+)\n(.*?)```", TEXT, re.DOTALL)[0]
    (tmp_path / name).write_text(source)
    monkeypatch.setattr(formats, "__path__", [*formats.__path__, str(tmp_path)])
    assert formats.formats() == (".npz", ".parquet")
    recording = replace(ideal(puma, duration=4.0), tare=None)
    columns: dict[str, Any] = recording.columns()
    np.savez(tmp_path / "r.npz", **columns)
    loaded = tb.Recording.load(tmp_path / "r.npz")
    np.testing.assert_array_equal(loaded.measured("wrench"), recording.measured("wrench"))
    exact = tb.Settings(position_cutoff="off", cutoff="off")
    for method in ("external", "internal"):
        one = tb.identify(puma, tmp_path / "r.npz", method, settings=exact)
        other = tb.identify(puma, recording, method, settings=exact)
        np.testing.assert_array_equal(one.values, other.values)
