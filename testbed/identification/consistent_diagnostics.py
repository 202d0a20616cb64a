"""Where data contradict what any bodies, friction and rotors can be."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Protocol

import numpy as np
from scipy import special

from testbed.arrays import Array
from testbed.diagnostics.diagnostic import Diagnostic, diagnose
from testbed.errors import few
from testbed.identification.estimate import Estimate
from testbed.identification.rigid_bodies import possibility
from testbed.parameters.prior import Prior
from testbed.robot.friction import LAWS, ROTOR

SURE = 3.0
"""Sigmas beyond which data and physics contradict each other."""


SETTLED = 0.1
"""Sigmas that a program may leave open."""


class _Bent(Protocol):
    @property
    def distance(self) -> float: ...
    @property
    def names(self) -> tuple[str, ...]: ...
    @property
    def widened(self) -> float: ...
    @property
    def sigmas(self) -> Array: ...


def diagnostics_of(
    estimates: Sequence[Estimate], bent: Iterable[_Bent], unsettled: float
) -> Iterator[Diagnostic]:
    """What a careful reader of consistent bodies should know.

    Args:
        estimates: That they were made of.
        bent: How far each had to give way.
        unsettled: Standard deviations that the program could still gain.
    """
    if not unsettled < SETTLED:
        yield diagnose("bodies.not-converged", "the consistent bodies", unsettled)
    for estimate, moved in zip(estimates, bent, strict=True):
        if moved.widened > SURE:
            subject = f"the {estimate.method} estimate"
            yield diagnose("bodies.conflict", subject, moved.widened, method=estimate.method)
        yield from _moved_far(estimate, moved)
        yield from _negative(estimate)
    terms = [term for each in estimates for term in each.joint_terms]
    if lost := [t.name for t in terms if t.law not in LAWS or t.law.parameter is None]:
        yield diagnose("bodies.no-place", few(lost))


def counted_twice(prior: Prior, used: Sequence[Estimate]) -> Iterator[Diagnostic]:
    """Rotors of the file that torques take for the bodies'.

    Args:
        prior: What the file states.
        used: Estimates.
    """
    for estimate in used:
        drives = estimate.drives
        if (
            drives is not None
            and prior.rotors.any()
            and not any(term.law == ROTOR for term in drives.asked)
        ):
            yield diagnose("bodies.rotors", method=estimate.method)


def left_out(estimates: Sequence[Estimate], used: Sequence[Estimate]) -> Iterator[Diagnostic]:
    """Estimates that could not be used.

    Args:
        estimates: All.
        used: Those that were.
    """
    for estimate in estimates:
        if not any(each is estimate for each in used):
            yield diagnose(
                "bodies.left-out",
                f"the {estimate.method} estimate",
                method=estimate.method,
                rows=sum(estimate.samples),
                unknowns=len(estimate.names),
            )


def _moved_far(estimate: Estimate, moved: _Bent) -> Iterator[Diagnostic]:
    """An estimate that no bodies come near, or none of those that were asked for."""
    limit = float(np.sqrt(special.chdtri(len(moved.names), 2 * special.ndtr(-SURE))))
    if moved.distance <= limit:
        return
    found = possibility(estimate, SURE, 0.0)
    far, noise = (found.distance, found.limit) if found.impossible else (moved.distance, limit)
    worst = np.argsort(-np.abs(moved.sigmas))[:3]
    yield diagnose(
        "bodies.impossible" if found.impossible else "bodies.far",
        f"the {estimate.method} estimate",
        far,
        method=estimate.method,
        limit=noise,
        changes=", ".join(f"{moved.names[k]} by {moved.sigmas[k]:+.3g} sigma" for k in worst),
    )


def _negative(estimate: Estimate) -> Iterator[Diagnostic]:
    """Friction and rotors that are surely below zero."""
    for term in estimate.joint_terms:
        known = term.law.resists or term.law == ROTOR
        if known and term.value < -SURE * term.sigma:
            yield diagnose(
                "bodies.negative",
                term.name,
                term.value,
                sigma=term.sigma,
                method=estimate.method,
                unit=term.unit,
            )
