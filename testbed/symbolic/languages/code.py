"""What Python and C share: what a function is given, under the names that its lines use."""

from __future__ import annotations

from collections.abc import Iterator

from testbed.symbolic.equations import Equations
from testbed.symbolic.expression import Factor, Nature
from testbed.symbolic.languages.text import Style, terms
from testbed.symbolic.program import Program, leaves

COORDINATES = {Nature.POSITION: "q", Nature.VELOCITY: "qp", Nature.ACCELERATION: "qpp"}


def function_name(each: Equations) -> str:
    """Of the function that computes them."""
    return each.kind.name.replace("-", "_")


def given(each: Equations, style: Style) -> Iterator[tuple[str, str]]:
    """Names and where they come from: qp1 from qp[0], K3d from delta_d[2] / 2, S2 from sin(q2)."""
    program = each.program
    for symbol in program.symbols:
        if symbol.nature in COORDINATES:
            letter = COORDINATES[symbol.nature]
            yield symbol.name, f"{letter}[{symbol.rank}]"
    used = set(program.symbols)
    for k, parameter in enumerate(each.parameters):
        if parameter.symbol is not None and parameter.symbol in used:
            divided = f" / {style.number(parameter.times)}" if parameter.times != 1 else ""
            yield parameter.symbol.name, f"{each.vector}[{k}]{divided}"
    for wave in program.waves:
        if wave.content is not None:
            function = "cos" if wave.nature is Nature.COSINE else "sin"
            yield wave.name, f"{function}({' '.join(terms(wave.content, style))})"


def referred(each: Equations) -> set[Factor]:
    """Results that other lines refer to."""
    factors = (f for _, value in each.program.steps for f in leaves(value))
    return {factor for factor in factors if factor in each.places}


def done_with(program: Program) -> dict[Factor, list[str]]:
    """After which line which auxiliary variables are needed no more."""
    last: dict[Factor, Factor] = {}
    made = {name for name, _ in program.steps} - program.results
    for name, value in program.steps:
        last |= dict.fromkeys((f for f in leaves(value) if f in made), name)
    done: dict[Factor, list[str]] = {}
    for factor, name in last.items():
        done.setdefault(name, []).append(factor.name)
    return done
