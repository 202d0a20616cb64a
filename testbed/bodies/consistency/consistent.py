"""Physically consistent bodies from estimates, with a model file as prior."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from testbed.bodies.consistency.known_masses import known_masses
from testbed.bodies.consistency.likelihood import (
    Likelihood,
    has_valid_covariance,
    joint_terms_of,
    likelihood_of,
    with_widened_torques,
)
from testbed.bodies.consistency.options import ConsistencyOptions
from testbed.bodies.consistency.program import (
    NonlinearProgram,
    nonlinear_program,
    solve_program,
)
from testbed.bodies.prior import PriorBodies
from testbed.core.base.arrays import Array, freeze_arrays
from testbed.core.base.blas import one_blas_thread
from testbed.core.base.codec import schema_with_properties
from testbed.core.base.diagnostics import Diagnosed, Diagnostic, make_diagnostic
from testbed.core.base.errors import RecordingError, shortened_list
from testbed.core.base.gaussian import Gaussian
from testbed.core.estimation.diagnostics.rigid_bodies import rigid_body_test
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.regression.normal_equations import (
    SMALLEST_POSITIVE,
    standard_deviations,
)
from testbed.core.parameters.pseudo_inertia import pseudo_inertias
from testbed.core.parameters.rules import Signal
from testbed.core.parameters.symbols import with_standard_parameters
from testbed.core.robot.friction import ROTOR, JointTerm
from testbed.core.robot.shafts import joint_and_shaft_names
from testbed.core.robot.tree import Tree

ACTIVE_TOLERANCE = 1e-6
"""Relative value of a joint term below which its non-negativity constraint is active."""

FREE_TERM_WEIGHT = 1e-12
"""Prior weight of joint terms that are not in the model file: a finite prior variance."""

Z_THRESHOLD = 3.0
"""Number of sigmas beyond which differences are reported as contradictions."""

MAX_DECREMENT = 0.1
"""Largest Newton decrement of a converged program [sigma]."""

MIN_EIGENVALUE = 1e-2
"""Smallest eigenvalue of Y below which a body is reported as nearly singular."""


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Reconciliation(Gaussian):
    """Parameters of one estimate, computed from the consistent bodies.

    The property `sigma` includes the uncertainty of the prior.

    Attributes:
        method: Method of the estimate.
        plain: Values of the estimate itself, (p,).
        plain_sigma: Standard deviations of the estimate itself, (p,), multiplied by `widened`.
        widened: Factor, at least one, for a contradiction with another estimate.
        distance: Norm of the whitened differences between estimate and consistent bodies [sigma];
            about sqrt(p) if the differences are only noise.
    """

    method: Signal
    plain: Array
    plain_sigma: Array
    widened: float
    distance: float

    __get_pydantic_core_schema__ = schema_with_properties("sigma", "sigmas")

    def __post_init__(self) -> None:
        super().__post_init__()
        p = len(self.names)
        freeze_arrays(self, plain=(p,), plain_sigma=(p,))

    @property
    def sigmas(self) -> Array:
        """Differences from the estimate, in standard deviations of the estimate, (p,)."""
        gap = self.values - self.plain
        return gap / np.maximum(self.plain_sigma, SMALLEST_POSITIVE)


@dataclass(frozen=True, eq=False)
class Consistent(Diagnosed):
    """Physically consistent bodies, friction and rotor inertias of a robot.

    Attributes:
        joints: Names of the joints, (n,).
        places: Names that the indices of joint terms refer to: the joints, then the shafts that
            turn with several joints.
        links: Names of the bodies, (n,).
        standard: Standard parameters m mx my mz Ixx Ixy Iyy Ixz Iyz Izz about and along the body
            frames, (n, 10) [kg, kg m, kg m^2].
        sigma: Posterior standard deviations of `standard`, (n, 10).
        data_share: Fraction of the prior variance that the data remove, (n, 10): 1 for parameters
            that the data identify, 0 for parameters that the prior or known masses determine.
        prior: Standard parameters of the prior bodies, (n, 10).
        terms: Joint torque terms, (t,).
        coefficients: Coefficients of the terms, (t,).
        coefficient_sigma: Standard deviations of the coefficients, (t,).
        bent: Comparison of each estimate with the consistent bodies.
        eigenvalues: Eigenvalues of each pseudo-inertia, ascending, (n, 4), with the body's radius
            of gyration and mass as units; zero for massless bodies.
        binding: Descriptions of the active constraints.
        unsettled: Newton decrement at the end [sigma]; far below one after convergence.
        prior_error: Relative error of the prior bodies.
        diagnostics: Diagnostics of prior, estimates and solution.
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
        freeze_arrays(self, **shapes, eigenvalues=(n, 4))
        freeze_arrays(self, coefficients=(t,), coefficient_sigma=(t,))


