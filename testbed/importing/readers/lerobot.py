"""LeRobot datasets (v2.1, v3.0): a folder with `meta/info.json` and Parquet files of episodes.

The elements of a feature are columns named after the elements, for example
observation.state/elbow.pos. Pauses are inserted between successive episodes, and an import is
divided there. Files are searched for in the folder `data`; paths in the dataset's description are
ignored.

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
    MAX_COLUMNS,
    MAX_NUMBERS,
    ForeignTable,
    check_count,
    reading_errors_as_recording_errors,
)
from testbed.importing.readers.parquet_columns import read_column

VERSIONS = ("v2", "v3")
"""Beginnings of the known versions of the format."""

MAX_INFO_BYTES = 10_000_000
"""Largest size of `meta/info.json` [bytes]."""

MIN_PAUSE, MIN_PAUSE_FRAMES = 1.0, 10.0
"""Pause between episodes [s], and in frames if that is longer."""

INDEX_COLUMNS = ("episode_index", "frame_index", "index", "task_index")
"""Columns of indices, which are no signals."""


def read_file(path: Path) -> ForeignTable:
    """Read the columns of all episodes of a dataset, with pauses between the episodes.

    The elements of a feature are columns, for example observation.state/elbow.pos or
    observation.state[0].

    Args:
        path: Folder, or one of its Parquet files.

    Raises:
        RecordingError: The dataset is damaged or has an unknown version.
    """
    with reading_errors_as_recording_errors(path):
        features, fps = _features_and_rate(
            path if path.is_dir() else path.absolute().parents[2]
        )
        candidates = (path / "data").rglob("*.parquet") if path.is_dir() else [path]
        files = sorted(each for each in candidates if each.is_file())
        if not files:
            raise RecordingError(
                f"{path}: there is no Parquet file in its folder 'data'"
            )
        if sum(pq.read_metadata(file).num_rows for file in files) > MAX_NUMBERS:
            raise RecordingError(
                f"{path}: more than {MAX_NUMBERS:.0e} rows; name an episode's file"
            )
        time = _row_times(
            path,
            _feature_values(files, "episode_index"),
            _feature_values(files, "timestamp"),
            fps,
        )
        columns: dict[str, tuple[str, int]] = {}
        for feature in pq.read_schema(files[0]).names:
            if feature in features and feature not in (*INDEX_COLUMNS, "timestamp"):
                elements = _element_names(feature, features[feature])
                columns |= {column: (feature, k) for k, column in enumerate(elements)}
                check_count(path, "columns", len(columns), MAX_COLUMNS)

    @lru_cache(maxsize=2)
    def values(feature: str) -> Array:
        """Values of a feature, (M, k)."""
        return _feature_values(files, feature).reshape(len(time), -1).astype(np.float64)

    def load(name: str) -> Array:
        if name == "timestamp":
            return time
        feature, k = columns[name]
        return values(feature)[:, k]

    shapes = dict.fromkeys(("timestamp", *columns), time.shape)
    return ForeignTable(path, shapes, load, {"timestamp": "s"})


def _feature_values(files: Sequence[Path], feature: str) -> NDArray[Any]:
    """Values of a feature in several files, concatenated."""
    opened_files = (pq.ParquetFile(file, pre_buffer=False) for file in files)
    return np.concatenate([read_column(each, feature) for each in opened_files])


def _features_and_rate(path: Path) -> tuple[dict[str, Any], float]:
    """Descriptions of a dataset's features, keyed by name, and frame rate [Hz].

    Args:
        path: Folder of the dataset.

    Raises:
        RecordingError: `meta/info.json` is too large, is incomplete or has an unknown version.
    """
    with (path / "meta" / "info.json").open("rb") as stream:
        text = stream.read(MAX_INFO_BYTES + 1)
    if len(text) > MAX_INFO_BYTES:
        raise RecordingError(
            f"{path}: meta/info.json has more than {MAX_INFO_BYTES} bytes"
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
        raise RecordingError(f"{path}: meta/info.json has no `features` and `fps`")
    if not str(version := info.get("codebase_version")).startswith(VERSIONS):
        raise RecordingError(
            f"{path}: a LeRobot dataset of version {str(version)[:20]}; 2.1 and 3.0 are known, "
            "LeRobot converts others"
        )
    return features, float(fps)


def _row_times(
    path: Path, episode: NDArray[Any], stamp: NDArray[Any], fps: float
) -> Array:
    """Times of rows with a pause between successive episodes, (M,) [s].

    The pause is 1 s, or ten frames if that is longer.

    Args:
        path: Folder or file, for error messages.
        episode: Episode index of each row, (M,).
        stamp: Time in the episode, (M,) [s].
        fps: Frame rate [Hz].

    Raises:
        RecordingError: The rows of an episode are not contiguous.
    """
    if episode.dtype.kind not in "iu":
        raise RecordingError(f"{path}: 'episode_index' is not whole numbers")
    time = stamp.astype(np.float64)
    first = np.flatnonzero(np.append(True, np.diff(episode) != 0))
    last = np.append(first[1:], len(episode)) - 1
    if len(first) > len(np.unique(episode)):
        raise RecordingError(f"{path}: rows of an episode are not one after the other")
    if len(first) == 1:
        return time
    pause = max(MIN_PAUSE, MIN_PAUSE_FRAMES / fps)
    starts = np.append(0.0, np.cumsum(time[last] - time[first] + pause)[:-1])
    return time + np.repeat(starts - time[first], last - first + 1)


def _element_names(feature: str, description: Any) -> list[str]:
    """Column names of a feature's elements; empty if the feature is not a numeric vector.

    The names are FEATURE/NAME if the description has a unique name for each element, and FEATURE[k]
    otherwise.

    Args:
        feature: Name of the feature.
        description: Entry of the feature in `meta/info.json`.
    """
    description = description if isinstance(description, dict) else {}
    kind, shape, names = (description.get(key) for key in ("dtype", "shape", "names"))
    if not re.fullmatch(r"u?int\d+|float\d+|bool", str(kind)) or not isinstance(
        shape, list
    ):
        return []
    count = shape[0] if len(shape) == 1 and isinstance(shape[0], int) else 0
    if not 1 <= count <= MAX_COLUMNS:
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
