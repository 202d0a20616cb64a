"""Tables and sentences of physically consistent bodies."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import product

import numpy as np

from testbed.bodies.consistency.consistent import Consistent
from testbed.bodies.consistency.robots import RobotSamples
from testbed.bodies.linear_prior import MIN_DETERMINED_SHARE
from testbed.core.base.summary_table import numbers_with_sigma
from testbed.core.estimation.estimate import METHOD_LABELS
from testbed.core.parameters.symbols import STANDARD_NAMES
from testbed.view.section import Section, Table

MAX_LISTED_CONSTRAINTS = 6
"""Largest number of active constraints in one line."""


def consistent_tables(consistent: Consistent) -> list[Table]:
    """Tables of the standard parameters of all links and of the joint terms.

    The first has one row per link and parameter, with the value in the model file, the estimate
    with sigma, and the data share. The data share is the fraction of the prior variance that the
    data remove. Without joint terms there is no second table.

    Args:
        consistent: Physically consistent bodies, friction and rotors.
    """
    cells = zip(
        [f"{value:.4g}" for value in consistent.prior.ravel()],
        numbers_with_sigma(consistent.standard, consistent.sigma, short=True),
        [f"{share:.0%}" for share in consistent.data_share.ravel()],
        strict=True,
    )
    rows = _body_rows(consistent.links, STANDARD_NAMES, cells)
    title = (
        "physically consistent bodies, about and along their frames [kg, kg m, kg m^2]; data: "
        "share of the prior variance that the data remove"
    )
    tables = [
        Table(["link", "", "model file", "estimate", "data"], rows, title, left=[""])
    ]
    names = [
        f"{term.law.kind}/{consistent.places[term.joint]}" for term in consistent.terms
    ]
    numbers = numbers_with_sigma(
        consistent.coefficients, consistent.coefficient_sigma, short=True
    )
    joint_terms = Table.from_columns({"joint's own": names, "estimate": numbers})
    return [*tables, joint_terms] if names else tables


def _body_rows(
    links: Iterable[str], names: Sequence[str], cells: Iterable[tuple[str, ...]]
) -> list[tuple[str, ...]]:
    """Table rows for each link and parameter.

    The link's name is in its first row only.

    Args:
        links: Labels of the links.
        names: Names of a link's parameters, the same for all links.
        cells: Further cells of each row, link by link.
    """
    pairs = product(links, names)
    return [
        (link if name == names[0] else "", name, *row)
        for (link, name), row in zip(pairs, cells, strict=True)
    ]


def sampled_robots_table(samples: RobotSamples) -> Table:
    """Table of means and standard deviations of sampled robots, by link and parameter.

    The last columns are the data share (the fraction of the prior variance that the data remove),
    and the parameter's source according to this share: data, model file or both.

    Args:
        samples: Sampled robots.
    """
    shares = samples.share.ravel().tolist()
    cells = zip(
        numbers_with_sigma(samples.mean, samples.sigma, short=True),
        [f"{share:.0%}" for share in shares],
        map(_parameter_source, shares),
        strict=True,
    )
    labels = map(", ".join, zip(samples.links, samples.joints, strict=True))
    rows = _body_rows(labels, samples.names, cells)
    title = (
        "robots drawn [kg, kg m, kg m^2, N m, N m s/rad]; data: share of the prior variance that "
        f"the data remove; the model file is taken to be wrong by {samples.prior_error:g}"
    )
    return Table(
        ["link, joint", "", "draws", "data", "from"], rows, title, left=["", "from"]
    )


def _parameter_source(share: float) -> str:
    """Source of a parameter according to its data share: "data", "both" or "model file".

    The source is "data" for a share of at least `MIN_DETERMINED_SHARE` (0.9), and "both" for a
    share above `1 - MIN_DETERMINED_SHARE` (0.1).

    Args:
        share: Fraction of the prior variance that the data remove.
    """
    if share >= MIN_DETERMINED_SHARE:
        return "data"
    return "both" if share > 1 - MIN_DETERMINED_SHARE else "model file"


def consistent_lines(consistent: Consistent) -> list[str]:
    """Sentences on physically consistent bodies: changes, active constraints, prior.

    They contain the body with the smallest ratio of least to greatest eigenvalue of the
    pseudo-inertia (if any body has mass), the distance of each estimate from the consistent bodies
    in standard deviations, at most `MAX_LISTED_CONSTRAINTS` active constraints, and the relative
    error of the prior.

    Args:
        consistent: Physically consistent bodies, friction and rotors.
    """
    lines = []
    with np.errstate(invalid="ignore"):
        eigenvalue_ratios = consistent.eigenvalues[:, 0] / consistent.eigenvalues[:, -1]
    has_mass = consistent.eigenvalues[:, -1] > 0
    if has_mass.any():
        smallest = int(np.where(has_mass, eigenvalue_ratios, np.inf).argmin())
        lines.append(
            f"Every body is physically consistent: least eigenvalue of a pseudo-inertia over its "
            f"greatest {eigenvalue_ratios[smallest]:.2g}, of '{consistent.links[smallest]}'."
        )
    for comparison in consistent.bent:
        largest = int(np.argmax(np.abs(comparison.sigmas)))
        lines.append(
            f"The estimate by the {METHOD_LABELS[comparison.method]} changes by "
            f"{comparison.distance:.2g} standard deviations in all (about "
            f"{np.sqrt(len(comparison.names)):.2g} is expected), most in "
            f"{comparison.names[largest]} ({comparison.sigmas[largest]:+.2g})."
        )
    if consistent.binding:
        remainder = (
            f" and {len(consistent.binding) - MAX_LISTED_CONSTRAINTS} more"
            if len(consistent.binding) > MAX_LISTED_CONSTRAINTS
            else ""
        )
        lines.append(
            f"At their limits: {'; '.join(consistent.binding[:MAX_LISTED_CONSTRAINTS])}{remainder}."
        )
    lines.append(
        f"Prior: the model file's bodies, with a relative standard deviation of "
        f"{consistent.prior_error:.2g}; data is the share of that variance which the data remove."
    )
    return lines


def bodies_section(consistent: Consistent) -> Section:
    """Section with mass, centre of mass and data share of every link.

    Args:
        consistent: Consistent bodies of a run.
    """
    return Section(
        id="bodies",
        title="Physically consistent bodies",
        explanation=" ".join(consistent_lines(consistent)),
        caption=(
            "Data is the share of the prior variance that the data remove, averaged over a link's "
            "ten parameters. The viewer draws each link as an ellipsoid of uniform density."
        ),
        table=Table(
            ["link", "mass, model file [kg]", "mass [kg]", "centre [m]", "data"],
            [_link_row(consistent, k) for k in range(len(consistent.links))],
        ),
    )


def _link_row(consistent: Consistent, k: int) -> list[str]:
    """Table row of a link: prior mass, mass with sigma, centre of mass, data share.

    The centre of mass is in the body frame [m], and zero for a massless link. The data share is the
    mean over the link's ten parameters.

    Args:
        consistent: Consistent bodies.
        k: Index of the link.
    """
    mass = consistent.standard[k, 0]
    centre = consistent.standard[k, 1:4] / mass if mass else np.zeros(3)
    return [
        consistent.links[k],
        f"{consistent.prior[k, 0]:.4g}",
        f"{mass:.4g} +- {consistent.sigma[k, 0]:.2g}",
        " ".join(f"{x:.4f}" for x in centre),
        f"{consistent.data_share[k].mean():.0%}",
    ]
