"""Links of a model file, those that no matter can make, and the nearest bodies that can be.

Links that are fixed to each other are one body before anything is judged: a frame without inertia,
or with moments of -2e-22, does no harm then. What is still wrong is repaired: rounding always, and
what is more than that where no bodies are given in its place.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from testbed.core.base.diagnostics import Diagnostic, diagnose
from testbed.core.base.errors import ModelError, UnknownName, quoted
from testbed.core.base.transform import Transform
from testbed.core.robot.inertia import NOTHING, Inertia
from testbed.core.robot.refusals import InertiaError
from testbed.core.robot.rigid_matter import ROUNDING, SMALL, inertia_flaw, nearest_body

Bodies: TypeAlias = Mapping[str, Inertia]
"""By the link that carries all that is fixed to it: its inertia about and along its frame."""

THINNEST = 1e-6
"""Share of a repaired body's greatest principal second moment that its others have at least."""

LIGHTEST = 1e-5
"""Mass of a repaired body that had none, in parts of the robot's."""

NAMED = 3
"""Flaws that are listed one by one."""


@dataclass(frozen=True, eq=False)
class FileLink:
    """A link of a model file.

    Attributes:
        name: In the file.
        body: Index of the tree's body that it is part of, -1 for the pedestal.
        parent: The link that carries it by whatever joint; "" for the root.
        carrier: The link to which fixed joints of the file hold it; itself where none does.
        X_BL: Pose of the link L in the frame of its body B.
        inertia: As the file has it, about and along the link's frame.
    """

    name: str
    body: int
    parent: str
    carrier: str
    X_BL: Transform
    inertia: Inertia

    @property
    def in_body(self) -> Inertia:
        """Its inertia about and along the body's frame."""
        return self.inertia.moved(self.X_BL)


@dataclass(frozen=True, eq=False)
class Edit:
    """Other numbers of a model file.

    Attributes:
        links: New inertias, about and along the links' frames, by link.
        joints: Friction and rotor inertia that change, by joint.
        gears: True torque over what the drive reports, by joint.
        delay: From a command to its torque [s].
        diagnostics: What could not be shared out among links.
    """

    links: Mapping[str, Inertia]
    joints: Mapping[str, Mapping[str, float]]
    gears: Mapping[str, float] = field(default_factory=dict)
    delay: float = 0.0
    diagnostics: tuple[Diagnostic, ...] = ()


def total(parts: Iterable[Inertia]) -> Inertia:
    """Bodies welded together, all about the same frame."""
    return sum(parts, NOTHING)


@dataclass(frozen=True, eq=False)
class Repair:
    """What is taken in place of a file's inertias.

    Attributes:
        links: By link, its new inertia about and along its own frame; all others keep theirs.
        bodies: The nearest bodies of which `links` is made, by the link that carries all that is
            fixed to it, about and along its frame; those changed by more than rounding.
        flaws: What was wrong with each of them, a line each.
        diagnostics: What to know of the repair.
    """

    links: Mapping[str, Inertia]
    bodies: Bodies
    flaws: tuple[str, ...]
    diagnostics: tuple[Diagnostic, ...]


def repaired(
    links: Sequence[FileLink],
    suspects: Mapping[str, str],
    parents: Sequence[int],
    given: Bodies | None,
    source: str,
    reach: float,
) -> Repair:
    """Replace inertias of a file that no body, or none of such lengths, has.

    Args:
        links: All of the file, carriers before what they carry.
        suspects: What is wrong with single links, by name.
        parents: Of the tree's bodies, where chains may end in bodies without matter; else ().
        given: Bodies to take in place of the file's, as `Repair.bodies` has them; what else is
            wrong is refused then. None takes the nearest bodies.
        source: The file's name, for messages.
        reach: Sum of the distances from joint to joint [m].

    Raises:
        InertiaError: A body is wrong, and none is given in its place.
        ModelError: A mass is negative or a number is none: no body is near.
        UnknownName: A body is given for a link that is fixed to another, or is not there.
    """
    groups: dict[str, list[FileLink]] = {}  # the first of each carries the others
    for link in links:
        groups.setdefault(link.carrier, []).append(link)
    given_bodies = dict(given or {})
    for name in given_bodies:
        if name not in groups:
            raise UnknownName("link to repair", name, groups)
    bodies = {name: _lump(*group) for name, group in groups.items()} | given_bodies
    moving = {name: body for name, body in bodies.items() if groups[name][0].body >= 0}
    ball, odd = _out_of_scale(moving, reach)
    bodies |= dict.fromkeys(odd, ball)
    doubted = {
        link.carrier: suspects[link.name]
        for link in links[::-1]
        if link.name in suspects
    }
    judged = [name for name in groups if name in doubted or name in given_bodies]
    flaws = _flaws({name: bodies[name] for name in judged}, doubted, source)
    flaws |= dict(_bare_ends(links, bodies, parents))
    robot = _Size.of(bodies.values())
    nearest = {name: robot.nearest(bodies[name]) for name in flaws}
    slight = [name for name in flaws if robot.slight(bodies[name], nearest[name])]
    grave = {name: line for name, line in flaws.items() if name not in slight}
    diagnostics = _diagnostics(odd.values(), slight, grave)
    nearest, grave = nearest | dict.fromkeys(odd, ball), grave | odd
    if grave and given is not None:
        raise InertiaError(source, list(grave.values()))
    changed = {name: bodies[name] for name in judged} | nearest
    emptied = (x.name for n in changed for x in groups[n][1:] if x.inertia.pseudo.any())
    return Repair(
        links=dict.fromkeys(emptied, NOTHING) | changed,
        bodies={name: nearest[name] for name in grave},
        flaws=tuple(grave.values()),
        diagnostics=tuple(diagnostics),
    )


