"""Physically consistent bodies: link by link, in sentences."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import product

import numpy as np

from testbed.bodies.consistency.consistent import Consistent
from testbed.bodies.consistency.robots import Robots
from testbed.bodies.linear_prior import DETERMINED
from testbed.core.base.summary_table import numbers_with_sigma
from testbed.core.estimation.estimate import NAMES
from testbed.core.parameters.symbols import STANDARD
from testbed.view.section import Section, Table

LISTED = 6
"""Most conditions in one line."""


def consistent_tables(found: Consistent) -> list[Table]:
    """Standard parameters, link by link, and the joints' own terms.

    Args:
        found: The bodies, friction and rotors.
    """
    cells = zip(
        [f"{value:.4g}" for value in found.prior.ravel()],
        numbers_with_sigma(found.standard, found.sigma, short=True),
        [f"{share:.0%}" for share in found.data_share.ravel()],
        strict=True,
    )
    rows = _body_rows(found.links, STANDARD, cells)
    title = (
        "physically consistent bodies, about and along their frames [kg, kg m, kg m^2]; data: "
        "share of the prior variance that the data remove"
    )
    tables = [
        Table(["link", "", "model file", "estimate", "data"], rows, title, left=[""])
    ]
    names = [f"{term.law.kind}/{found.places[term.joint]}" for term in found.terms]
    numbers = numbers_with_sigma(
        found.coefficients, found.coefficient_sigma, short=True
    )
    own = Table.of({"joint's own": names, "estimate": numbers})
    return [*tables, own] if names else tables


def _body_rows(
    links: Iterable[str], names: Sequence[str], cells: Iterable[tuple[str, ...]]
) -> list[tuple[str, ...]]:
    """Rows of parameters, each link in the first of its own."""
    places = product(links, names)
    return [
        (link if name == names[0] else "", name, *row)
        for (link, name), row in zip(places, cells, strict=True)
    ]


def draws_table(found: Robots) -> Table:
    """Mean and standard deviation of all that is drawn, and whose they are.

    Args:
        found: The draws.
    """
    shares = found.share.ravel().tolist()
    cells = zip(
        numbers_with_sigma(found.mean, found.sigma, short=True),
        [f"{share:.0%}" for share in shares],
        map(_origin, shares),
        strict=True,
    )
    places = map(", ".join, zip(found.links, found.joints, strict=True))
    rows = _body_rows(places, found.names, cells)
    title = (
        "robots drawn [kg, kg m, kg m^2, N m, N m s/rad]; data: share of the prior variance that "
        f"the data remove; the model file is taken to be wrong by {found.prior_error:g}"
    )
    return Table(
        ["link, joint", "", "draws", "data", "from"], rows, title, left=["", "from"]
    )


def _origin(share: float) -> str:
    """Whose a parameter is, by the part of its variance that the data remove."""
    if share >= DETERMINED:
        return "data"
    return "both" if share > 1 - DETERMINED else "model file"


def consistent_lines(found: Consistent) -> list[str]:
    """What the certificates say, a sentence each.

    Args:
        found: The bodies, friction and rotors.
    """
    lines = []
    with np.errstate(invalid="ignore"):
        least = found.eigenvalues[:, 0] / found.eigenvalues[:, -1]
    massive = found.eigenvalues[:, -1] > 0
    if massive.any():
        worst = int(np.where(massive, least, np.inf).argmin())
        lines.append(
            f"Every body is physically consistent: least eigenvalue of a pseudo-inertia over its "
            f"greatest {least[worst]:.2g}, of '{found.links[worst]}'."
        )
    for each in found.bent:
        most = int(np.argmax(np.abs(each.sigmas)))
        lines.append(
            f"The estimate by the {NAMES[each.method]} changes by {each.distance:.2g} standard "
            f"deviations in all (about {np.sqrt(len(each.names)):.2g} is expected), most in "
            f"{each.names[most]} "
            f"({each.sigmas[most]:+.2g})."
        )
    if found.binding:
        more = (
            f" and {len(found.binding) - LISTED} more"
            if len(found.binding) > LISTED
            else ""
        )
        lines.append(f"At their limits: {'; '.join(found.binding[:LISTED])}{more}.")
    lines.append(
        f"Prior: the model file's bodies, with a relative standard deviation of "
        f"{found.prior_error:.2g}; data is the share of that variance which the data remove."
    )
    return lines


def bodies_section(found: Consistent) -> Section:
    """Mass, centre and share of the data of every link.

    Args:
        found: Consistent bodies of a run.
    """
    return Section(
        id="bodies",
        title="Physically consistent bodies",
        says=" ".join(consistent_lines(found)),
        caption=(
            "Data is the share of the prior variance that the data remove, averaged over a link's "
            "ten parameters. The viewer draws each link as an ellipsoid of uniform density."
        ),
        table=Table(
            ["link", "mass, model file [kg]", "mass [kg]", "centre [m]", "data"],
            [_row(found, k) for k in range(len(found.links))],
        ),
    )


def _row(found: Consistent, k: int) -> list[str]:
    mass = found.standard[k, 0]
    centre = found.standard[k, 1:4] / mass if mass else np.zeros(3)
    return [
        found.links[k],
        f"{found.prior[k, 0]:.4g}",
        f"{mass:.4g} +- {found.sigma[k, 0]:.2g}",
        " ".join(f"{x:.4f}" for x in centre),
        f"{found.data_share[k].mean():.0%}",
    ]