def consistent(
    tree: Tree,
    estimates: Sequence[Estimate],
    prior: PriorBodies,
    options: ConsistencyOptions | None = None,
) -> Consistent:
    """Physically consistent bodies that fit estimates and otherwise stay near the model file.

    They minimise half the sum of the estimates' squared whitened residuals plus 1 / prior_error^2
    times a log-determinant divergence from the pseudo-inertias in the file, with non-negative
    friction and rotor inertias. Standard deviations follow from the Laplace approximation.

    Args:
        tree: Robot; its inertias are not used.
        estimates: Estimates from one recording, one per method, with independent errors.
        prior: Prior bodies.
        options: Options; None for `ConsistencyOptions()`.

    Raises:
        SettingsError: The known masses are impossible.
        RecordingError: No estimate has a valid covariance.
        UnknownName: A known mass belongs to a link that does not exist.
    """
    options = options or ConsistencyOptions()
    with one_blas_thread():
        used, likelihoods, program = consistency_program(
            tree, estimates, prior, options
        )
        weight = 1 / options.prior_error**2
        z, decrement = solve_program(program, weight)
        covariance, shares = laplace_covariance(program, z, weight)
    x, sigma, terms = (
        program.x_from_z @ z,
        standard_deviations(covariance),
        joint_terms_of(used),
    )
    bodies = x[: 10 * tree.n].reshape(-1, 10)
    reconciliations = tuple(
        _reconciliation(each, x, covariance) for each in likelihoods
    )
    return Consistent(
        joints=tree.names,
        places=joint_and_shaft_names(tree),
        links=tuple(each.body for each in tree.joints),
        standard=bodies,
        sigma=sigma[: 10 * tree.n].reshape(-1, 10),
        data_share=shares[: 10 * tree.n].reshape(-1, 10),
        prior=prior.standard,
        terms=terms,
        coefficients=x[10 * tree.n :],
        coefficient_sigma=sigma[10 * tree.n :],
        bent=reconciliations,
        eigenvalues=np.array([_scaled_eigenvalues(each) for each in bodies]),
        binding=tuple(_active_constraints(tree, program, terms, z)),
        unsettled=decrement,
        prior_error=options.prior_error,
        diagnostics=tuple(
            _diagnostics(prior, estimates, used, reconciliations, decrement)
        ),
    )


def consistency_program(
    tree: Tree,
    estimates: Sequence[Estimate],
    prior: PriorBodies,
    options: ConsistencyOptions,
) -> tuple[list[Estimate], list[Likelihood], NonlinearProgram]:
    """Estimates with a valid covariance, their likelihoods, and the nonlinear program.

    Arguments and errors are those of `consistent`.
    """
    used, massless_tree = _estimates_with_covariance(estimates), tree.without_inertias()
    terms = joint_terms_of(used)
    likelihoods = with_widened_torques(
        [likelihood_of(massless_tree, each, terms) for each in used]
    )
    known = known_masses(tree, prior, options)
    return (
        used,
        likelihoods,
        nonlinear_program(massless_tree, prior, likelihoods, known, terms),
    )


def _estimates_with_covariance(estimates: Sequence[Estimate]) -> list[Estimate]:
    """Estimates with a positive semidefinite covariance.

    Raises:
        RecordingError: No estimate has a valid covariance.
    """
    used = [each for each in estimates if has_valid_covariance(each)]
    if not used:
        raise RecordingError(
            "consistent bodies need an estimate with a covariance, and hardly more rows than "
            "unknowns give none: record a longer or richer motion"
        )
    return used


