"""Equations as C99 functions without dependencies, for one sample per call."""

from __future__ import annotations

from testbed.equations.equations import Equations, Listing
from testbed.equations.languages.text import (
    assignment_texts,
    decimal,
    function_name,
    header_and_definitions,
    input_variables,
    used_constants,
    wrap,
)


def c(listing: Listing, source: str) -> str:
    """Write equations as C functions; arguments as for `write_equations`."""
    lines = [
        "/*",
        *(f" * {line}".rstrip() for line in header_and_definitions(listing, source)),
        " */",
    ]
    lines += ["#include <math.h>", ""]
    for name, value, unit in used_constants(listing):
        lines.append(f"static const double {name} = {decimal(value)}; /* {unit} */")
    for each in listing.equations:
        lines += ["", *_comment(each), *_function(each, listing.tree.n)]
    return "\n".join(lines) + "\n"


def _comment(each: Equations) -> list[str]:
    """Lines of the comment above a function: description and parameters."""
    lines = wrap("/*", each.kind.description.split(), " * ")
    if not each.kind.is_regressor:
        names = [f"{p.name} [{p.unit}]," for p in each.parameters]
        names[-1:] = [name.rstrip(",") for name in names[-1:]]
        lines += wrap(f" * {each.parameter_vector_name}:", names, " * ")
    return [*lines, " */"]


def _function(each: Equations, joints: int) -> list[str]:
    """Lines of the C function of one kind of equations.

    Args:
        each: Equations of the kind.
        joints: Number of joints.
    """
    arguments = [f"const double {name}[{joints}]," for name in each.kind.takes]
    if not each.kind.is_regressor:
        arguments.append(
            f"const double {each.parameter_vector_name}[{max(1, len(each.parameters))}],"
        )
    size = "".join(f"[{max(1, size)}]" for size in each.shape)
    arguments.append(f"double result{size})")
    lines = [f"void {function_name(each)}(", *wrap("   ", arguments, "    "), "{"]
    lines += [
        f"    const double {name} = {source};" for name, source in input_variables(each)
    ]
    for target, pieces in assignment_texts(each):
        declared = target if target.startswith("result") else f"const double {target}"
        lines += wrap(f"    {declared} =", pieces, "        ")
        lines[-1] += ";"
    return [*lines, "}"]
