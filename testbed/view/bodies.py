"""Physically consistent bodies: link by link, in sentences, and as ellipsoids on the robot."""

from __future__ import annotations

from html import escape

import numpy as np

from testbed.bodies.consistency.consistent import Consistent, robot_of
from testbed.bodies.consistency.robots import Robots
from testbed.bodies.linear_prior import DETERMINED
from testbed.bodies.shapes.shapes import Shape, equivalent_ellipsoids
from testbed.core.base.arrays import Array
from testbed.core.base.summary_table import number_with_sigma
from testbed.core.dynamics.newton_euler import poses
from testbed.core.estimation.estimate import NAMES
from testbed.core.parameters.symbols import STANDARD, with_standard
from testbed.core.robot.tree import Tree
from testbed.lab.experiment.run import Run
from testbed.view.portrait import view
from testbed.view.section import Drawing, Section, Table

LISTED = 6
"""Most conditions in one line."""

SIZE = 480
"""Pixels of a drawing's longer side."""

BORDER = 16
"""Free on every side [pixels]."""

STYLES = {"measured": "5 3", "truth": "1 3", "external": "none"}
"""Dashes of an outline, by colour."""

VIEWS = {
    "from the side": (0.9, -1.6, 0.65),
    "from above": (0.05, -0.1, 2.0),
}
"""Where drawings are taken from."""


def consistent_tables(found: Consistent) -> list[Table]:
    """Standard parameters, link by link, and the joints' own terms.

    Args:
        found: The bodies, friction and rotors.
    """
    rows = [
        [
            link if c == 0 else "",
            name,
            f"{found.prior[k, c]:.4g}",
            number_with_sigma(float(found.standard[k, c]), float(found.sigma[k, c]), short=True),
            f"{found.data_share[k, c]:.0%}",
        ]
        for k, link in enumerate(found.links)
        for c, name in enumerate(STANDARD)
    ]
    title = (
        "physically consistent bodies, about and along their frames [kg, kg m, kg m^2]; data: "
        "share of the prior variance that the data remove"
    )
    tables = [Table(["link", "", "model file", "estimate", "data"], rows, title, left=[""])]
    terms = zip(found.terms, found.coefficients, found.coefficient_sigma, strict=True)
    own = [
        [
            f"{term.law.kind}/{found.places[term.joint]}",
            number_with_sigma(float(value), float(sigma), short=True),
        ]
        for term, value, sigma in terms
    ]
    return [*tables, *([Table(["joint's own", "estimate"], own)] if own else [])]


def draws_table(found: Robots) -> Table:
    """Mean and standard deviation of all that is drawn, and whose they are.

    Args:
        found: The draws.
    """
    rows = [
        [
            f"{link}, {joint}" if c == 0 else "",
            name,
            number_with_sigma(float(found.mean[k, c]), float(found.sigma[k, c]), short=True),
            f"{found.share[k, c]:.0%}",
            _origin(float(found.share[k, c])),
        ]
        for k, (link, joint) in enumerate(zip(found.links, found.joints, strict=True))
        for c, name in enumerate(found.names)
    ]
    title = (
        "robots drawn [kg, kg m, kg m^2, N m, N m s/rad]; data: share of the prior variance that "
        f"the data remove; the model file is taken to be wrong by {found.prior_error:g}"
    )
    return Table(["link, joint", "", "draws", "data", "from"], rows, title, left=["", "from"])


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
    massive = found.eigenvalues[:, -1] > 0
    lines = []
    if massive.any():
        least = found.eigenvalues[:, 0] / np.where(massive, found.eigenvalues[:, -1], 1.0)
        worst = int(np.argmin(np.where(massive, least, np.inf)))
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
        more = f" and {len(found.binding) - LISTED} more" if len(found.binding) > LISTED else ""
        lines.append(f"At their limits: {'; '.join(found.binding[:LISTED])}{more}.")
    lines.append(
        f"Prior: the model file's bodies, with a relative standard deviation of "
        f"{found.prior_error:.2g}; data is the share of that variance which the data remove."
    )
    return lines


