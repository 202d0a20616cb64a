"""Generated equations as things that compute: modules, libraries, LaTeX read back."""

from __future__ import annotations

import ctypes
import importlib.util
import math
import re
import shutil
import subprocess
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from testbed.core.base.arrays import Array


def python_module(text: str, folder: Path) -> ModuleType:
    """Generated Python as a module, read from a file as Python reads files."""
    path = folder / "generated.py"
    path.write_text(text, encoding="utf-8")
    spec = importlib.util.spec_from_file_location("generated", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def c_library(text: str, folder: Path, *options: str) -> ctypes.CDLL:
    """Generated C as a library; warnings are errors."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("there is no C compiler 'cc' on this machine")
    (folder / "generated.c").write_text(text, encoding="utf-8")
    strict = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Wno-unused-parameter", "-Werror"]
    command = [compiler, *strict, *options, "-shared", "-fPIC", "-o", "generated.so"]
    subprocess.run([*command, "generated.c", "-lm"], cwd=folder, check=True)
    return ctypes.CDLL(str(folder / "generated.so"))


def c_call(
    library: ctypes.CDLL, name: str, inputs: Sequence[Array], shape: tuple[int, ...]
) -> Array:
    """A generated C function on one sample."""
    result = np.full(shape, np.nan)
    pointer = ctypes.POINTER(ctypes.c_double)
    kept = [np.ascontiguousarray(each) for each in (*inputs, result)]
    getattr(library, name)(*(each.ctypes.data_as(pointer) for each in kept))
    return kept[-1]


_BLOCK = re.compile(r"\\begin\{align\*\}\n(.*?)\n\\end\{align\*\}", re.DOTALL)
_LINE = re.compile(r"(?:^|(?<= \\\\\n))([^&\n]+?) (?:=\{\}&|&=) (.*?)(?= \\\\\n[^&]|\Z)", re.DOTALL)
_PARTS = (
    r"(?P<wave>[cs]_\{[-,\d]+\})|\\tfrac\{(?P<over>\d+)\}\{(?P<under>\d+)\}"
    r"|(?P<number>\d+(?:\.\d+)?)(?:\\cdot 10\^\{(?P<shift>-?\d+)\})?"
    r"|\^\{(?P<power>\d+)\}|(?P<times>\\,)|[-+() ]"
)


def latex_blocks(text: str) -> list[list[tuple[str, str]]]:
    """Left and right sides of a LaTeX document's equations, block by block."""
    return [
        [(left, right.replace(" \\\\\n&", " ")) for left, right in _LINE.findall(block)]
        for block in _BLOCK.findall(text)
    ]


def latex_reader(
    known: Iterable[str],
) -> Callable[[str, Mapping[str, float], Sequence[float]], float]:
    """What finds the value of the right-hand side of a LaTeX equation.

    Args:
        known: All names that may stand in one; it takes their values, and the joints' positions
            for sines and cosines. What is neither name nor number nor sign is no equation.
    """
    every = "|".join(map(re.escape, sorted(known, key=len, reverse=True))) or "(?!)"
    part = re.compile(f"(?P<name>{every})|{_PARTS}")

    def value(text: str, names: Mapping[str, float], q: Sequence[float]) -> float:
        def number(found: re.Match[str]) -> str:
            if found["name"]:
                return f"({float(names[found['name']])!r})"
            if found["wave"]:
                labels = found["wave"][3:-1]
                one = "," not in labels and len(q) < 10
                angle = sum(
                    math.copysign(1, int(k)) * q[abs(int(k)) - 1]
                    for k in (labels if one else labels.split(","))
                )
                return f"({math.cos(angle) if found['wave'][0] == 'c' else math.sin(angle)!r})"
            if found["over"]:
                return f"({found['over']}/{found['under']})"
            if found["number"]:
                return f"{found['number']}e{found['shift'] or 0}"
            return f"**{found['power']}" if found["power"] else "*" if found["times"] else found[0]

        assert not part.sub("", text), f"cannot read '{part.sub('', text)[:80]}'"
        return float(eval(part.sub(number, text), {"__builtins__": {}}))

    return value
