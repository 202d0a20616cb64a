"""How held-out data chose the terms of the joints' torques, as lines for people."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from testbed.errors import printable
from testbed.identification.estimate import Estimate
from testbed.identification.held_out import HeldOut, TermChoice


def choice_lines(estimates: Iterable[Estimate]) -> Iterator[str]:
    """Which terms were chosen, with the evidence, for all estimates that chose.

    Args:
        estimates: Of one recording.
    """
    for estimate in estimates:
        if estimate.choice is not None:
            yield from (printable(line) for line in _lines(estimate.choice))


def _lines(choice: TermChoice) -> Iterator[str]:
    first, *added = choice.growth.steps
    yield f"terms, each part of {choice.parts} foretold by the others: {_left(choice.before)}"
    before = first.residual
    for step in added:
        better = f"{100 * before:.2f} % -> {100 * step.residual:.2f} %"
        yield f"  + {step.kind}: {better} in noise, {step.gain:.1f} standard errors"
        before = step.residual
    if choice.growth.next_best is not None:
        left = choice.growth.next_best
        yield f"  not {left.kind}: {left.gain:.1f} standard errors, 2 are wanted"
    yield f"with all of them: {_left(choice.after)}"


def _left(found: HeldOut) -> str:
    units = set(found.units)
    whole = f"rms {found.rms:.3f} {units.pop()} (" if len(units) == 1 else "rms ("
    named = zip(found.channels, found.residual, strict=True)
    return f"{whole}{', '.join(f'{name} {left:.3g}' for name, left in named)})"