def robot_of(bodies: Consistent, tree: Tree) -> Tree:
    """Robot with the consistent bodies, friction and rotor inertias.

    Joint terms for which the tree's joints have no field are left out; negative coefficients become
    zero.

    Args:
        bodies: Consistent bodies of the robot.
        tree: Robot.
    """
    settings: dict[str, dict[str, object]] = {name: {} for name in tree.names}
    for term, value in zip(bodies.terms, bodies.coefficients.tolist(), strict=True):
        if term.law.parameter is not None and term.joint < tree.n:
            settings[tree.names[term.joint]][term.law.parameter] = max(value, 0.0)
    return with_standard_parameters(tree, np.array(bodies.standard)).with_joints(
        settings
    )


def laplace_covariance(
    program: NonlinearProgram, z: Array, weight: float
) -> tuple[Array, Array]:
    """Covariance of x, (m, m), and fraction of each prior variance that the data remove, (m,).

    The covariance is the Laplace approximation at z, within the exact constraints.

    Args:
        program: Program of consistent bodies; x are standard parameters, then joint terms.
        z: Unknowns of the program, (m,).
        weight: Weight of the prior, 1 / prior_error^2.
    """
    other_rows = program.rows[program.data_row_count :]
    prior_hessian = weight * program.prior_hessian(z) + other_rows.T @ other_rows
    term_indices = np.arange(10 * program.body_count, len(z))
    prior_hessian[term_indices, term_indices] += FREE_TERM_WEIGHT
    data = program.rows[: program.data_row_count]
    free_lead = program.x_from_z @ program.null_space_basis

    def covariance(hessian: Array) -> Array:
        return (
            free_lead
            @ np.linalg.inv(
                program.null_space_basis.T @ hessian @ program.null_space_basis
            )
            @ free_lead.T
        )

    prior_variance, posterior_covariance = (
        np.diagonal(covariance(prior_hessian)),
        covariance(prior_hessian + data.T @ data),
    )
    # other parameters are known exactly
    is_uncertain = prior_variance > FREE_TERM_WEIGHT * (program.x_from_z**2).sum(axis=1)
    share = 1 - np.divide(
        np.diagonal(posterior_covariance),
        prior_variance,
        out=np.ones_like(prior_variance),
        where=is_uncertain,
    )
    return posterior_covariance * np.outer(is_uncertain, is_uncertain), np.clip(
        share, 0.0, 1.0
    )


def _reconciliation(
    likelihood: Likelihood, x: Array, covariance: Array
) -> Reconciliation:
    """Comparison of an estimate with the consistent bodies.

    Args:
        likelihood: Likelihood of the estimate.
        x: Standard parameters and joint terms, (m,).
        covariance: Covariance of x, (m, m).
    """
    estimate = likelihood.estimate
    return Reconciliation(
        method=estimate.method,
        names=estimate.names,
        units=estimate.units,
        plain=estimate.values,
        plain_sigma=likelihood.sigma_factor * estimate.sigma,
        values=likelihood.rows @ x,
        covariance=likelihood.rows @ covariance @ likelihood.rows.T,
        widened=likelihood.sigma_factor,
        distance=float(np.linalg.norm(likelihood.whitened_residuals(x))),
    )


def _scaled_eigenvalues(body: Array) -> Array:
    """Dimensionless eigenvalues of a body's pseudo-inertia, ascending, (4,).

    The units are the body's mass and radius of gyration. The result is zero for a massless body.

    Args:
        body: Standard parameters, (10,).
    """
    if not body[0]:
        return np.zeros(4)
    pseudo_inertia = pseudo_inertias(body) / body[0]
    radius = np.sqrt(
        max(
            np.trace(pseudo_inertia[:3, :3])
            - pseudo_inertia[:3, 3] @ pseudo_inertia[:3, 3],
            SMALLEST_POSITIVE,
        )
    )
    units = np.array([radius, radius, radius, 1.0])
    return np.linalg.eigvalsh(pseudo_inertia / np.outer(units, units))


def _active_constraints(
    tree: Tree, program: NonlinearProgram, terms: Sequence[JointTerm], z: Array
) -> Iterator[str]:
    """Yield descriptions of nearly singular bodies and of joint terms at zero.

    A body is nearly singular if Y, its pseudo-inertia relative to that in the file, has an
    eigenvalue below 0.01.

    Args:
        tree: Robot.
        program: Program of consistent bodies.
        terms: Joint terms in the order of x.
        z: Unknowns, (m,).
    """
    for body, Y in zip(program.prior.massive_bodies, program.matrices(z), strict=True):
        if np.linalg.eigvalsh(Y)[0] < MIN_EIGENVALUE:
            yield f"'{tree.joints[body].body}' a possible body"
    for k in (
        program.nonnegative_indices[z[program.nonnegative_indices] < ACTIVE_TOLERANCE]
        - 10 * program.body_count
    ):
        yield f"{terms[k].name(tree)} not negative"


