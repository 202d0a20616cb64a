"""Repair of physically inconsistent inertias in a model file.

Links fixed to each other are lumped into one body before the check, so that a frame without
inertia, or with moments of -2e-22, is harmless. Bodies that are still inconsistent are replaced:
bodies with rounding errors always, bodies with larger errors by the nearest consistent body or by a
given body.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from testbed.core.base.diagnostics import Diagnostic, make_diagnostic
from testbed.core.base.errors import ModelError, UnknownName, quoted_list
from testbed.core.base.transform import Transform
from testbed.core.robot.inertia import ZERO_INERTIA, Inertia
from testbed.core.robot.refusals import InertiaError
from testbed.core.robot.rigid_matter import (
    POINT_MASS_RADIUS_RATIO,
    POINT_MASS_TOLERANCE,
    inertia_flaw,
    nearest_consistent_inertia,
)

InertiasByLink: TypeAlias = Mapping[str, Inertia]
"""Inertias of lumped bodies, relative to the frame of the carrier link and keyed by this link, to
which the other links of the body are fixed."""

MIN_MOMENT_RATIO = 1e-6
"""Smallest ratio between two principal second moments of a repaired body."""

MIN_MASS_RATIO = 1e-5
"""Mass assigned to a massless body, relative to the robot's mass."""

MAX_LISTED_FLAWS = 3
"""Largest number of flaws that are listed individually."""


@dataclass(frozen=True, eq=False)
class ModelLink:
    """Link of a model file, with its position in the tree and its inertia.

    Attributes:
        name: Name in the file.
        body: Index of the tree's body that contains the link, -1 for the pedestal.
        parent: Name of the link to which a joint of any type connects this link; "" for the root.
        fixed_carrier: Name of the carrier, to which fixed joints of the file connect this link;
            `name` if no fixed joint does.
        X_BL: Pose of the link L in the frame of its body B.
        inertia: Inertia as stated in the file, relative to the link's frame.
    """

    name: str
    body: int
    parent: str
    fixed_carrier: str
    X_BL: Transform
    inertia: Inertia

    @property
    def inertia_in_body(self) -> Inertia:
        """Inertia of the link relative to the body's frame."""
        return self.inertia.transformed(self.X_BL)


@dataclass(frozen=True, eq=False)
class ModelEdit:
    """Changes to a model file: inertias, friction, torque constants, delay.

    Attributes:
        links: New inertias relative to the links' frames, keyed by link.
        joints: New friction and rotor inertias, keyed by joint, then by parameter.
        torque_ratios: Ratios of the true torque to the torque reported by the drive, keyed by
            joint.
        delay: Delay between a torque command and the torque [s].
        diagnostics: Diagnostics of changes that could not be distributed among links.
    """

    links: Mapping[str, Inertia]
    joints: Mapping[str, Mapping[str, float]]
    torque_ratios: Mapping[str, float] = field(default_factory=dict)
    delay: float = 0.0
    diagnostics: tuple[Diagnostic, ...] = ()


def total_inertia(parts: Iterable[Inertia]) -> Inertia:
    """Sum of the inertias of bodies welded together, all relative to the same frame."""
    return sum(parts, ZERO_INERTIA)


@dataclass(frozen=True, eq=False)
class Repair:
    """Replacements for physically inconsistent inertias in a model file.

    Attributes:
        links: New inertias relative to the links' frames, keyed by link; other links are unchanged.
        bodies: New inertias of lumped bodies with errors beyond rounding, keyed by carrier link;
            `links` is derived from these inertias.
        flaws: Flaws of these bodies, one text per body.
        diagnostics: Diagnostics of the repair.
    """

    links: Mapping[str, Inertia]
    bodies: InertiasByLink
    flaws: tuple[str, ...]
    diagnostics: tuple[Diagnostic, ...]


