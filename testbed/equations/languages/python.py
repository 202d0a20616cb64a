"""Equations as a Python module that needs NumPy only and takes any number of samples."""

from __future__ import annotations

from testbed.equations.equations import Equations, Listing
from testbed.equations.expression import Factor
from testbed.equations.languages.text import (
    assignments,
    decimal,
    function_name,
    inputs,
    preface,
    used_constants,
    wrap,
)
from testbed.equations.program import Program, leaves

MOST_TERMS = 500
"""Terms of one Python expression; a few thousand overflow the compiler's stack."""

_FIRST_LINES = ("# -*- coding: utf-8 -*-", "# Written by testbed.")
"""In the first two lines Python looks for a coding: nothing from a model file stands there."""

_FRAME = '''

def _in_blocks(function, shape, motion, parameters, size):
    """Blocks of samples, so that intermediates stay in the processor's cache."""
    motion = [np.asarray(signal, dtype=np.float64) for signal in motion]
    lead = motion[0].shape[:-1]
    if any(signal.shape != (*lead, JOINTS) for signal in motion):
        raise ValueError(f"coordinates of shape (..., {JOINTS}), one joint a column")
    if parameters is not None:
        parameters = np.asarray(parameters, dtype=np.float64).ravel()
        if parameters.shape != (size,):
            raise ValueError(f"{size} parameters, found {parameters.size}")
    flat = [signal.reshape(-1, JOINTS) for signal in motion]
    samples = len(flat[0])
    result = np.zeros((samples, *shape))
    for first in range(0, samples, BLOCK):
        part = [np.ascontiguousarray(signal[first : first + BLOCK].T) for signal in flat]
        function(*part, parameters, np.moveaxis(result[first : first + BLOCK], 0, -1))
    return result.reshape(*lead, *shape)
'''


def python(listing: Listing, source: str) -> str:
    """A Python module; arguments as for `write_equations`."""
    lines = [
        *_FIRST_LINES,
        *(f"# {line}".rstrip() for line in preface(listing, source)),
    ]
    lines += ["", "import numpy as np", "from numpy import cos, sin", ""]
    lines += [f"JOINTS = {listing.tree.n}", "BLOCK = 2048  # samples at once"]
    lines += [
        f"{name} = {decimal(value)}  # {unit}"
        for name, value, unit in used_constants(listing)
    ]
    for each in listing.equations:
        lines += _vector(each)
    text = "\n".join(lines) + _FRAME
    for each in listing.equations:
        text += "\n".join(["", "", *_front(each), "", "", *_body(each)]) + "\n"
    return text


def _vector(each: Equations) -> list[str]:
    """Names and units of the parameters, in order."""
    lines = ["", f"{function_name(each).upper()}_{each.vector.upper()} = ("]
    lines += [f'    "{each.name}",  # {each.unit}' for each in each.parameters]
    return [*lines, ")"]


def _front(each: Equations) -> list[str]:
    """The function people call."""
    name, size = function_name(each), len(each.parameters)
    takes, shape = ", ".join(each.kind.takes), str(each.shape)
    vector = "" if each.kind.is_regressor else f", {each.vector}"
    needs = "" if each.kind.is_regressor else f" and {each.vector} of shape ({size},)"
    comma = "," if len(each.kind.takes) == 1 else ""
    return [
        f"def {name}({takes}{vector}):",
        f'    """{each.kind.says}',
        "",
        f"    Takes {takes} of shape (..., joints){needs}; gives (..., {shape.strip('(),')}).",
        '    """',
        f"    motion = ({takes}{comma})",
        f"    return _in_blocks(_{name}, {shape}, motion{vector or ', None'}, {size})",
    ]


def _body(each: Equations) -> list[str]:
    """The lines of the program, on one block: coordinates (joints, samples)."""
    lines = [
        f"def _{function_name(each)}({', '.join(each.kind.takes)}, {each.vector}, result):"
    ]
    lines += [f"    {name} = {source}" for name, source in inputs(each)]
    unused = last_uses(each.program)
    for (label, value), (target, pieces) in zip(
        each.program.lines, assignments(each), strict=True
    ):
        for first in range(0, len(pieces) if value else 0, MOST_TERMS):
            part = pieces[first : first + MOST_TERMS]
            sum_of = wrap(f"    {target} {'+=' if first else '='} (", part, "        ")
            lines += [sum_of[0].replace("= ( ", "= (", 1), *sum_of[1:]]
            lines[-1] += ")"
        if label in unused:  # memory that is given back at once stays in the cache
            lines.append(f"    del {', '.join(unused[label])}")
    return lines if len(lines) > 1 else [*lines, "    del result  # all zero"]


def last_uses(program: Program) -> dict[Factor, list[str]]:
    """Auxiliary variables by the line that is the last to need them."""
    needed = {name for name, _ in program.steps} - program.results
    found: dict[Factor, list[str]] = {}
    for name, value in reversed(program.steps):
        last = needed.intersection(leaves(value))
        needed -= last
        if last:
            found[name] = sorted(factor.name for factor in last)
    return found
