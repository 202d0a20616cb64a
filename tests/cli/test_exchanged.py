"""A file that is given for another kind: the refusal says what it is and where it belongs."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from testbed.core.base.file_kinds import BELONGS, kind_of
from tests.helpers.command import command_line
from tests.helpers.paths import ROOT

FILES = {
    "model file": ("puma562.xml", "two.urdf"),
    "recording": ("one.parquet",),
    "log of another program": ("log.csv",),
    "result": ("result.json", "run/result.json"),
    "experiment": ("table.toml",),
    "campaign": ("quick.toml",),
    "mapping": ("map.toml",),
}
"""Files of each kind; see conftest.py."""

ASKED = {
    "identify FILE --model puma562.xml": ("recording", "mapping"),
    "identify one.parquet --model FILE": ("model file",),
    "validate one.parquet FILE": ("result",),
    "minimal FILE": ("model file",),
    "run FILE": ("experiment",),
    "campaign FILE": ("campaign",),
    "import FILE --out new.parquet": ("mapping",),
    "new FILE": ("model file",),
    "report FILE --model puma562.xml": ("recording", "mapping"),
    "view FILE --model puma562.xml --save new.rrd": ("recording", "mapping"),
    "excite FILE": ("model file", "experiment"),
    "identify one.parquet --model puma562.xml --plate FILE": (),
}
"""Commands, and kinds of the file that they take."""


def test_every_file_is_known_by_its_content(place: Path, tmp_path: Path) -> None:
    """Whatever its name is, but for logs, which may be anything."""
    for kind, names in FILES.items():
        for name in names:
            assert kind_of(place / name) == kind
            if "log" not in kind:
                assert kind_of(Path(shutil.copy(place / name, tmp_path / "any"))) == kind
    shipped = {"experiment": "experiments/*.toml", "campaign": "experiments/campaigns/*.toml"}
    for kind, pattern in shipped.items():
        assert {kind_of(path) for path in ROOT.glob(pattern)} == {kind}


@pytest.mark.slow
@pytest.mark.parametrize("words", ASKED)
def test_a_command_says_what_it_was_given(words: str, place: Path, tmp_path: Path) -> None:
    shutil.copytree(place, home := tmp_path / "home")
    for kind, names in FILES.items():
        for name in names if kind not in ASKED[words] else ():
            done = command_line(*words.replace("FILE", name).split(), cwd=home)
            assert done.returncode == 2, (words, name)
            (line,) = done.stderr.replace(f"{home}/", "").splitlines()
            assert kind in line, line
            assert BELONGS[kind].replace("{}", name) in line, line
            assert len(line) <= 300, line


def test_an_option_that_is_none_points_to_the_help_of_its_command(tmp_path: Path) -> None:
    for words in ("run", "run --frce", "simulate x.toml --out x.csv"):
        done = command_line(*words.split(), cwd=tmp_path)
        assert f"testbed {words.split()[0]} --help" in done.stderr
    assert "testbed --help" in command_line("--nothing", cwd=tmp_path).stderr
