"""Bodies that could exist, by estimates and a model file together, weighted by held-out data."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from testbed.bodies.consistency.known_masses import known_masses
from testbed.bodies.consistency.likelihood import (
    Likelihood,
    agreeing,
    evidence,
    precise,
    terms_of,
)
from testbed.bodies.consistency.options import ConsistencyOptions
from testbed.bodies.consistency.program import NonlinearProgram, program_of, solve
from testbed.bodies.prior import Prior
from testbed.core.base.arrays import Array, freeze
from testbed.core.base.blas import one_blas_thread
from testbed.core.base.codec import with_properties
from testbed.core.base.diagnostics import Diagnosed, Diagnostic, diagnose
from testbed.core.base.errors import RecordingError, few
from testbed.core.base.gaussian import Gaussian
from testbed.core.estimation.diagnostics.rigid_bodies import rigid_body_test
from testbed.core.estimation.estimate import Estimate, Method
from testbed.core.estimation.regression.normal_equations import (
    TINY,
    standard_deviations,
)
from testbed.core.parameters.pseudo_inertia import matrices
from testbed.core.parameters.symbols import with_standard
from testbed.core.robot.friction import ROTOR, JointTerm
from testbed.core.robot.shafts import places
from testbed.core.robot.tree import Tree

CLOSE = 1e-6
"""A condition that is obeyed with less than this part of the prior's size binds."""

FAINT = 1e-12
"""Weight of terms that no file states, so that their variance before the data has a number."""

SURE = 3.0
"""Sigmas beyond which data and physics contradict each other."""

SETTLED = 0.1
"""Sigmas that a program may leave open."""

THIN = 1e-2
"""Parts of the prior's body below which a body is at the edge of what can be."""


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Reconciliation(Gaussian):
    """Parameters of one estimate by the consistent bodies; sigma counts the prior's doubt.

    Attributes:
        method: Of the estimate.
        plain: As estimated, (p,).
        plain_sigma: (p,), widened where another estimate contradicts it.
        widened: By how much.
        distance: Between both, in sigmas of all parameters together: about the root of p
            where only noise is between them.
    """

    method: Method
    plain: Array
    plain_sigma: Array
    widened: float
    distance: float

    __get_pydantic_core_schema__ = with_properties("sigma", "sigmas")

    def __post_init__(self) -> None:
        super().__post_init__()
        p = len(self.names)
        freeze(self, plain=(p,), plain_sigma=(p,))

    @property
    def sigmas(self) -> Array:
        """By how many of its own sigmas each parameter was moved, (p,)."""
        gap = self.values - self.plain
        return gap / np.maximum(self.plain_sigma, TINY)


@dataclass(frozen=True, eq=False)
class Consistent(Diagnosed):
    """Bodies, friction and rotors that could exist.

    Attributes:
        joints: The joints' names, (n,).
        places: Those and the names of shafts that turn with several: where terms are.
        links: The bodies' names, (n,).
        standard: Standard parameters, (n, 10) [kg, kg m, kg m^2].
        sigma: Of each, data's and prior's doubt together, (n, 10).
        data_share: Part of the prior's variance that the data took away, (n, 10): 1 where the data
            identify a parameter, 0 where the prior or what is known filled it in.
        prior: Standard parameters of the model file's bodies, as they were taken, (n, 10).
        terms: Of the joints' torque, t of them.
        coefficients: Theirs, (t,).
        coefficient_sigma: (t,).
        bent: How far each estimate had to give way.
        eigenvalues: Of every J, ascending, lengths in radii of gyration of the body, masses in
            its own, (n, 4); zero for bodies without matter.
        binding: Conditions at their limits, in words.
        unsettled: Sigmas that the program could still gain: far below one where it has ended.
        prior_error: That was used, in parts of the prior's bodies.
        diagnostics: What a careful reader should know.
    """

    joints: tuple[str, ...]
    places: tuple[str, ...]
    links: tuple[str, ...]
    standard: Array
    sigma: Array
    data_share: Array
    prior: Array
    terms: tuple[JointTerm, ...]
    coefficients: Array
    coefficient_sigma: Array
    bent: tuple[Reconciliation, ...]
    eigenvalues: Array
    binding: tuple[str, ...]
    unsettled: float
    prior_error: float
    diagnostics: tuple[Diagnostic, ...]

    def __post_init__(self) -> None:
        n, t = len(self.joints), len(self.terms)
        shapes = dict.fromkeys(("standard", "sigma", "data_share", "prior"), (n, 10))
        freeze(self, **shapes, eigenvalues=(n, 4))
        freeze(self, coefficients=(t,), coefficient_sigma=(t,))