def bodies_section(run: Run, found: Consistent) -> Section:
    """Ellipsoids, and mass, centre and share of the data of every link.

    Args:
        run: The run.
        found: Its consistent bodies.
    """
    robots = {"measured": with_standard(run.tree, found.prior)}
    if run.score is not None:
        robots["truth"] = run.tree
    robots["external"] = robot_of(found, run.tree)
    names = {"measured": "model file", "truth": "truth", "external": "estimate"}
    return Section(
        id="bodies",
        title="Physically consistent bodies",
        says=(
            "Each link as the ellipsoid of uniform density with its mass, centre and "
            "inertia. " + " ".join(consistent_lines(found))
        ),
        legend={kind: names[kind] for kind in robots},
        panels=[
            Drawing(title, _drawn(robots, run.recording.position[:1], np.array(eye), title))
            for title, eye in VIEWS.items()
        ],
        caption=(
            "The robot at the start of the recording. Data is the share of the prior variance "
            "that the data remove, averaged over a link's ten parameters."
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


def _drawn(robots: dict[str, Tree], posture: Array, eye: Array, title: str) -> str:
    """Outlines of all robots' ellipsoids, and sticks."""
    camera = view(eye)[:2]
    tree = next(iter(robots.values()))
    placed = [(rotation[0], position[0]) for rotation, position in poses(tree, posture)]
    outlines = [
        (kind, *_outline(shape, placed[shape.body], camera))
        for kind, robot in robots.items()
        for shape in equivalent_ellipsoids(robot, (0.0, 0.0, 0.0, 1.0))
    ]
    origins = [np.zeros(2), *(camera @ position for _, position in placed)]
    corners = [np.stack([c - reach, c + reach]) for _, c, reach, _, _ in outlines]
    every = np.concatenate([np.stack(origins), *corners])
    low, high = every.min(axis=0), every.max(axis=0)
    scale = SIZE / max(float((high - low).max()), 1e-9)
    width, height = (high - low) * scale

    def pixels(point: Array) -> tuple[float, float]:
        return float((point[0] - low[0]) * scale), float((high[1] - point[1]) * scale)

    parts = []
    for joint, own in zip(tree.joints, origins[1:], strict=True):
        (x1, y1), (x2, y2) = pixels(origins[joint.parent + 1]), pixels(own)
        parts.append(
            f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" '
            'stroke="var(--line)" stroke-width="6" stroke-linecap="round"/>'
        )
    for kind, centre, _, half, angle in outlines:
        x, y = pixels(centre)
        a, b = np.maximum(half * scale, 1.0)
        parts.append(
            f'<ellipse cx="{x:.1f}" cy="{y:.1f}" rx="{a:.1f}" ry="{b:.1f}" '
            f'transform="rotate({-angle:.1f} {x:.1f} {y:.1f})" fill="none" '
            f'stroke="var(--{kind})" stroke-width="2" stroke-dasharray="{STYLES[kind]}"/>'
        )
    box = f"{-BORDER} {-BORDER} {width + 2 * BORDER:.0f} {height + 2 * BORDER:.0f}"
    name = escape(f"Links as ellipsoids, {title}")
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{box}" role="img" aria-label="{name}" '
        f'style="max-height:24rem">{"".join(parts)}</svg>'
    )


def _outline(
    shape: Shape, pose: tuple[Array, Array], camera: Array
) -> tuple[Array, Array, Array, float]:
    """Of an ellipsoid in a picture: centre, reach, half axes, (2,) each [m], angle [degrees]."""
    rotation, position = pose
    axes = camera @ rotation @ shape.rotation * shape.size
    spread = axes @ axes.T
    size, turn = np.linalg.eigh(spread)
    angle = float(np.degrees(np.arctan2(turn[1, 1], turn[0, 1])))
    half = np.sqrt(np.maximum(size[::-1], 0.0))
    centre = camera @ (position + rotation @ shape.position)
    return centre, np.sqrt(np.diagonal(spread)), half, angle
