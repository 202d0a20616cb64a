"""Placeholders of model files: inertias and friction that nobody measured."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, diagnose
from testbed.core.base.errors import few
from testbed.core.robot.inertia import Inertia
from testbed.core.robot.model_file import ModelFile
from testbed.core.robot.tree import Joint, Tree

SPARSEST, DENSEST = 10.0, 3e4
"""Densities of the box with the same mass and inertia that rigid parts have [kg/m^3]."""

SHORTEST, WIDE = 0.1, 0.3
"""Least length of a link [m]; radius of gyration in parts of the longest that is odd at least."""

ROUNDING = 1e-6
"""Relative error of a number that is rounding."""

FEWEST = 3
"""Links or joints of one value at least."""


@dataclass(frozen=True)
class Placeholders:
    """Numbers of a model file that nobody measured.

    Attributes:
        links: Reasons by link.
        friction: Reasons by kind of friction, "coulomb" or "viscous".
        bodies: Indices of the tree's bodies that such links make up.
    """

    links: Mapping[str, str]
    friction: Mapping[str, str]
    bodies: tuple[int, ...] = ()

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """One line for links, one for friction."""
        links = [f"'{name}' ({reason})" for name, reason in self.links.items()]
        said = [diagnose("model.placeholder", few(links))] if links else []
        if self.friction:
            said.append(
                diagnose(
                    "model.placeholder-friction", " and ".join(self.friction.values())
                )
            )
        return tuple(said)


NO_PLACEHOLDERS = Placeholders({}, {})


def placeholders(tree: Tree) -> Placeholders:
    """Inertias and friction of a robot's model file that nobody measured, by form and size.

    Args:
        tree: Robot; without a model file its bodies are its links.
    """
    # mass of a link in parts of the robot's from which its inertia matters
    least = 1e-3 * sum(body.mass for body in tree.inertias)
    links = [each for each in _links(tree) if each.inertia.mass > least]
    lengths = _lengths(tree, links)
    reach = float(lengths.max(initial=SHORTEST))
    forms = Counter(_form(each.inertia) for each in links)
    alike = len(forms) == 1 and len(links) >= FEWEST and len({*tree.parents}) > 1
    reasons = {
        each.name: "as all others"
        if alike
        else _reason(each.inertia, lengths[each.body], reach)
        for each in links
    }
    masses = np.zeros((2, tree.n))
    for each in links:
        part = each.inertia.mass
        masses[:, each.body] += part, part * bool(reasons[each.name])
    # mass of doubtful links in parts of their body's from which the body is doubtful
    bodies = np.flatnonzero(masses[1] > 0.1 * masses[0])
    return Placeholders(
        {name: reason for name, reason in reasons.items() if reason},
        dict(_friction(tree.joints)),
        tuple(bodies.tolist()),
    )


class _Link(NamedTuple):
    """Name of a link, the tree's body of which it is part, and its inertia about its frame."""

    name: str
    body: int
    inertia: Inertia


def _links(tree: Tree) -> list[_Link]:
    """Links that move, of the model file or the tree's bodies."""
    if isinstance(tree.file, ModelFile):
        links = (_Link(x.name, x.body, x.inertia) for x in tree.file.links())
        return [link for link in links if link.body >= 0]
    parts = enumerate(zip(tree.joints, tree.inertias, strict=True))
    return [_Link(joint.body, k, inertia) for k, (joint, inertia) in parts]


def _lengths(tree: Tree, links: Iterable[_Link]) -> Array:
    """Length of every body, (n,) [m]: to its joint, its mass centre and joints it carries."""
    lengths = np.array([np.linalg.norm(joint.offset) / 2 for joint in tree.joints])
    for joint in tree.joints:
        if joint.parent >= 0:
            size = float(np.linalg.norm(joint.offset))
            lengths[joint.parent] = max(lengths[joint.parent], size)
    for link in links:
        size = float(np.linalg.norm(link.inertia.com))
        lengths[link.body] = max(lengths[link.body], size)
    return lengths


def _form(inertia: Inertia) -> tuple[float, ...]:
    """Mass and principal moments of inertia to six digits."""
    numbers = inertia.mass, *np.linalg.eigvalsh(inertia.central)
    return tuple(float(f"{number:.5e}") for number in numbers)


def _reason(inertia: Inertia, length: float, reach: float) -> str:
    """What shows that nobody measured an inertia; "" for one that may be true."""
    mass, *moments = _form(inertia)
    least, *_, most = moments
    if least <= 0:
        return ""  # no body: repaired, and said there
    equal = most - least <= ROUNDING * most
    if equal and np.isclose(np.log10(most), round(np.log10(most)), atol=ROUNDING):
        return f"{most:g} kg m^2 about all axes"
    if _one_digit(mass) and all(map(_one_digit, moments)):
        return f"{mass:g} kg with {', '.join(f'{each:g}' for each in moments)} kg m^2"
    radius = np.sqrt(most / mass)
    # radius of gyration of a body in lengths of its link at most
    if radius > 2.0 * max(length, SHORTEST) and radius > WIDE * reach:
        return f"radius of gyration {radius:.2g} m of a link of {length:.2g} m"
    sides = np.maximum(6 * (sum(moments) - 2 * np.array(moments)) / mass, 1e-12)
    density = mass / float(np.sqrt(np.prod(sides)))
    # radius of gyration in lengths of the link below which a high density is no motor's
    thin = radius < 0.05 * max(length, SHORTEST)
    if density < SPARSEST or (density > DENSEST and thin):
        return f"{density:.2g} kg/m^3"
    return ""


def _one_digit(number: float) -> bool:
    """Whether a number has one significant digit."""
    return number != 0 and bool(
        np.isclose(float(f"{number:.0e}"), number, rtol=ROUNDING)
    )


def _friction(joints: tuple[Joint, ...]) -> Iterator[tuple[str, str]]:
    """Kinds of friction whose value is one round number, and the reason."""
    for kind in ("coulomb", "viscous"):
        values = [value for joint in joints if (value := getattr(joint, kind)) > 0]
        if len(values) < 2:
            continue
        usual, count = Counter(values).most_common(1)[0]
        # share of the joints that have one value of friction, above which none was measured
        round_one = _one_digit(usual) and count >= 0.6 * len(values)
        if round_one or count == len(values) >= FEWEST:
            yield kind, f"{kind} friction {usual:g} at {count} of {len(joints)} joints"