def consistent(
    tree: Tree,
    estimates: Sequence[Estimate],
    prior: Prior,
    options: ConsistencyOptions | None = None,
) -> Consistent:
    """Bodies that could exist, fit what was measured, and are near the model file's otherwise.

    Args:
        tree: The robot; its inertias do not matter.
        estimates: Of one recording, one a method; what each says of x counts by itself.
        prior: The bodies before the data.
        options: What is asked besides; default `ConsistencyOptions()`.

    Raises:
        SettingsError: No bodies obey all that is asked.
        RecordingError: There is no estimate whose covariance is one.
        UnknownName: A wish is about a link that is not there.
    """
    options = options or ConsistencyOptions()
    with one_blas_thread():
        used, likelihoods, program = problem_of(tree, estimates, prior, options)
        weight = 1 / options.prior_error**2
        z, left = solve(program, weight)
        spread, shares = spread_at(program, z, weight)
    x, sigma, terms = program.lead @ z, standard_deviations(spread), terms_of(used)
    bodies = x[: 10 * tree.n].reshape(-1, 10)
    bent = tuple(_bent(each, x, spread) for each in likelihoods)
    return Consistent(
        joints=tree.names,
        places=places(tree),
        links=tuple(each.body for each in tree.joints),
        standard=bodies,
        sigma=sigma[: 10 * tree.n].reshape(-1, 10),
        data_share=shares[: 10 * tree.n].reshape(-1, 10),
        prior=prior.standard,
        terms=terms,
        coefficients=x[10 * tree.n :],
        coefficient_sigma=sigma[10 * tree.n :],
        bent=bent,
        eigenvalues=np.array([_eigenvalues(each) for each in bodies]),
        binding=tuple(_at_limits(tree, program, terms, z)),
        unsettled=left,
        prior_error=options.prior_error,
        diagnostics=tuple(_diagnostics(prior, estimates, used, bent, left)),
    )


def problem_of(
    tree: Tree, estimates: Sequence[Estimate], prior: Prior, options: ConsistencyOptions
) -> tuple[list[Estimate], list[Likelihood], NonlinearProgram]:
    """Data, prior and conditions in numbers near one, and the estimates that count.

    Arguments and errors are those of `consistent`.
    """
    used, blind = _usable(estimates), tree.without_inertias()
    terms = terms_of(used)
    likelihoods = agreeing([evidence(blind, each, terms) for each in used])
    known = known_masses(tree, prior, options)
    return used, likelihoods, program_of(blind, prior, likelihoods, known, terms)


def _usable(estimates: Sequence[Estimate]) -> list[Estimate]:
    """Those that have a covariance."""
    used = [each for each in estimates if precise(each)]
    if not used:
        raise RecordingError(
            "consistent bodies need an estimate with a covariance, and hardly more rows than "
            "unknowns give none: record a longer or richer motion"
        )
    return used


def robot_of(found: Consistent, tree: Tree) -> Tree:
    """The robot with its consistent bodies, friction and rotors; other terms have no place there.

    Args:
        found: Of this robot.
        tree: The robot.
    """
    settings: dict[str, dict[str, object]] = {name: {} for name in tree.names}
    for term, value in zip(found.terms, found.coefficients.tolist(), strict=True):
        if term.law.parameter is not None and term.joint < tree.n:
            settings[tree.names[term.joint]][term.law.parameter] = max(value, 0.0)
    return with_standard(tree, np.array(found.standard)).with_joints(settings)


def spread_at(
    program: NonlinearProgram, z: Array, weight: float
) -> tuple[Array, Array]:
    """Covariance of x, (m, m), and the part of each variance that the data took away, (m,).

    Args:
        program: In numbers near one.
        z: The unknowns, (m,).
        weight: Of the prior.
    """
    besides = program.rows[program.measured :]
    before = weight * program.prior_hessian(z) + besides.T @ besides
    rest = np.arange(10 * program.bodies, len(z))
    before[rest, rest] += FAINT
    data = program.rows[: program.measured]
    lead = program.lead @ program.free

    def covariance(hessian: Array) -> Array:
        return lead @ np.linalg.inv(program.free.T @ hessian @ program.free) @ lead.T

    prior, found = np.diagonal(covariance(before)), covariance(before + data.T @ data)
    # else what is known settles it
    open_before = prior > FAINT * (program.lead**2).sum(axis=1)
    share = 1 - np.divide(
        np.diagonal(found), prior, out=np.ones_like(prior), where=open_before
    )
    return found * np.outer(open_before, open_before), np.clip(share, 0.0, 1.0)


