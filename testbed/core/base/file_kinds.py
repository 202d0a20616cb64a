"""Kinds of files by their content, and where each belongs: arguments are easily exchanged."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from testbed.core.base.errors import TestbedError

HEAD = 65_536
"""Bytes at either end of a file in which its kind shows."""

TABLES = {
    "mapping": {"sources", "joints"},
    "motion": {"fundamental", "joint"},
    "plate's calibration": {"robot", "numbers"},
    "campaign": {"name", "experiment"},
    "experiment": {"model"},
}
"""Keys without which a TOML file is not of a kind; the first kind that has all counts."""

LOG = "log of another program"

BELONGS = {
    "mapping": "testbed import {} --out recording.parquet",
    "motion": "testbed view {}, or motion.file of an experiment",
    "plate's calibration": "--plate {}",
    "campaign": "testbed campaign {}",
    "experiment": "testbed run {}",
    "model file": "--model {}, or testbed new {} for an experiment",
    "recording": "testbed identify {} --model ROBOT",
    "campaign's table": "testbed campaign --summary {}",
    "result": "testbed validate RECORDING {}, or testbed sample {}",
    LOG: "testbed new ROBOT --recording {}",
}
"""Commands and options that take a file of each kind."""

LOGS = re.compile(
    r"\.(csv|tsv|mat|h5|hdf5|bag|db3|mcap|npz|c3d|parquet)(\.gz)?$", re.IGNORECASE
)
"""Names of other programs' files."""


def kind_of(path: Path) -> str:
    """Kind of a file, a key of `BELONGS`, by content, else by name; "" if unknown."""
    try:
        with path.open("rb") as file:
            head = file.read(HEAD)
            file.seek(max(path.stat().st_size - HEAD, 0))
            foot = file.read(HEAD)
    except OSError:
        return ""
    if head.startswith(b"PAR1"):
        if b"testbed campaign" in foot:
            return "campaign's table"
        return "recording" if b"position/" in foot else LOG
    if re.search(rb"<(robot|mujoco)\b", head):
        return "model file"
    if head.lstrip().startswith(b"{"):
        return (
            "result"
            if b'"estimates"' in head + foot or b'"posterior"' in head + foot
            else ""
        )
    try:
        found = kind_of_tables(tomllib.loads(head.decode()))
    except (ValueError, RecursionError):
        found = ""
    return found or (LOG if LOGS.search(path.name) else "")


def kind_of_tables(content: Mapping[str, Any]) -> str:
    """Kind of a TOML file by the keys of its content; "" if unknown."""
    return next((kind for kind, keys in TABLES.items() if keys <= {*content}), "")


def misplaced(path: Path, kind: str, asked: str) -> str:
    """Message on a file of another kind than asked for, and what takes it."""
    article = "an" if kind == "experiment" else "a"
    return f"'{path}' is {article} {kind}, no {asked}: {BELONGS[kind].replace('{}', str(path))}"


@contextmanager
def expecting(path: Path, *asked: str) -> Iterator[None]:
    """Reword errors of reading a file that is of another kind than asked for."""
    try:
        yield
    except (TestbedError, OSError) as error:
        if path.is_file() and (kind := kind_of(path)) and kind not in asked:
            error.args = (misplaced(path, kind, asked[0]),)
        raise
