"""Detection of placeholder inertias and friction in model files.

Placeholders are numbers that do not come from measurements or CAD data: round numbers, numbers that
are equal for all links, or numbers of implausible magnitude.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, make_diagnostic
from testbed.core.base.errors import shortened_list
from testbed.core.robot.inertia import Inertia
from testbed.core.robot.model_file import ModelFile
from testbed.core.robot.tree import Joint, Tree

MIN_DENSITY, MAX_DENSITY = 10.0, 3e4
"""Range of plausible densities of the box that has a link's mass and inertia [kg/m^3]."""

MIN_LENGTH, MAX_RADIUS_RATIO = 0.1, 0.3
"""Smallest assumed length of a link [m]; largest plausible ratio of a radius of gyration to the
length of the longest link."""

RELATIVE_ROUNDING = 1e-6
"""Relative difference between numbers that is attributed to rounding."""

MIN_COUNT = 3
"""Smallest number of links or joints whose equal values are evidence of a placeholder."""


@dataclass(frozen=True)
class Placeholders:
    """Placeholder inertias and friction of a model file, with reasons.

    Attributes:
        links: Reasons for links with placeholder inertias, keyed by link.
        friction: Reasons keyed by kind of friction, "coulomb" or "viscous".
        bodies: Indices of the tree's bodies with more than 10 % of their mass in links with
            placeholder inertias.
    """

    links: Mapping[str, str]
    friction: Mapping[str, str]
    bodies: tuple[int, ...] = ()

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Diagnostics of placeholder inertias and of placeholder friction, if there are any."""
        links = [f"'{name}' ({reason})" for name, reason in self.links.items()]
        diagnostics = (
            [make_diagnostic("model.placeholder", shortened_list(links))]
            if links
            else []
        )
        if self.friction:
            diagnostics.append(
                make_diagnostic(
                    "model.placeholder-friction", " and ".join(self.friction.values())
                )
            )
        return tuple(diagnostics)


NO_PLACEHOLDERS = Placeholders({}, {})


def find_placeholders(tree: Tree) -> Placeholders:
    """Find placeholder inertias and friction of a robot by the form and size of numbers.

    All inertias are placeholders if the robot has MIN_COUNT or more links, not all on one carrier,
    and all links have the same mass and moments. Otherwise the criteria of `_reason` apply to every
    inertia. Links with less than 0.1 % of the robot's mass are ignored.

    Args:
        tree: Robot; the bodies of a robot without a model file are used as links.
    """
    # least mass of a link, in parts of the robot's mass, for which the inertia matters
    min_mass = 1e-3 * sum(body.mass for body in tree.inertias)
    links = [each for each in _links(tree) if each.inertia.mass > min_mass]
    lengths = _lengths(tree, links)
    reach = float(lengths.max(initial=MIN_LENGTH))
    moment_counts = Counter(_rounded_moments(each.inertia) for each in links)
    all_equal = (
        len(moment_counts) == 1 and len(links) >= MIN_COUNT and len({*tree.parents}) > 1
    )
    reasons = {
        each.name: "as all others"
        if all_equal
        else _reason(each.inertia, lengths[each.body], reach)
        for each in links
    }
    masses = np.zeros((2, tree.n))
    for each in links:
        mass = each.inertia.mass
        masses[:, each.body] += mass, mass * bool(reasons[each.name])
    # share of a body's mass in placeholder links above which the body is listed
    bodies = np.flatnonzero(masses[1] > 0.1 * masses[0])
    return Placeholders(
        {name: reason for name, reason in reasons.items() if reason},
        dict(_friction_reasons(tree.joints)),
        tuple(bodies.tolist()),
    )


class _Link(NamedTuple):
    """Moving link: name, index of the tree's body, inertia in the link's frame."""

    name: str
    body: int
    inertia: Inertia


def _links(tree: Tree) -> list[_Link]:
    """Moving links of the model file; bodies of a tree without a file."""
    if isinstance(tree.file, ModelFile):
        links = (_Link(x.name, x.body, x.inertia) for x in tree.file.links())
        return [link for link in links if link.body >= 0]
    parts = enumerate(zip(tree.joints, tree.inertias, strict=True))
    return [_Link(joint.body, k, inertia) for k, (joint, inertia) in parts]


def _lengths(tree: Tree, links: Iterable[_Link]) -> Array:
    """Length of each body, (n,) [m].

    The length is the largest of half the offset of the body's joint, the distances to the mass
    centres of the body's links, and the offsets of the joints that the body carries.
    """
    lengths = np.array([np.linalg.norm(joint.offset) / 2 for joint in tree.joints])
    for joint in tree.joints:
        if joint.parent >= 0:
            size = float(np.linalg.norm(joint.offset))
            lengths[joint.parent] = max(lengths[joint.parent], size)
    for link in links:
        size = float(np.linalg.norm(link.inertia.com))
        lengths[link.body] = max(lengths[link.body], size)
    return lengths


def _rounded_moments(inertia: Inertia) -> tuple[float, ...]:
    """Mass and principal moments of inertia, rounded to six digits."""
    numbers = inertia.mass, *np.linalg.eigvalsh(inertia.central)
    return tuple(float(f"{number:.5e}") for number in numbers)


def _reason(inertia: Inertia, length: float, reach: float) -> str:
    """Reason why an inertia is a placeholder; "" for a plausible inertia.

    An inertia is a placeholder if its moments are equal and a power of ten; if mass and moments all
    have one significant digit; if the radius of gyration exceeds both 2 `length` and
    MAX_RADIUS_RATIO `reach`; if the density of the box with this inertia is below MIN_DENSITY; or
    if this density is above MAX_DENSITY and the radius of gyration is below 0.05 `length`. An
    inertia with non-positive moments is not a placeholder.

    Args:
        inertia: Inertia of the link.
        length: Length of the link's body [m].
        reach: Length of the longest body [m].
    """
    mass, *moments = _rounded_moments(inertia)
    least, *_, most = moments
    if least <= 0:
        return ""  # inconsistent: repaired, with a diagnostic of the repair
    equal = most - least <= RELATIVE_ROUNDING * most
    if equal and np.isclose(
        np.log10(most), round(np.log10(most)), atol=RELATIVE_ROUNDING
    ):
        return f"{most:g} kg m^2 about all axes"
    if _has_one_digit(mass) and all(map(_has_one_digit, moments)):
        return f"{mass:g} kg with {', '.join(f'{each:g}' for each in moments)} kg m^2"
    radius = np.sqrt(most / mass)
    # greatest plausible radius of gyration, in lengths of the link
    if radius > 2.0 * max(length, MIN_LENGTH) and radius > MAX_RADIUS_RATIO * reach:
        return f"radius of gyration {radius:.2g} m of a link of {length:.2g} m"
    sides = np.maximum(6 * (sum(moments) - 2 * np.array(moments)) / mass, 1e-12)
    density = mass / float(np.sqrt(np.prod(sides)))
    # below this radius of gyration, in lengths of the link, a high density is not that of a motor
    thin = radius < 0.05 * max(length, MIN_LENGTH)
    if density < MIN_DENSITY or (density > MAX_DENSITY and thin):
        return f"{density:.2g} kg/m^3"
    return ""


def _has_one_digit(number: float) -> bool:
    """Test whether a number has one significant digit."""
    return number != 0 and bool(
        np.isclose(float(f"{number:.0e}"), number, rtol=RELATIVE_ROUNDING)
    )


def _friction_reasons(joints: tuple[Joint, ...]) -> Iterator[tuple[str, str]]:
    """Yield the kinds of friction with placeholder values, and the reasons.

    A kind of friction has placeholder values if at least 60 % of the joints with this friction
    share a value of one significant digit, or if all joints with this friction, MIN_COUNT or more,
    share a value.
    """
    for kind in ("coulomb", "viscous"):
        values = [value for joint in joints if (value := getattr(joint, kind)) > 0]
        if len(values) < 2:
            continue
        commonest, count = Counter(values).most_common(1)[0]
        # share of joints with one round value from which friction is a placeholder
        is_round = _has_one_digit(commonest) and count >= 0.6 * len(values)
        if is_round or count == len(values) >= MIN_COUNT:
            yield (
                kind,
                f"{kind} friction {commonest:g} at {count} of {len(joints)} joints",
            )
