"""Generated equations as things that compute: modules, libraries, LaTeX read back."""

from __future__ import annotations

import ctypes
import importlib.util
import math
import re
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from testbed.arrays import Array


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
    strict = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror"]
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
_FRACTION = re.compile(r"\\tfrac\{(\d+)\}\{(\d+)\}")
_NUMBER = re.compile(r"\d+(?:\.\d+)?(?:\\cdot 10\^\{(-?\d+)\})?")
_POWER = re.compile(r"\^\{(\d+)\}")
_WAVE = re.compile(r"([cs])_\{([-,\d]+)\}")


def latex_blocks(text: str) -> list[list[tuple[str, str]]]:
    """Left and right sides of a LaTeX document's equations, block by block."""
    return [
        [
            (left, right.replace(" \\\\\n&", " "))
            for left, right in re.findall(
                r"(?:^|(?<= \\\\\n))([^&\n]+?) (?:=\{\}&|&=) (.*?)(?= \\\\\n[^&]|\Z)",
                block,
                re.DOTALL,
            )
        ]
        for block in _BLOCK.findall(text)
    ]


@dataclass
class LatexReader:
    """Recursive descent through the right-hand side of a LaTeX equation.

    Attributes:
        text: What is left to read.
        names: What names stand for.
        q: Positions of the joints, for sines and cosines.
    """

    text: str
    names: Mapping[str, float]
    q: Array

    def value(self) -> float:
        """Of the whole text."""
        total = self._sum()
        assert not self.text, f"cannot read '{self.text[:40]}'"
        return total

    def _sum(self) -> float:
        total, first = 0.0, True
        while first or self.text.startswith(("+", "-")):
            sign = -1.0 if self._taken("-") else 1.0
            self._taken("+")
            total += sign * self._product()
            first = False
        return total

    def _product(self) -> float:
        product = self._factor()
        while self._taken(r"\,"):
            product *= self._factor()
        return product

    def _factor(self) -> float:
        base = self._base()
        power = self._match(_POWER)
        return base ** int(power[1]) if power else base

    def _base(self) -> float:
        for name in sorted(self.names, key=len, reverse=True):
            if self._taken(name):
                return self.names[name]
        if self._taken("("):
            inside = self._sum()
            assert self._taken(")")
            return inside
        if found := self._match(_FRACTION):
            return int(found[1]) / int(found[2])
        if found := self._match(_WAVE):
            labels = found[2].split(",")
            if len(labels) == 1 and len(self.q) < 10:
                labels = list(labels[0])
            angle = sum(math.copysign(1, int(k)) * self.q[abs(int(k)) - 1] for k in labels)
            return math.cos(angle) if found[1] == "c" else math.sin(angle)
        found = self._match(_NUMBER)
        assert found, f"cannot read '{self.text[:40]}'"
        mantissa, _, _ = found[0].partition(r"\cdot")
        return float(f"{mantissa}e{found[1] or 0}")

    def _taken(self, word: str) -> bool:
        there = self.text.startswith(word)
        if there:
            self.text = self.text[len(word) :].lstrip(" ")
        return there

    def _match(self, pattern: re.Pattern[str]) -> re.Match[str] | None:
        found = pattern.match(self.text)
        if found:
            self.text = self.text[found.end() :].lstrip(" ")
        return found
