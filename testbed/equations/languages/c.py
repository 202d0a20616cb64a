"""Equations as C99 without dependencies, one sample a call."""

from __future__ import annotations

from dataclasses import replace

from testbed.equations.equations import Equations, Listing
from testbed.equations.expression import Nature, Number
from testbed.equations.languages.text import (
    COORDINATES,
    Style,
    decimal,
    function_name,
    inputs,
    own_name,
    preface,
    terms,
    used_constants,
    wrap,
)


def _number(value: Number) -> str:
    return f"{value}.0" if isinstance(value, int) else decimal(value)


STYLE = Style(own_name, _number, plus_first=True)


def c(listing: Listing, source: str) -> str:
    """C functions; arguments as for `write_equations`."""
    lines = ["/*", *(f" * {line}".rstrip() for line in preface(listing, source)), " */"]
    lines += ["#include <math.h>", ""]
    for name, value, unit in used_constants(listing):
        lines.append(f"static const double {name} = {_number(value)}; /* {unit} */")
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
    program = each.program
    arguments = [f"const double {name}[{joints}]" for name in each.kind.takes]
    if not each.kind.is_regressor:
        arguments.append(f"const double {each.vector}[{max(1, len(each.parameters))}]")
    size = "".join(f"[{max(1, size)}]" for size in each.shape)
    arguments.append(f"double result{size}")
    separated = [f"{part}," for part in arguments[:-1]] + [f"{arguments[-1]})"]
    lines = [f"void {function_name(each)}(", *wrap("   ", separated, "    "), "{"]
    lines += [f"    const double {name} = {source};" for name, source in inputs(each, STYLE)]
    targets = {
        name: "result" + "".join(f"[{index}]" for index in place)
        for name, place in each.places.items()
    }
    style = replace(STYLE, name=lambda factor: targets.get(factor, factor.name))
    for label, value in program.lines:
        target = targets.get(label, f"const double {label.name}")
        lines += wrap(f"    {target} =", terms(value, style), "        ")
        lines[-1] += ";"
    return [*lines, *_unused(each), "}"]


def _unused(each: Equations) -> list[str]:
    """Arguments that the equations do not need."""
    natures = {symbol.nature for symbol in each.program.symbols}
    names = [
        letter
        for nature, letter in COORDINATES.items()
        if letter in each.kind.takes and nature not in natures
    ]
    if not each.kind.is_regressor and Nature.PARAMETER not in natures:
        names.append(each.vector)
    return [f"    (void){name};" for name in names]
