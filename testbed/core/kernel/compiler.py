"""How the kernel is compiled: options, what fits the processor, and the cache."""

from __future__ import annotations

import atexit
import hashlib
import os
import shutil
import stat
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import llvmlite
import numba
from llvmlite import binding, ir
from numba import extending, njit, types
from numba.core import config

from testbed.core.base.cache import cache_folder
from testbed.core.robot import friction, laws

settings: Any = config  # whose names Numba makes while it loads

WIDE = "+avx512f" in (
    settings.CPU_FEATURES or binding.get_host_cpu_features().flatten()
)
"""Whether there are 32 vector registers, enough for tiles of four slots by four."""


def compiled_folder() -> Path:
    """Where compiled code is kept: one user's own folder, one per version of the sources.

    Numba's cache is executable code; a folder that others can write to is not used.
    """
    base = cache_folder()
    digest = hashlib.sha256(f"{numba.__version__} {llvmlite.__version__}".encode())
    folders = (Path(__file__).parent, *map(Path, laws.__path__))
    sources = (each for folder in folders for each in sorted(folder.glob("*.py")))
    for source in (*sources, Path(friction.__file__)):
        digest.update(source.read_bytes())
    folder = base / f"kernel-{digest.hexdigest()[:16]}"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if all(_is_private(each) for each in (base, folder)):
            return folder
    except OSError:
        pass  # no home, or not ours to write to
    alone = Path(tempfile.mkdtemp(prefix="testbed-kernel-"))
    atexit.register(shutil.rmtree, alone, ignore_errors=True)
    return alone


def _is_private(folder: Path) -> bool:
    if not hasattr(os, "getuid"):
        return True
    state = folder.stat()
    others = stat.S_IWGRP | stat.S_IWOTH
    return state.st_uid == os.getuid() and not state.st_mode & others


if not settings.CACHE_DIR:
    settings.CACHE_DIR = str(compiled_folder())

# Without Numba's reference counts, of which every slice takes one, the recursion is a quarter
# faster; nothing here makes or keeps arrays.
_compiled: Any = partial(njit, _nrt=False)
inline = _compiled(fastmath={"contract"}, forceinline=True)
plain = _compiled(fastmath={"contract"})
part = _compiled(fastmath={"contract"}, inline="always")
summing = _compiled(fastmath={"contract", "reassoc", "nsz"}, forceinline=True)
outer = _compiled(nogil=True, cache=True)


intrinsic: Any = extending.intrinsic


@intrinsic  # type: ignore[untyped-decorator]
def call(typing: Any, address: Any, arguments: Any) -> Any:
    """A C function that returns nothing, by its address: unlike one of ctypes it can be cached.

    Args:
        typing: Numba's context.
        address: Of the function.
        arguments: A tuple of numbers and addresses, of the very types that it takes.
    """
    del typing

    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        function, packed = values
        parts = [
            builder.extract_value(packed, k) for k in range(len(signature.args[1]))
        ]
        kind = ir.FunctionType(ir.VoidType(), [part.type for part in parts])
        builder.call(builder.inttoptr(function, kind.as_pointer()), parts)
        return context.get_dummy_value()

    return types.void(address, arguments), code
