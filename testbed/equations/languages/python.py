"""Equations as a NumPy-only Python module, for arrays of samples."""

from __future__ import annotations

from testbed.equations.equations import Equations, Listing
from testbed.equations.expression import Factor
from testbed.equations.languages.text import (
    assignment_texts,
    decimal,
    function_name,
    header_and_definitions,
    input_variables,
    used_constants,
    wrap,
)
from testbed.equations.program import Program, leaf_factors

MAX_TERMS_PER_EXPRESSION = 500
"""Largest number of terms per Python expression; thousands overflow the parser's stack."""

_FIRST_LINES = ("# -*- coding: utf-8 -*-", "# Written by testbed.")
"""Fixed first two lines: Python reads a coding from these, and model names must not set it."""

_BLOCK_LOOP = '''

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


def write_python(listing: Listing, source: str) -> str:
    """Write equations as a Python module; arguments as for `write_equations`."""
    lines = [
        *_FIRST_LINES,
        *(f"# {line}".rstrip() for line in header_and_definitions(listing, source)),
    ]
    lines += ["", "import numpy as np", "from numpy import cos, sin", ""]
    lines += [f"JOINTS = {listing.tree.n}", "BLOCK = 2048  # samples at once"]
    lines += [
        f"{name} = {decimal(value)}  # {unit}"
        for name, value, unit in used_constants(listing)
    ]
    for each in listing.equations:
        lines += _parameter_names(each)
    text = "\n".join(lines) + _BLOCK_LOOP
    for each in listing.equations:
        text += (
            "\n".join(["", "", *_public_function(each), "", "", *_block_function(each)])
            + "\n"
        )
    return text


def _parameter_names(each: Equations) -> list[str]:
    """Lines of a tuple of parameter names, with units as comments."""
    lines = [
        "",
        f"{function_name(each).upper()}_{each.parameter_vector_name.upper()} = (",
    ]
    lines += [f'    "{each.name}",  # {each.unit}' for each in each.parameters]
    return [*lines, ")"]


def _public_function(each: Equations) -> list[str]:
    """Lines of the public function, which calls the block function for blocks of samples."""
    name, size = function_name(each), len(each.parameters)
    takes, shape = ", ".join(each.kind.takes), str(each.shape)
    vector = "" if each.kind.is_regressor else f", {each.parameter_vector_name}"
    needs = (
        ""
        if each.kind.is_regressor
        else f" and {each.parameter_vector_name} of shape ({size},)"
    )
    comma = "," if len(each.kind.takes) == 1 else ""
    return [
        f"def {name}({takes}{vector}):",
        f'    """{each.kind.description}',
        "",
        f"    Takes {takes} of shape (..., joints){needs}; gives (..., {shape.strip('(),')}).",
        '    """',
        f"    motion = ({takes}{comma})",
        f"    return _in_blocks(_{name}, {shape}, motion{vector or ', None'}, {size})",
    ]


def _block_function(each: Equations) -> list[str]:
    """Lines of the block function, which computes the program for one block of samples.

    The coordinates that the function takes have shape (joints, samples).
    """
    lines = [
        f"def _{function_name(each)}({', '.join(each.kind.takes)}, "
        f"{each.parameter_vector_name}, result):"
    ]
    lines += [f"    {name} = {source}" for name, source in input_variables(each)]
    unused = last_uses(each.program)
    for (label, value), (target, pieces) in zip(
        each.program.lines, assignment_texts(each), strict=True
    ):
        for first in range(0, len(pieces) if value else 0, MAX_TERMS_PER_EXPRESSION):
            part = pieces[first : first + MAX_TERMS_PER_EXPRESSION]
            sum_of = wrap(f"    {target} {'+=' if first else '='} (", part, "        ")
            lines += [sum_of[0].replace("= ( ", "= (", 1), *sum_of[1:]]
            lines[-1] += ")"
        if label in unused:  # memory that is released at once stays in the cache
            lines.append(f"    del {', '.join(unused[label])}")
    return lines if len(lines) > 1 else [*lines, "    del result  # all zero"]


def last_uses(program: Program) -> dict[Factor, list[str]]:
    """Names of auxiliary variables, keyed by the line of the last use."""
    unused = {name for name, _ in program.steps} - program.results
    by_line: dict[Factor, list[str]] = {}
    for name, value in reversed(program.steps):
        used = unused.intersection(leaf_factors(value))
        unused -= used
        if used:
            by_line[name] = sorted(factor.name for factor in used)
    return by_line
