"""Equations as a Python module that needs NumPy only and takes any number of samples."""

from __future__ import annotations

from testbed.equations.equations import Equations, Listing
from testbed.equations.languages.text import (
    Style,
    decimal,
    function_name,
    inputs,
    last_uses,
    own_name,
    preface,
    references,
    terms,
    used_constants,
    wrap,
)

MOST_TERMS = 500
"""Terms of one Python expression; a few thousand overflow the compiler's stack."""
STYLE = Style(own_name, decimal, plus_first=True)

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
    lines = [*_FIRST_LINES, *(f"# {line}".rstrip() for line in preface(listing, source))]
    lines += ["", "import numpy as np", "from numpy import cos, sin", ""]
    lines += [f"JOINTS = {listing.tree.n}", "BLOCK = 4096  # samples at once"]
    lines += [
        f"{name} = {decimal(value)}  # {unit}" for name, value, unit in used_constants(listing)
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
    name, again, done = function_name(each), references(each), last_uses(each.program)
    lines = [f"def _{name}({', '.join(each.kind.takes)}, {each.vector}, result):"]
    lines += [f"    {name} = {source}" for name, source in inputs(each, STYLE)]
    for label, value in each.program.lines:
        pieces = terms(value, STYLE)
        if label not in each.places:
            lines += _assigned(label.name, pieces)
        elif value:
            target = f"result[{', '.join(str(index) for index in each.places[label])}]"
            if label in again:
                lines += _assigned(label.name, pieces)
                pieces = [label.name]
            lines += _assigned(target, pieces)
        if label in done:  # memory that is given back at once stays in the cache
            lines += _deleted(done[label])
    return lines if len(lines) > 1 else [*lines, "    del result  # all zero"]


def _deleted(names: list[str]) -> list[str]:
    return [f"    del {', '.join(names[k : k + 8])}" for k in range(0, len(names), 8)]


def _assigned(target: str, pieces: list[str]) -> list[str]:
    """One assignment; a sum longer than the compiler can take is added up in parts."""
    lines = []
    for first in range(0, len(pieces), MOST_TERMS):
        part = pieces[first : first + MOST_TERMS]
        sign = "+=" if first else "="
        short = wrap(f"    {target} {sign}", part, "")
        if len(short) == 1:
            lines += short
        else:
            lines += [f"    {target} {sign} (", *wrap("       ", part, "        "), "    )"]
    return lines
