"""Hostile logs of every format: bytes changed, pipes, links, bombs, many columns."""

from __future__ import annotations

import gzip
import io
import json
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import zstandard

from benchmarks.hostile.datasets import TRAPS, Files, good

MANY = 100_000
"""Columns that no robot has."""


@dataclass(frozen=True)
class Trap:
    """A log that would crash, hang or flood a reader.

    Attributes:
        files: By name.
        name: Of the file or folder that is read.
        links: As of a `Case`.
    """

    files: Files
    name: str
    links: dict[str, str] = field(default_factory=dict)


def _with_link(files: Files, ending: str, target: str) -> Trap:
    """A folder one of whose files is a link to something, or a pipe."""
    name = max(each for each in files if each.endswith(ending))
    kept = {each: data for each, data in files.items() if each != name}
    return Trap(kept | {f"elsewhere{ending}": files[name]}, "log", {name: target})


def _packed_bag(content: bytes) -> Trap:
    """A bag packed by zstd."""
    files = dict(good("bag folder")[0])
    name = next(name for name in files if name.endswith(".db3"))
    del files[name]
    about = files["log/metadata.yaml"].decode().replace(Path(name).name, f"{Path(name).name}.zstd")
    for key, value in (("compression_format", "zstd"), ("compression_mode", "file")):
        lines = [each for each in about.splitlines() if not each.strip().startswith(key)]
        about = "\n".join([lines[0], f"  {key}: {value}", *lines[1:]])
    packed = zstandard.ZstdCompressor(level=3).compress(content)
    return Trap(files | {"log/metadata.yaml": about.encode(), f"{name}.zstd": packed}, "log")


def _wide_dataset() -> Trap:
    names = [f"f{k}" for k in range(300)]
    about = {name: {"dtype": "float32", "shape": [10_000]} for name in names}
    info = {"codebase_version": "v3.0", "fps": 30, "features": about}
    columns = {"episode_index": [0] * 5, "timestamp": [k / 30 for k in range(5)]}
    files = {"log/meta/info.json": json.dumps(info).encode()}
    table = pa.table(columns | dict.fromkeys(names, [[1.0, 2.0]] * 5))
    return Trap(files | {"log/data/a.parquet": _parquet(table)}, "log")


def _parquet(table: pa.Table) -> bytes:
    sink = io.BytesIO()
    pq.write_table(table, sink)
    return sink.getvalue()


def _wide_parquet() -> Trap:
    table = pa.table({f"q{k}": [0.0, 1.0, 2.0] for k in range(20_000)})
    return Trap({"log.parquet": _parquet(table)}, "log.parquet")


def _npz(arrays: dict[str, np.ndarray]) -> Trap:
    sink = io.BytesIO()
    np.savez(sink, **arrays)  # type: ignore[arg-type]
    return Trap({"log.npz": sink.getvalue()}, "log.npz")


def _csv(text: bytes, *, packed: bool = False) -> Trap:
    name = "log.csv.gz" if packed else "log.csv"
    return Trap({name: gzip.compress(text) if packed else text}, name)


def _c3d() -> Trap:
    points = 65_535
    head = struct.pack("<BBHHHHHfHHf", 2, 80, points, 0, 1, 2, 10, 1.0, 3, 1, 100.0)
    data = head.ljust(512, b"\0") + b"\x01\x50\x01\x54".ljust(512, b"\0") + bytes(16 * points)
    return Trap({"log.c3d": data}, "log.c3d")


def _rows(count: int) -> bytes:
    return b"".join(b",".join([b"%d.5" % k] * 4) + b"\n" for k in range(count))


LOG_TRAPS: dict[str, Callable[[], Trap]] = {
    **{f"a pipe{end}": lambda name=f"log{end}": Trap({}, name, {name: ""})  # type: ignore[misc]
       for end in (".csv", ".csv.gz", ".npz", ".parquet", ".mat", ".h5", ".bag", ".db3", ".mcap",
                   ".rrd", ".c3d")},
    "a device": lambda: Trap({}, "log.csv", {"log.csv": "/dev/zero"}),
    "bag: a pipe": lambda: _with_link(good("bag folder")[0], ".db3", ""),
    "bag: a link outwards": lambda: _with_link(good("bag folder")[0], ".db3", "../elsewhere.db3"),
    "bag: a link to itself": lambda: _with_link(good("bag folder")[0], ".db3", "log_0.db3"),
    "bag: 800 MB by zstd": lambda: _packed_bag(bytes(800_000_000)),
    "bag: noise by zstd": lambda: _packed_bag(b"noise" * 1000),
    "dataset: a device": lambda: _with_link(good("v3.0")[0], ".parquet", "/dev/zero"),
    "dataset: a link outwards": lambda: _with_link(good("v3.0")[0], ".parquet", "/etc/passwd"),
    "dataset: 3 million columns": _wide_dataset,
    "parquet: 20000 columns": _wide_parquet,
    "npz: 12000 arrays": lambda: _npz({f"q{k}": np.arange(9.0) for k in range(12_000)}),
    "npz: a wide array": lambda: _npz({"q": np.zeros((3, 9000)), "p": np.zeros((9000, 9000), "?")}),
    "npz: two lengths": lambda: _npz({"time": np.arange(90.0), "q": np.arange(60.0)}),
    "csv: many columns": lambda: _csv((b"1," * MANY + b"1\n") * 3),
    "csv: many words": lambda: _csv((b"a," * 15_000 + b"1\n") * 80),
    "csv: many large numbers": lambda: _csv((b"9007199254740995," * 3000 + b"1\n") * 9),
    "csv: words among numbers": lambda: _csv(_rows(99) + b"x,x,x,x\n" + _rows(99)),
    "csv: one line by gzip": lambda: _csv(b"1," * 50_000_000, packed=True),
    "csv: no line by gzip": lambda: _csv(b"\n" * 100_000_000, packed=True),
    "csv: short lines by gzip": lambda: _csv(b"1,2\n" * 20_000_000, packed=True),
    "csv: times of both ends": lambda: _csv(
        b"time,q,a\n" + b"-9223372036854775808,1,2\n9223372036854775807,2,3\n" * 99
    ),
    "csv: cut in a line": lambda: _csv(_rows(99)[:-9]),
    "c3d: 65535 points": _c3d,
}  # fmt: skip
"""Small logs that would harm a reader."""


@cache
def trap(name: str) -> Trap:
    """A trap of this module or of `datasets`, made once."""
    if name in LOG_TRAPS:
        return LOG_TRAPS[name]()
    files = TRAPS[name]()
    return Trap(files, next(iter(files)))