def repair_inertias(
    links: Sequence[ModelLink],
    suspects: Mapping[str, str],
    parents: Sequence[int],
    replacements: InertiasByLink | None,
    source: str,
    reach: float,
) -> Repair:
    """Replace inertias that are physically inconsistent or out of proportion to the robot.

    Links fixed to each other are lumped. An inconsistent body, or a massless body at the end of a
    chain, gets the nearest consistent inertia. A moving body out of proportion (`_out_of_scale`)
    gets the average inertia of the other bodies. The new inertia is assigned to the carrier link,
    and the links fixed to this link become massless.

    Args:
        links: All links of the file, each after its carrier.
        suspects: Flaws of single links, keyed by name; only lumped bodies that contain such links
            are checked.
        parents: Parent indices of the tree's bodies, to find massless chain ends; () for no search.
        replacements: Inertias that replace those of the file, as in `Repair.bodies`; remaining
            flaws beyond rounding then raise an error. None selects the nearest consistent inertias.
        source: File name, for messages.
        reach: Sum of the distances between successive joints [m].

    Raises:
        InertiaError: `replacements` contains no consistent inertia for an inconsistent body.
        ModelError: A mass is negative or a number is not finite, so that no nearest consistent body
            exists.
        UnknownName: A replacement is given for an unknown link, or for a link that is fixed to
            another.
    """
    groups: dict[str, list[ModelLink]] = {}  # carrier first, then the links fixed to it
    for link in links:
        groups.setdefault(link.fixed_carrier, []).append(link)
    new_bodies = dict(replacements or {})
    for name in new_bodies:
        if name not in groups:
            raise UnknownName("link to repair", name, groups)
    bodies = {
        name: _lumped_inertia(*group) for name, group in groups.items()
    } | new_bodies
    moving = {name: body for name, body in bodies.items() if groups[name][0].body >= 0}
    average_body, scale_messages = _out_of_scale(moving, reach)
    bodies |= dict.fromkeys(scale_messages, average_body)
    link_flaws = {
        link.fixed_carrier: suspects[link.name]
        for link in links[::-1]
        if link.name in suspects
    }
    checked = [name for name in groups if name in link_flaws or name in new_bodies]
    flaws = _flaws({name: bodies[name] for name in checked}, link_flaws, source)
    flaws |= dict(_massless_ends(links, bodies, parents))
    scale = _RobotScale.of_bodies(bodies.values())
    nearest = {name: scale.nearest(bodies[name]) for name in flaws}
    rounding_names = [
        name for name in flaws if scale.is_rounding(bodies[name], nearest[name])
    ]
    flaw_messages = {
        name: line for name, line in flaws.items() if name not in rounding_names
    }
    diagnostics = _diagnostics(scale_messages.values(), rounding_names, flaw_messages)
    nearest, flaw_messages = (
        nearest | dict.fromkeys(scale_messages, average_body),
        flaw_messages | scale_messages,
    )
    if flaw_messages and replacements is not None:
        raise InertiaError(source, list(flaw_messages.values()))
    changed = {name: bodies[name] for name in checked} | nearest
    emptied_links = (
        x.name for n in changed for x in groups[n][1:] if x.inertia.pseudo.any()
    )
    return Repair(
        links=dict.fromkeys(emptied_links, ZERO_INERTIA) | changed,
        bodies={name: nearest[name] for name in flaw_messages},
        flaws=tuple(flaw_messages.values()),
        diagnostics=tuple(diagnostics),
    )


def _flaws(
    bodies: InertiasByLink, link_flaws: Mapping[str, str], source: str
) -> dict[str, str]:
    """Reasons why lumped bodies are physically inconsistent, keyed by name.

    Consistent bodies are omitted.

    Args:
        bodies: Lumped bodies, keyed by name.
        link_flaws: Flaw of the first inconsistent link of each body, keyed by name of the body.
        source: File name, for messages.

    Raises:
        ModelError: A mass is negative or a number is not finite, so that no nearest consistent body
            exists.
    """
    flaws = {
        name: line for name, body in bodies.items() if (line := _body_flaw(name, body))
    }
    for name, line in flaws.items():
        if not (bodies[name].mass >= 0 and bodies[name].within_limits):
            raise ModelError(
                f"{source}: {link_flaws.get(name, line)}; correct the file"
            )
    return flaws


def _diagnostics(
    scale_messages: Iterable[str],
    rounding_names: Iterable[str],
    flaw_names: Iterable[str],
) -> Iterator[Diagnostic]:
    """Yield diagnostics of bodies out of proportion, with rounding errors, or with larger errors.

    There is one diagnostic per body out of proportion, one for all bodies with rounding errors, and
    one for all bodies with larger errors.

    Args:
        scale_messages: Messages for bodies out of proportion.
        rounding_names: Names of bodies with rounding errors.
        flaw_names: Names of bodies with larger errors.
    """
    for line in scale_messages:
        yield make_diagnostic("model.scale", line)
    if rounding_names:
        yield make_diagnostic("model.rounding", quoted_list(rounding_names))
    if flaw_names:
        yield make_diagnostic("model.inertia", quoted_list(flaw_names))


@dataclass(frozen=True)
class _RobotScale:
    """Mass and length of a robot, with which inertias are compared.

    Attributes:
        mass: Sum of the bodies' masses [kg].
        reach: Largest radius of gyration of the bodies about their frames [m].
    """

    mass: float
    reach: float

    @staticmethod
    def of_bodies(bodies: Iterable[Inertia]) -> _RobotScale:
        """Scale of a robot from the bodies' inertias; zero mass or length becomes 1."""
        heavy = [body for body in bodies if body.mass > 0]
        reach = max([0.0, *(body.radius for body in heavy)])
        return _RobotScale(sum(body.mass for body in heavy) or 1.0, reach or 1.0)

    def nearest(self, body: Inertia) -> Inertia:
        """Nearest physically consistent inertia at the scale of the robot."""
        return nearest_consistent_inertia(
            body, MIN_MOMENT_RATIO, MIN_MASS_RATIO * self.mass, self.reach
        )

    def is_rounding(self, old: Inertia, new: Inertia) -> bool:
        """Test whether an inertia changes by no more than rounding.

        A change is attributed to rounding if the mass is unchanged and the pseudo-inertia changes
        by at most 1e-4 of the largest central second moment, or by at most 1e-9 times the robot's
        mass times `reach` squared.

        Args:
            old: Inertia before the repair.
            new: Inertia after the repair.
        """
        spread = old.pseudo[:3, :3] - old.mass * np.outer(old.com, old.com)
        # change of a body's second moments that is rounding, in parts of the greatest of them
        body_tolerance = 1e-4 * np.linalg.eigvalsh(spread)[-1]
        change = np.abs(new.pseudo - old.pseudo).max()
        # the same change, in parts of the robot's mass times the square of the largest radius of
        # gyration
        robot_tolerance = 1e-9 * self.mass * self.reach**2
        return bool(
            old.mass == new.mass and change <= max(body_tolerance, robot_tolerance)
        )


