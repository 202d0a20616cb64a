"""The notation of [FRS96]: Q3 = K3yz*qpp1*C23 + K3yy*qpp2 + ..."""

from __future__ import annotations

from testbed.symbolic.equations import Listing
from testbed.symbolic.expression import Expression
from testbed.symbolic.languages.text import (
    Style,
    definitions,
    fraction,
    header,
    terms,
    used_constants,
    wrap,
)

STYLE = Style(lambda factor: factor.name.replace("mbar", "mm"), fraction, parameter_first=True)


def paper(listing: Listing, source: str) -> str:
    """The paper's notation; arguments as for `write_equations`.

    qp2 and qpp2 are the velocity and acceleration of joint 2, S223 is sin(2 q2 + q3). Lines
    that begin with * are comments; lines that begin with a blank continue the one before.
    """
    lines = [f"* {line}".rstrip() for line in header(listing, source)]
    lines += [f"* {name} = {value:.12g}" for name, value, _ in used_constants(listing)]
    lines += _definitions(listing)
    for each in listing.equations:
        lines += ["", f"* {each.kind.title}"]
        for name, value in each.program.lines:
            if value or len(each.shape) == 1:
                lines += wrap(f"{name.name} =", terms(value, STYLE), " ")
    return "\n".join(lines) + "\n"


def _definitions(listing: Listing) -> list[str]:
    """What the barycentric parameters stand for, or the minimal ones are made of."""
    lines = []
    if listing.form == "full":
        titles = ("Barycentric masses", "Barycentric moments", "Barycentric tensors")
        for title, head in zip(titles, ("mbar", "mb", "K"), strict=True):
            lines += ["", f"* {title}"]
            for name, value in listing.definitions:
                if name.rstrip("xyz0123456789") == head:
                    lines += wrap(f"{name.replace('mbar', 'mm')} =", terms(value, STYLE), " ")
    made = [f"* {line}" for line in definitions(listing)]
    return [*lines, "", *made] if made else lines


def line(value: Expression) -> str:
    """One expression in the paper's notation."""
    return " ".join(terms(value, STYLE))