def _bent(likelihoods: Likelihood, x: Array, spread: Array) -> Reconciliation:
    """How far an estimate had to give way."""
    estimate = likelihoods.estimate
    return Reconciliation(
        method=estimate.method,
        names=estimate.names,
        units=estimate.units,
        plain=estimate.values,
        plain_sigma=likelihoods.widened * estimate.sigma,
        values=likelihoods.rows @ x,
        covariance=likelihoods.rows @ spread @ likelihoods.rows.T,
        widened=likelihoods.widened,
        distance=float(np.linalg.norm(likelihoods.left(x))),
    )


def _eigenvalues(body: Array) -> Array:
    """Of J without units, ascending, (4,); zero without matter."""
    if not body[0]:
        return np.zeros(4)
    whole = matrices(body) / body[0]
    radius = np.sqrt(max(np.trace(whole[:3, :3]) - whole[:3, 3] @ whole[:3, 3], TINY))
    size = np.array([radius, radius, radius, 1.0])
    return np.linalg.eigvalsh(whole / np.outer(size, size))


def _at_limits(
    tree: Tree, program: NonlinearProgram, terms: Sequence[JointTerm], z: Array
) -> Iterator[str]:
    """Bodies at the edge of what can be, and conditions that bind."""
    for body, own in zip(program.prior.massive, program.matrices(z), strict=True):
        if np.linalg.eigvalsh(own)[0] < THIN:
            yield f"'{tree.joints[body].body}' a possible body"
    for k in program.positive[z[program.positive] < CLOSE] - 10 * program.bodies:
        yield f"{terms[k].name(tree)} not negative"


def _diagnostics(
    prior: Prior,
    estimates: Sequence[Estimate],
    used: Sequence[Estimate],
    bent: Sequence[Reconciliation],
    unsettled: float,
) -> Iterator[Diagnostic]:
    """What a careful reader should know of estimates, those used, and the program's end."""
    yield from prior.diagnostics
    for each in estimates:
        if not any(each is other for other in used):
            subject, unknowns = f"the {each.method} estimate", len(each.names)
            rows = sum(each.samples)
            yield diagnose("bodies.left-out", subject, rows=rows, unknowns=unknowns)
    for each in used:
        if each.drives is None or not prior.rotors.any():
            continue
        if not any(term.law == ROTOR for term in each.drives.asked):
            yield diagnose("bodies.rotors", method=each.method)
    if not unsettled < SETTLED:
        yield diagnose("bodies.not-converged", "the consistent bodies", unsettled)
    for estimate, moved in zip(used, bent, strict=True):
        if moved.widened > SURE:
            subject = f"the {estimate.method} estimate"
            yield diagnose(
                "bodies.conflict", subject, moved.widened, method=estimate.method
            )
        yield from _moved_far(estimate, moved)
        yield from _negative(estimate)
    terms = [term for each in used for term in each.joint_terms]
    if lost := [t.name for t in terms if t.law.parameter is None]:
        yield diagnose("bodies.no-place", few(lost))


def _moved_far(estimate: Estimate, moved: Reconciliation) -> Iterator[Diagnostic]:
    """An estimate that no bodies come near, or none of those that were asked for."""
    limit = float(np.sqrt(special.chdtri(len(moved.names), 2 * special.ndtr(-SURE))))
    if moved.distance <= limit:
        return
    found = rigid_body_test(estimate, SURE, 0.0)
    far, noise = (
        (found.distance, found.limit) if found.impossible else (moved.distance, limit)
    )
    worst = np.argsort(-np.abs(moved.sigmas))[:3]
    yield diagnose(
        "bodies.impossible" if found.impossible else "bodies.far",
        f"the {estimate.method} estimate",
        far,
        method=estimate.method,
        limit=noise,
        changes=", ".join(
            f"{moved.names[k]} by {moved.sigmas[k]:+.3g} sigma" for k in worst
        ),
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