def _flaws(bodies: Bodies, doubted: Mapping[str, str], source: str) -> dict[str, str]:
    """What is wrong with bodies, by name; `doubted` is what is wrong with the first link of each.

    Raises:
        ModelError: No body is near one of them.
    """
    flaws = {name: line for name, body in bodies.items() if (line := _flaw(name, body))}
    for name, line in flaws.items():
        if not (bodies[name].mass >= 0 and bodies[name].within_limits):
            raise ModelError(f"{source}: {doubted.get(name, line)}; correct the file")
    return flaws


def _diagnostics(
    odd: Iterable[str], slight: Iterable[str], grave: Iterable[str]
) -> Iterator[Diagnostic]:
    """What to know of bodies out of proportion, off by rounding, and off by more."""
    for line in odd:
        yield diagnose("model.scale", line)
    if slight:
        yield diagnose("model.rounding", quoted(slight))
    if grave:
        yield diagnose("model.inertia", quoted(grave))


@dataclass(frozen=True)
class _Size:
    """Of a robot: what is small is so beside it.

    Attributes:
        mass: [kg].
        reach: The largest radius of gyration of its bodies about their frames [m].
    """

    mass: float
    reach: float

    @staticmethod
    def of(bodies: Iterable[Inertia]) -> _Size:
        heavy = [body for body in bodies if body.mass > 0]
        reach = max([0.0, *(body.radius for body in heavy)])
        return _Size(sum(body.mass for body in heavy) or 1.0, reach or 1.0)

    def nearest(self, body: Inertia) -> Inertia:
        """The nearest body that can be."""
        return nearest_body(body, THINNEST, LIGHTEST * self.mass, self.reach)

    def slight(self, old: Inertia, new: Inertia) -> bool:
        """Whether a body is changed by no more than rounding."""
        spread = old.pseudo[:3, :3] - old.mass * np.outer(old.com, old.com)
        # change of a body's second moments that is rounding, in parts of its greatest
        own = 1e-4 * np.linalg.eigvalsh(spread)[-1]
        change = np.abs(new.pseudo - old.pseudo).max()
        # the same in parts of the robot's: its mass times the square of its largest radius of
        # gyration
        whole = 1e-9 * self.mass * self.reach**2
        return bool(old.mass == new.mass and change <= max(own, whole))


def _out_of_scale(bodies: Bodies, reach: float) -> tuple[Inertia, dict[str, str]]:
    """Body of average size, and a message for bodies out of proportion, by name."""
    known = {
        name: body
        for name, body in bodies.items()
        if body.mass > 0 and body.within_limits
    }
    sizes = {name: (body.mass, body.radius) for name, body in known.items()}
    # mass of a body in parts of the robot's median one at least
    dust, reach = (
        1e-7 * np.median([0.0, *(mass for mass, _ in sizes.values())]),
        max(reach, 1.0),
    )
    odd, good = {}, []
    for name, (mass, radius) in sizes.items():
        # mass over the cube of the robot's lengths at most, more than steel's [kg/m^3], and radius
        # of gyration of a body about its frame in parts of them
        if dust < mass < 1e4 * reach**3 and radius < 10.0 * reach:
            good.append((mass, radius))
        else:
            odd[name] = _SIZE.format(name, mass, radius)
    mass, radius = np.mean(good or [(1.0, SMALL * reach)], axis=0)
    ball = 2 / 3 * mass * radius**2 * np.eye(3)
    return Inertia.about_centre(mass, np.zeros(3), ball), odd


_SIZE = "link '{}' has a mass of {:.4g} kg with a radius of gyration of {:.4g} m about its joint"


def _lump(carrier: FileLink, *others: FileLink) -> Inertia:
    """A link and all that is fixed to it, about and along its frame; alone to the last bit."""
    X_CB = carrier.X_BL.inverse
    full = (link for link in others if link.inertia.pseudo.any())
    return carrier.inertia + total(
        link.inertia.moved(X_CB @ link.X_BL) for link in full
    )


def _flaw(name: str, body: Inertia) -> str | None:
    """What is wrong with a body; moments that are rounding beside its distance are none."""
    central = body.central
    if np.abs(central).max() <= ROUNDING * np.abs(body.tensor).max():
        central = np.zeros((3, 3))
    return inertia_flaw(name, body.mass, central)


def _bare_ends(
    links: Sequence[FileLink], bodies: Bodies, parents: Sequence[int]
) -> Iterator[tuple[str, str]]:
    """Bodies of the tree without matter that carry none, and what is wrong with them."""
    full = [False] * len(parents)
    for link in links:
        if (
            0 <= link.body < len(full)
            and link.name in bodies
            and bodies[link.name].pseudo.any()
        ):
            full[link.body] = True
    for body in reversed(range(len(parents))):
        if full[body] and parents[body] >= 0:
            full[parents[body]] = True
    first = {link.body: link.carrier for link in reversed(links)}
    for body, name in sorted(first.items()):
        if 0 <= body < len(parents) and any(full) and not full[body]:
            yield (
                name,
                f"link '{name}' moves, and neither it nor what it carries has a mass",
            )