def _diagnostics(
    prior: PriorBodies,
    estimates: Sequence[Estimate],
    used: Sequence[Estimate],
    reconciliations: Sequence[Reconciliation],
    decrement: float,
) -> Iterator[Diagnostic]:
    """Diagnostics of the prior, the estimates and the solution.

    Reported are estimates without a valid covariance; rotor inertias of the file that a torque
    estimate attributes to the bodies; a Newton decrement over 0.1; sigmas widened by a factor over
    3; estimates far from the bodies; negative terms; and terms without a field in model files.

    Args:
        prior: Prior bodies.
        estimates: All estimates.
        used: Estimates with a valid covariance.
        reconciliations: Comparison of each used estimate with the bodies.
        decrement: Newton decrement at the end [sigma].
    """
    yield from prior.diagnostics
    for each in estimates:
        if not any(each is other for other in used):
            subject, unknowns = f"the {each.method} estimate", len(each.names)
            rows = sum(each.samples)
            yield make_diagnostic(
                "bodies.left-out", subject, rows=rows, unknowns=unknowns
            )
    for each in used:
        if each.drives is None or not prior.rotors.any():
            continue
        if not any(term.law == ROTOR for term in each.drives.asked):
            yield make_diagnostic("bodies.rotors", method=each.method)
    if not decrement < MAX_DECREMENT:
        yield make_diagnostic(
            "bodies.not-converged", "the consistent bodies", decrement
        )
    for estimate, reconciliation in zip(used, reconciliations, strict=True):
        if reconciliation.widened > Z_THRESHOLD:
            subject = f"the {estimate.method} estimate"
            yield make_diagnostic(
                "bodies.conflict",
                subject,
                reconciliation.widened,
                method=estimate.method,
            )
        yield from _distance_diagnostics(estimate, reconciliation)
        yield from _negative_term_diagnostics(estimate)
    terms = [term for each in used for term in each.joint_terms]
    if terms_without_field := [t.name for t in terms if t.law.parameter is None]:
        yield make_diagnostic("bodies.no-place", shortened_list(terms_without_field))


def _distance_diagnostics(
    estimate: Estimate, reconciliation: Reconciliation
) -> Iterator[Diagnostic]:
    """Diagnostic of an estimate that differs significantly from the consistent bodies.

    The distance exceeds the 0.9973 quantile of the chi distribution (3 sigma, two-sided). The code
    is "bodies.impossible" if no rigid bodies at all are near the estimate, otherwise "bodies.far".

    Args:
        estimate: Estimate.
        reconciliation: Comparison of the estimate with the bodies.
    """
    limit = float(
        np.sqrt(
            special.chdtri(len(reconciliation.names), 2 * special.ndtr(-Z_THRESHOLD))
        )
    )
    if reconciliation.distance <= limit:
        return
    test = rigid_body_test(estimate, Z_THRESHOLD, 0.0)
    distance, distance_limit = (
        (test.distance, test.limit)
        if test.impossible
        else (reconciliation.distance, limit)
    )
    worst = np.argsort(-np.abs(reconciliation.sigmas))[:3]
    yield make_diagnostic(
        "bodies.impossible" if test.impossible else "bodies.far",
        f"the {estimate.method} estimate",
        distance,
        method=estimate.method,
        limit=distance_limit,
        changes=", ".join(
            f"{reconciliation.names[k]} by {reconciliation.sigmas[k]:+.3g} sigma"
            for k in worst
        ),
    )


def _negative_term_diagnostics(estimate: Estimate) -> Iterator[Diagnostic]:
    """Diagnostics of friction coefficients and rotor inertias more than 3 sigma below zero."""
    for term in estimate.joint_terms:
        is_nonnegative = term.law.dissipative or term.law == ROTOR
        if is_nonnegative and term.value < -Z_THRESHOLD * term.sigma:
            yield make_diagnostic(
                "bodies.negative",
                term.name,
                term.value,
                sigma=term.sigma,
                method=estimate.method,
                unit=term.unit,
            )
