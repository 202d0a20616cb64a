"""Equations as C99 without dependencies, one sample a call."""

from __future__ import annotations

from testbed.equations.equations import Equations, Listing
from testbed.equations.languages.text import (
    assignments,
    decimal,
    function_name,
    inputs,
    preface,
    used_constants,
    wrap,
)


def c(listing: Listing, source: str) -> str:
    """C functions; arguments as for `write_equations`."""
    lines = ["/*", *(f" * {line}".rstrip() for line in preface(listing, source)), " */"]
    lines += ["#include <math.h>", ""]
    for name, value, unit in used_constants(listing):
        lines.append(f"static const double {name} = {decimal(value)}; /* {unit} */")
    for each in listing.equations:
        lines += ["", *_comment(each), *_function(each, listing.tree.n)]
    return "\n".join(lines) + "\n"


def _comment(each: Equations) -> list[str]:
    lines = wrap("/*", each.kind.says.split(), " * ")
    if not each.kind.is_regressor:
        names = [f"{p.name} [{p.unit}]," for p in each.parameters]
        names[-1:] = [name.rstrip(",") for name in names[-1:]]
        lines += wrap(f" * {each.vector}:", names, " * ")
    return [*lines, " */"]


def _function(each: Equations, joints: int) -> list[str]:
    arguments = [f"const double {name}[{joints}]," for name in each.kind.takes]
    if not each.kind.is_regressor:
        arguments.append(f"const double {each.vector}[{max(1, len(each.parameters))}],")
    size = "".join(f"[{max(1, size)}]" for size in each.shape)
    arguments.append(f"double result{size})")
    lines = [f"void {function_name(each)}(", *wrap("   ", arguments, "    "), "{"]
    lines += [f"    const double {name} = {source};" for name, source in inputs(each)]
    for target, pieces in assignments(each):
        declared = target if target.startswith("result") else f"const double {target}"
        lines += wrap(f"    {declared} =", pieces, "        ")
        lines[-1] += ";"
    return [*lines, "}"]
