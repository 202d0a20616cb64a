"""Recognition of file kinds by content, and messages about files of the wrong kind.

Arguments of a command are easily interchanged; the message gives the option that takes the file.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from testbed.core.base.errors import TestbedError

HEAD_BYTES = 65_536
"""Number of bytes read at the beginning and at the end of a file to recognise its kind."""

REQUIRED_KEYS = {
    "mapping": {"sources", "joints"},
    "motion": {"fundamental", "joint"},
    "plate's calibration": {"robot", "numbers"},
    "campaign": {"name", "experiment"},
    "experiment": {"model"},
}
"""Required keys of each kind of TOML file; the first kind whose keys are all present applies."""

FOREIGN_LOG = "log of another program"
"""Kind of a data file written by another program."""

USAGE = {
    "mapping": "testbed import {} --out recording.parquet",
    "motion": "testbed view {}, or motion.file of an experiment",
    "plate's calibration": "--plate {}",
    "campaign": "testbed campaign {}",
    "experiment": "testbed run {}",
    "model file": "--model {}, or testbed new {} for an experiment",
    "recording": "testbed identify {} --model ROBOT",
    "campaign's table": "testbed campaign --summary {}",
    "result": "testbed validate RECORDING {}, or testbed sample {}",
    FOREIGN_LOG: "testbed new ROBOT --recording {}",
}
"""Command or option that takes a file, keyed by kind of file."""

LOG_NAMES = re.compile(
    r"\.(csv|tsv|mat|h5|hdf5|bag|db3|mcap|npz|c3d|parquet)(\.gz)?$", re.IGNORECASE
)
"""Pattern of the names of data files written by other programs."""


def kind_of(path: Path) -> str:
    """Kind of a file, determined from content or name: a key of `USAGE` or "".

    The content is recognised by the signature of Parquet files, XML tags of models, and keys of
    results and TOML tables. The name is used only for logs of other programs. The result is "" for
    unknown and unreadable files.

    Args:
        path: The file.
    """
    try:
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
            file.seek(max(path.stat().st_size - HEAD_BYTES, 0))
            tail = file.read(HEAD_BYTES)
    except OSError:
        return ""
    if head.startswith(b"PAR1"):
        if b"testbed campaign" in tail:
            return "campaign's table"
        return "recording" if b"position/" in tail else FOREIGN_LOG
    if re.search(rb"<(robot|mujoco)\b", head):
        return "model file"
    if head.lstrip().startswith(b"{"):
        return (
            "result"
            if b'"estimates"' in head + tail or b'"posterior"' in head + tail
            else ""
        )
    try:
        kind = kind_of_tables(tomllib.loads(head.decode()))
    except (ValueError, RecursionError):
        kind = ""
    return kind or (FOREIGN_LOG if LOG_NAMES.search(path.name) else "")


def kind_of_tables(content: Mapping[str, Any]) -> str:
    """Kind of a TOML file, determined from the keys of its content; "" if unknown.

    The result is the first kind of `REQUIRED_KEYS` whose keys are all present.
    """
    return next(
        (kind for kind, keys in REQUIRED_KEYS.items() if keys <= {*content}), ""
    )


def wrong_kind_message(path: Path, kind: str, expected: str) -> str:
    """Message about a file of the wrong kind, with the option that takes this kind.

    Args:
        path: The file.
        kind: Kind of the file.
        expected: Kind that was expected.
    """
    article = "an" if kind == "experiment" else "a"
    return f"'{path}' is {article} {kind}, no {expected}: {USAGE[kind].replace('{}', str(path))}"


@contextmanager
def explain_wrong_kind(path: Path, *expected: str) -> Iterator[None]:
    """Context manager that rewords read errors if the file is of an unexpected kind.

    The text of a `TestbedError` or `OSError` is replaced by that of `wrong_kind_message`, and the
    error is raised again.

    Args:
        path: The file.
        *expected: Kinds that may be read; the usual kind comes first.
    """
    try:
        yield
    except (TestbedError, OSError) as error:
        if path.is_file() and (kind := kind_of(path)) and kind not in expected:
            error.args = (wrong_kind_message(path, kind, expected[0]),)
        raise
