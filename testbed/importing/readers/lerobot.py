"""LeRobot's datasets (v2.1, v3.0): a folder with `meta/info.json` and Parquet files of episodes.

Elements of a feature are columns of their names, as observation.state/elbow.pos. Episodes come one
after the other with a silence between them, at which an import is cut. Files are found in the
folder `data`, never by what the dataset says of their paths.

Source    The dataset formats v2.1 and v3.0 of github.com/huggingface/lerobot
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray

from testbed.core.base.arrays import Array
from testbed.core.base.errors import RecordingError
from testbed.importing.foreign_table import (
    MOST_COLUMNS,
    MOST_NUMBERS,
    ForeignTable,
    check_count,
    readable,
)
from testbed.importing.readers.parquet_columns import read_column

VERSIONS = ("v2", "v3")
"""Beginnings of the formats' versions that are known."""

LONGEST_INFO = 10_000_000
"""Bytes of `meta/info.json`."""

SILENCE, SILENT_FRAMES = 1.0, 10.0
"""Between episodes [s], or so many frames if that is more."""

COUNTED = ("episode_index", "frame_index", "index", "task_index")
"""Columns that number what is in a row."""


def read_file(path: Path) -> ForeignTable:
    """Columns of all episodes of a dataset.

    Args:
        path: The folder, or one of its Parquet files.

    Raises:
        RecordingError: It is damaged, or of another version.
    """
    with readable(path):
        features, fps = _info(path if path.is_dir() else path.absolute().parents[2])
        found = (path / "data").rglob("*.parquet") if path.is_dir() else [path]
        files = sorted(each for each in found if each.is_file())
        if not files:
            raise RecordingError(
                f"{path}: there is no Parquet file in its folder 'data'"
            )
        if sum(pq.read_metadata(file).num_rows for file in files) > MOST_NUMBERS:
            raise RecordingError(
                f"{path}: more than {MOST_NUMBERS:.0e} rows; name an episode's file"
            )
        time = _times(
            path, _read(files, "episode_index"), _read(files, "timestamp"), fps
        )
        columns: dict[str, tuple[str, int]] = {}
        for feature in pq.read_schema(files[0]).names:
            if feature in features and feature not in (*COUNTED, "timestamp"):
                own = _columns(feature, features[feature])
                columns |= {column: (feature, k) for k, column in enumerate(own)}
                check_count(path, "columns", len(columns), MOST_COLUMNS)

    @lru_cache(maxsize=2)
    def values(feature: str) -> Array:
        """A feature, (M, k)."""
        return _read(files, feature).reshape(len(time), -1).astype(np.float64)

    def load(name: str) -> Array:
        if name == "timestamp":
            return time
        feature, k = columns[name]
        return values(feature)[:, k]

    shapes = dict.fromkeys(("timestamp", *columns), time.shape)
    return ForeignTable(path, shapes, load, {"timestamp": "s"})


def _read(files: Sequence[Path], feature: str) -> NDArray[Any]:
    """A feature of several files."""
    opened = (pq.ParquetFile(file, pre_buffer=False) for file in files)
    return np.concatenate([read_column(each, feature) for each in opened])


def _info(path: Path) -> tuple[dict[str, Any], float]:
    """Features of a dataset by their names, and its rate [Hz]."""
    with (path / "meta" / "info.json").open("rb") as stream:
        text = stream.read(LONGEST_INFO + 1)
    if len(text) > LONGEST_INFO:
        raise RecordingError(
            f"{path}: meta/info.json has more than {LONGEST_INFO} bytes"
        )
    info = json.loads(text)
    features, fps = (
        info.get(key) if isinstance(info, dict) else None for key in ("features", "fps")
    )
    if (
        not isinstance(features, dict)
        or not isinstance(fps, int | float)
        or not 0 < fps < 1e6
    ):
        raise RecordingError(f"{path}: meta/info.json says no `features` and `fps`")
    if not str(version := info.get("codebase_version")).startswith(VERSIONS):
        raise RecordingError(
            f"{path}: a LeRobot dataset of version {str(version)[:20]}; 2.1 and 3.0 are known, "
            "LeRobot converts others"
        )
    return features, float(fps)


def _times(path: Path, episode: NDArray[Any], stamp: NDArray[Any], fps: float) -> Array:
    """Times of rows, a silence between two episodes, (M,) [s]."""
    if episode.dtype.kind not in "iu":
        raise RecordingError(f"{path}: 'episode_index' is not whole numbers")
    time = stamp.astype(np.float64)
    first = np.flatnonzero(np.append(True, np.diff(episode) != 0))
    last = np.append(first[1:], len(episode)) - 1
    if len(first) > len(np.unique(episode)):
        raise RecordingError(f"{path}: rows of an episode are not one after the other")
    if len(first) == 1:
        return time
    pause = max(SILENCE, SILENT_FRAMES / fps)
    starts = np.append(0.0, np.cumsum(time[last] - time[first] + pause)[:-1])
    return time + np.repeat(starts - time[first], last - first + 1)


def _columns(feature: str, about: Any) -> list[str]:
    """Names of a feature's elements; none if it is no row of numbers."""
    about = about if isinstance(about, dict) else {}
    kind, shape, names = (about.get(key) for key in ("dtype", "shape", "names"))
    if not re.fullmatch(r"u?int\d+|float\d+|bool", str(kind)) or not isinstance(
        shape, list
    ):
        return []
    count = shape[0] if len(shape) == 1 and isinstance(shape[0], int) else 0
    if not 1 <= count <= MOST_COLUMNS:
        return []
    if isinstance(names, dict) and len(names) == 1:  # as {"motors": [...]}
        (names,) = names.values()
    texts = (
        {each for each in names if isinstance(each, str)}
        if isinstance(names, list)
        else ()
    )
    if isinstance(names, list) and len(texts) == len(names) == count > 1:
        return [f"{feature}/{name}" for name in names]
    return [feature] if count == 1 else [f"{feature}[{k}]" for k in range(count)]