def _out_of_scale(
    bodies: InertiasByLink, reach: float
) -> tuple[Inertia, dict[str, str]]:
    """Average inertia, and messages for bodies out of proportion to the robot, keyed by name.

    A body is out of proportion if its mass is below 1e-7 times the median or above 1e4 kg/m^3 times
    L^3, or if its radius of gyration is above 10 L, with the length L = max(reach, 1 m). The
    average inertia is that of a ball around its frame's origin with the mean mass and mean radius
    of gyration of the other bodies.

    Args:
        bodies: Moving lumped bodies, keyed by name.
        reach: Sum of the distances between successive joints [m].
    """
    valid = {
        name: body
        for name, body in bodies.items()
        if body.mass > 0 and body.within_limits
    }
    sizes = {name: (body.mass, body.radius) for name, body in valid.items()}
    # least mass of a body, in parts of the median
    min_mass, reach = (
        1e-7 * np.median([0.0, *(mass for mass, _ in sizes.values())]),
        max(reach, 1.0),
    )
    messages, regular = {}, []
    for name, (mass, radius) in sizes.items():
        # greatest mass over the cube of the robot's length, more than for steel [kg/m^3], and
        # greatest radius of gyration in parts of this length
        if min_mass < mass < 1e4 * reach**3 and radius < 10.0 * reach:
            regular.append((mass, radius))
        else:
            messages[name] = _MESSAGE.format(name, mass, radius)
    mass, radius = np.mean(regular or [(1.0, POINT_MASS_RADIUS_RATIO * reach)], axis=0)
    tensor = 2 / 3 * mass * radius**2 * np.eye(3)
    return Inertia.about_centre(mass, np.zeros(3), tensor), messages


_MESSAGE = "link '{}' has a mass of {:.4g} kg with a radius of gyration of {:.4g} m about its joint"
"""Message for a body out of proportion: name, mass, radius of gyration."""


def _lumped_inertia(carrier: ModelLink, *others: ModelLink) -> Inertia:
    """Inertia of a link and all links fixed to the link, relative to its frame.

    If no fixed link has mass, the inertia of the link is returned bit for bit.

    Args:
        carrier: Link that carries the others.
        others: Links fixed to the carrier.
    """
    X_CB = carrier.X_BL.inverse
    massive = (link for link in others if link.inertia.pseudo.any())
    return carrier.inertia + total_inertia(
        link.inertia.transformed(X_CB @ link.X_BL) for link in massive
    )


def _body_flaw(name: str, body: Inertia) -> str | None:
    """Reason why a lumped body is physically inconsistent; None if consistent.

    Central moments below POINT_MASS_TOLERANCE times the moments about the frame's origin are
    treated as zero.

    Args:
        name: Name of the carrier link, for the message.
        body: Inertia relative to the carrier link's frame.
    """
    central = body.central
    if np.abs(central).max() <= POINT_MASS_TOLERANCE * np.abs(body.tensor).max():
        central = np.zeros((3, 3))
    return inertia_flaw(name, body.mass, central)


def _massless_ends(
    links: Sequence[ModelLink], bodies: InertiasByLink, parents: Sequence[int]
) -> Iterator[tuple[str, str]]:
    """Yield carrier links of massless moving bodies at chain ends, with descriptions of the flaws.

    Neither such a body nor any body that it carries has an inertia, although another body of the
    tree has an inertia.

    Args:
        links: All links of the file, each after its carrier.
        bodies: Lumped bodies, keyed by name.
        parents: Parent indices of the tree's bodies.
    """
    has_mass = [False] * len(parents)
    for link in links:
        if (
            0 <= link.body < len(has_mass)
            and link.name in bodies
            and bodies[link.name].pseudo.any()
        ):
            has_mass[link.body] = True
    for body in reversed(range(len(parents))):
        if has_mass[body] and parents[body] >= 0:
            has_mass[parents[body]] = True
    carriers = {link.body: link.fixed_carrier for link in reversed(links)}
    for body, name in sorted(carriers.items()):
        if 0 <= body < len(parents) and any(has_mass) and not has_mass[body]:
            yield (
                name,
                f"link '{name}' moves, and neither it nor what it carries has a mass",
            )
