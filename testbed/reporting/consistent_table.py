"""Consistent bodies as a table and sentences for the terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table

from testbed.errors import printable
from testbed.identification.estimate_text import number_with_sigma
from testbed.parameters.barycentric import STANDARD

if TYPE_CHECKING:
    from testbed.identification.consistency import Consistent

LISTED = 6
"""Most conditions in one line."""


def consistent_tables(found: Consistent) -> list[Table]:
    """Standard parameters, link by link, and the joints' own terms.

    Args:
        found: The bodies, friction and rotors.
    """
    table = Table(
        title="bodies that can exist, about and along their frames [kg, kg m, kg m^2]; told: part "
        "of the prior's variance that the data took away",
        title_justify="left",
        header_style="bold",
        box=SIMPLE_HEAD,
    )
    for name in ("link", "", "model file", "estimate", "told"):
        table.add_column(name, justify="left" if name in ("link", "") else "right", no_wrap=True)
    for k, link in enumerate(found.links):
        for c, name in enumerate(STANDARD):
            value, sigma = float(found.standard[k, c]), float(found.sigma[k, c])
            table.add_row(
                printable(link, 24) if c == 0 else "",
                name,
                f"{found.prior[k, c]:.4g}",
                number_with_sigma(value, sigma, short=True),
                f"{found.told[k, c]:.0%}",
                end_section=c == len(STANDARD) - 1,
            )
    return [table, *([_terms(found)] if found.terms else [])]


def _terms(found: Consistent) -> Table:
    table = Table(header_style="bold", box=SIMPLE_HEAD)
    table.add_column("joint's own")
    table.add_column("estimate", justify="right", no_wrap=True)
    for term, value, sigma in zip(
        found.terms, found.coefficients, found.coefficient_sigma, strict=True
    ):
        name = f"{term.law.kind}/{found.places[term.joint]}"
        table.add_row(printable(name, 40), number_with_sigma(value, sigma, short=True))
    return table


def consistent_lines(found: Consistent) -> list[str]:
    """What the certificates say, a sentence each.

    Args:
        found: The bodies, friction and rotors.
    """
    massive = found.eigenvalues[:, -1] > 0
    lines = []
    if massive.any():
        least = found.eigenvalues[:, 0] / np.where(massive, found.eigenvalues[:, -1], 1.0)
        worst = int(np.argmin(np.where(massive, least, np.inf)))
        lines.append(
            f"Every body can exist: least eigenvalue of a pseudo-inertia over its greatest "
            f"{least[worst]:.2g}, of '{found.links[worst]}'."
        )
    for each in found.bent:
        most = int(np.argmax(np.abs(each.sigmas)))
        lines.append(
            f"The {each.method} estimate gave way by {each.distance:.2g} sigma in all (noise makes "
            f"about {np.sqrt(len(each.names)):.2g}), most in {each.names[most]} "
            f"({each.sigmas[most]:+.2g})."
        )
    if found.binding:
        more = f" and {len(found.binding) - LISTED} more" if len(found.binding) > LISTED else ""
        lines.append(f"At their limits: {'; '.join(found.binding[:LISTED])}{more}.")
    if found.tried:
        tried = ", ".join(f"{error:g}: {left:.4g}" for error, left in found.tried.items())
        lines.append(f"Held-out data, rms in sigmas of noise by prior error: {tried}.")
    lines.append(
        f"The model file's bodies were taken to be wrong by {found.prior_error:g} of themselves; "
        "told is the part of that variance which the data took away."
    )
    return lines
