"""Where data contradict what any bodies, friction and rotors can be."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Protocol

import numpy as np
from scipy import special

from testbed.arrays import Array
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


def warnings_of(
    estimates: Sequence[Estimate], bent: Iterable[_Bent], unsettled: float
) -> Iterator[str]:
    """What a careful reader of consistent bodies should know, a line each.

    Args:
        estimates: That they were made of.
        bent: How far each had to give way.
        unsettled: Sigmas that the program could still gain.
    """
    if not unsettled < SETTLED:
        yield f"the program of consistent bodies has not ended: {unsettled:.2g} sigma are open"
    for estimate, moved in zip(estimates, bent, strict=True):
        if moved.widened > SURE:
            yield (
                f"the plate contradicts the {estimate.method} estimate by {moved.widened:.3g} of "
                "its sigmas, by which they are widened: torque constants, or friction of another "
                "law, are likely (`testbed drives`)"
            )
        yield from _moved_far(estimate, moved)
        yield from _negative(estimate)
    yield from _without_place(estimates)


def counted_twice(prior: Prior, used: Sequence[Estimate]) -> Iterator[str]:
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
            yield (
                "the model file states rotors' inertias, and joint torques without the term "
                "'rotor' take them for the bodies': in a written file they count twice; add it to "
                "identification.terms"
            )


def left_out(estimates: Sequence[Estimate], used: Sequence[Estimate]) -> Iterator[str]:
    """Estimates that could not be used.

    Args:
        estimates: All.
        used: Those that were.
    """
    for estimate in estimates:
        if not any(each is estimate for each in used):
            yield (
                f"the {estimate.method} estimate is left out of the consistent bodies: of "
                f"{sum(estimate.samples)} rows for {len(estimate.names)} unknowns there is no "
                "covariance"
            )


def _moved_far(estimate: Estimate, moved: _Bent) -> Iterator[str]:
    """An estimate that no bodies come near, or none of those that were asked for."""
    limit = float(np.sqrt(special.chdtri(len(moved.names), 2 * special.ndtr(-SURE))))
    if moved.distance <= limit:
        return
    worst = np.argsort(-np.abs(moved.sigmas))[:3]
    names = ", ".join(f"{moved.names[k]} by {moved.sigmas[k]:+.3g} sigma" for k in worst)
    found = possibility(estimate, SURE, 0.0)
    if found.impossible:
        yield (
            f"the {estimate.method} estimate contradicts physics: any bodies are at least "
            f"{found.distance:.3g} of its sigmas away (noise reaches {found.limit:.3g}); moved "
            f"most are {names}: a wrong sign, frame or unit of a channel, or an effect that no "
            "term holds"
        )
    else:
        yield (
            f"the {estimate.method} estimate is {moved.distance:.3g} sigma from the consistent "
            f"bodies (noise reaches {limit:.3g}); moved most are {names}: what is asked of the "
            "bodies, another estimate, or a model file that is worse than prior_error says keeps "
            "them apart"
        )


def _negative(estimate: Estimate) -> Iterator[str]:
    """Friction and rotors that are surely below zero."""
    for term in estimate.joint_terms:
        known = term.law.resists or term.law == ROTOR
        if known and term.value < -SURE * term.sigma:
            yield (
                f"the {estimate.method} estimate contradicts physics: {term.name} is "
                f"{term.value:.4g} +- {term.sigma:.2g} {term.unit}, which cannot be negative: a "
                "wrong sign of the joint's torque or encoder is likely"
            )


def _without_place(estimates: Sequence[Estimate]) -> Iterator[str]:
    """Terms that model files have no place for."""
    terms = [t for each in estimates for t in each.joint_terms]
    lost = [t.name for t in terms if t.law not in LAWS or t.law.parameter is None]
    if lost:
        yield f"model files have no place for {few(lost)}: a written file predicts without them"
