"""Numba decorators of the kernel, options for the processor, and the folder of compiled code."""

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

settings: Any = config  # its names are made while Numba is imported

HAS_WIDE_VECTORS = "+avx512f" in (
    settings.CPU_FEATURES or binding.get_host_cpu_features().flatten()
)
"""True if the processor has 32 vector registers, enough for products of four by four columns."""


def compiled_folder() -> Path:
    """Folder of compiled code, private to the user, one per version of the sources.

    Numba's cache contains executable code. A temporary folder is used if other users can write to
    the cache folder, or if it cannot be created.
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
        pass  # no home folder, or no permission
    temporary = Path(tempfile.mkdtemp(prefix="testbed-kernel-"))
    atexit.register(shutil.rmtree, temporary, ignore_errors=True)
    return temporary


def _is_private(folder: Path) -> bool:
    """True if a folder belongs to the user and other users cannot write to it."""
    if not hasattr(os, "getuid"):
        return True
    state = folder.stat()
    others = stat.S_IWGRP | stat.S_IWOTH
    return state.st_uid == os.getuid() and not state.st_mode & others


if not settings.CACHE_DIR:
    settings.CACHE_DIR = str(compiled_folder())

# Without Numba's reference counts, one per slice, the recursion is a quarter faster; compiled
# functions do not allocate arrays.
_compiled: Any = partial(njit, _nrt=False)
llvm_inline = _compiled(fastmath={"contract"}, forceinline=True)
"""Decorator of functions inlined by LLVM, with fused multiply-add."""
compiled_function = _compiled(fastmath={"contract"})
"""Decorator of compiled functions, with fused multiply-add."""
numba_inline = _compiled(fastmath={"contract"}, inline="always")
"""Decorator of functions inlined by Numba, with fused multiply-add."""
inline_sum = _compiled(fastmath={"contract", "reassoc", "nsz"}, forceinline=True)
"""Decorator of inlined functions whose sums may be reordered."""
compiled_entry = _compiled(nogil=True, cache=True)
"""Decorator of functions called from Python: cached, run without the GIL."""


intrinsic: Any = extending.intrinsic


@intrinsic  # type: ignore[untyped-decorator]
def call_address(typing: Any, address: Any, arguments: Any) -> Any:
    """Call a C function without return value at an address, as a Numba intrinsic.

    Unlike a function that calls through ctypes, the caller can be cached by Numba.

    Args:
        typing: Typing context of Numba.
        address: Address of the function.
        arguments: Tuple of numbers and addresses, with exactly the types of the C function.
    """
    del typing

    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        function, packed = values
        parts = [
            builder.extract_value(packed, k) for k in range(len(signature.args[1]))
        ]
        kind = ir.FunctionType(ir.VoidType(), [value.type for value in parts])
        builder.call(builder.inttoptr(function, kind.as_pointer()), parts)
        return context.get_dummy_value()

    return types.void(address, arguments), code
