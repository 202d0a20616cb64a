"""Samples of physically consistent robots from the posterior of data and a model file.

The pseudo-inertia of a body is J = U L L' U', where U U' is the pseudo-inertia in the file [RW22].
In the prior, the logarithms of L's diagonal and the elements above the diagonal are independent and
Gaussian; the median of a body's mass is the mass in the file. The likelihood of the data is
Gaussian in the standard parameters, which are linear in Y = L L'. Samples are therefore drawn in
the coordinates of Y, in which the directions that the data determine are straight. The method is
elliptical slice sampling [MAM10] around the consistent bodies, which is exact for any choice of its
Gaussian and has no tuning parameters.

Source    [RW22] for the coordinates, [MAM10] for the sampler.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from testbed.bodies.consistency.consistent import (
    FREE_TERM_WEIGHT,
    consistency_program,
    laplace_covariance,
)
from testbed.bodies.consistency.likelihood import joint_terms_of
from testbed.bodies.consistency.options import ConsistencyOptions
from testbed.bodies.consistency.program import NonlinearProgram, solve_program
from testbed.bodies.prior import PriorBodies
from testbed.core.base.arrays import Array, freeze_arrays
from testbed.core.base.blas import one_blas_thread
from testbed.core.base.codec import schema_with_properties
from testbed.core.base.errors import SettingsError
from testbed.core.base.summary_table import Summarized, SummaryTable, parameter_rows
from testbed.core.estimation.estimate import Estimate
from testbed.core.parameters.pseudo_inertia import matrices_from_coordinates
from testbed.core.parameters.symbols import STANDARD_NAMES, with_standard_parameters
from testbed.core.robot.friction import COULOMB, ROTOR, VISCOUS
from testbed.core.robot.tree import Tree

GAUSSIAN_UPDATES, SLICES = 4, 25
"""Number of updates of the chains' Gaussian, and of slices with each: samples are independent of
the start."""

CHAINS_PER_DIMENSION = 5
"""Smallest number of chains over the number of dimensions."""

BODY_PARAMETER_COUNT = len(STANDARD_NAMES)
"""Number of standard parameters of a body."""

MIN_SIGMAS = 1e-12
"""Smallest value of a non-negative term in standard deviations."""

JOINT_LAWS = (COULOMB, VISCOUS, ROTOR)
"""Laws of joint friction and rotor inertia with fields in model files."""

SAMPLE_NAMES = (*STANDARD_NAMES, *(law.kind for law in JOINT_LAWS))
"""Names of the sampled numbers of a body and its joint."""


@dataclass(frozen=True, eq=False, repr=False)
class RobotSamples(Summarized):
    """Samples of one robot's bodies, friction and rotor inertias.

    Attributes:
        joints: Names of the joints, (n,).
        links: Names of the bodies, (n,).
        names: Names of the 13 numbers of a body and its joint: standard parameters m mx my mz Ixx
            Ixy Iyy Ixz Iyz Izz in the body frame; Coulomb friction, viscous friction and rotor
            inertia of the joint.
        values: The N samples, (N, n, 13) [kg, kg m, kg m^2; N m, N m s/rad, kg m^2 or N, N s/m,
            kg].
        share: Fraction of the prior variance that the data remove, (n, 13): 1 for numbers that the
            data determine, 0 for numbers that the model file determines.
        prior_error: Relative error of the model file's bodies.
    """

    joints: tuple[str, ...]
    links: tuple[str, ...]
    values: Array
    share: Array
    prior_error: float
    names: tuple[str, ...] = SAMPLE_NAMES

    __get_pydantic_core_schema__ = schema_with_properties("mean", "sigma")

    def __post_init__(self) -> None:
        shape = (len(self.joints), len(self.names))
        freeze_arrays(self, values=(len(self.values), *shape), share=shape)

    @property
    def summary(self) -> SummaryTable:
        """Table of the bodies' masses: mean and standard deviation of the samples."""
        masses = parameter_rows(
            self.links, self.mean[:, 0], self.sigma[:, 0], ["kg"] * len(self.links)
        )
        return SummaryTable(f"{len(self.values)} draws of a robot", masses)

    @property
    def mean(self) -> Array:
        """Mean of the samples, (n, 13)."""
        return np.asarray(self.values.mean(axis=0))

    @property
    def sigma(self) -> Array:
        """Standard deviations of the samples, (n, 13)."""
        return np.asarray(self.values.std(axis=0))

    def tree(self, k: int, tree: Tree) -> Tree:
        """Tree with the bodies, friction and rotor inertias of one sample.

        Args:
            k: Index of the sample.
            tree: Robot that provides the geometry and the limits.
        """
        fields, numbers = [str(law.parameter) for law in JOINT_LAWS], self.values[k]
        joints = tuple(
            replace(joint, **dict(zip(fields, losses, strict=True)))
            for joint, losses in zip(
                tree.joints, numbers[:, BODY_PARAMETER_COUNT:].tolist(), strict=True
            )
        )
        return replace(
            with_standard_parameters(tree, numbers[:, :BODY_PARAMETER_COUNT]),
            joints=joints,
        )


def robots(
    tree: Tree,
    estimates: Sequence[Estimate],
    prior: PriorBodies,
    count: int,
    rng: np.random.Generator,
    options: ConsistencyOptions | None = None,
) -> RobotSamples:
    """Sample robots from the posterior of estimates and a model file.

    Friction and rotor inertias that are terms of an estimate are sampled from the posterior
    together with the bodies. Other friction and rotor inertias are sampled log-normally around the
    values in the model file, with the relative error of the prior.

    Args:
        tree: Robot; the friction of its joints is that of the file.
        estimates: Estimates from one recording, one per method.
        prior: Prior bodies and rotors.
        count: Number of samples N.
        rng: Random number generator.
        options: Options; None for `ConsistencyOptions()`.

    Raises:
        SettingsError: As for `consistent`, or `count` is not positive.
        RecordingError: No estimate has a valid covariance.
    """
    options = options or ConsistencyOptions()
    error = options.prior_error
    if count < 1:
        raise SettingsError("robots are drawn one or more")
    with one_blas_thread():
        used, _, program = consistency_program(tree, estimates, prior, options)
        centre, _ = solve_program(program, 1 / error**2)
        z = _sample_unknowns(program, centre, error, count, rng)
        _, share = laplace_covariance(program, centre, 1 / error**2)
    x = z @ program.x_from_z.T
    losses = sample_file_losses(tree, prior, error, count, rng)
    loss_share = np.zeros(losses.shape[1:])
    for k, term in enumerate(joint_terms_of(used), start=BODY_PARAMETER_COUNT * tree.n):
        if term.law in JOINT_LAWS and term.joint < tree.n:
            index = term.joint, JOINT_LAWS.index(term.law)
            losses[(slice(None), *index)], loss_share[index] = x[:, k], share[k]
    bodies = x[:, : BODY_PARAMETER_COUNT * tree.n].reshape(
        count, tree.n, BODY_PARAMETER_COUNT
    )
    body_share = share[: BODY_PARAMETER_COUNT * tree.n].reshape(
        tree.n, BODY_PARAMETER_COUNT
    )
    return RobotSamples(
        joints=tree.names,
        links=tuple(joint.body for joint in tree.joints),
        values=np.concatenate([bodies, losses], axis=-1),
        share=np.hstack([body_share, loss_share]),
        prior_error=error,
    )


def sample_file_losses(
    tree: Tree, prior: PriorBodies, error: float, count: int, rng: np.random.Generator
) -> Array:
    """Log-normal samples of friction and rotor inertias around the model file, (count, n, 3).

    Values that are zero in the file stay zero.

    Args:
        tree: Robot; the friction of its joints is that of the file.
        prior: Prior bodies and rotors.
        error: Standard deviation of the logarithms.
        count: Number of samples.
        rng: Random number generator.
    """
    friction = [law.coefficients(tree) for law in JOINT_LAWS[:2]]
    file = np.stack([*friction, prior.rotors], axis=-1)
    return file * np.exp(error * rng.normal(size=(count, *file.shape)))


def _log_prior(bodies: Array, error: float) -> Array:
    """Log prior density of N samples of the bodies, (N,); -inf for impossible bodies.

    The density refers to the entries of Y = L L', with L upper triangular, and is not normalised.
    The logarithms of L's diagonal are Gaussian with mean zero and sigma error / 2; the other
    entries of L are Gaussian with mean zero and sigma error / sqrt(2).

    Args:
        bodies: Matrices Y of the bodies in each sample, (N, bodies, 4, 4).
        error: Relative error of the prior bodies.
    """
    density, remainder = np.zeros(len(bodies)), bodies
    with np.errstate(invalid="ignore", divide="ignore"):
        for b in reversed(range(4)):
            diagonal = np.sqrt(remainder[..., b, b])
            # to the power b + 1 in |dY / dL|, once more in dL / dlog L
            logs = np.log(diagonal)
            density -= (0.5 * (2 * logs / error) ** 2 + (b + 2) * logs).sum(axis=1)
            column = remainder[..., :b, b] / diagonal[..., None]
            density -= (column**2).sum(axis=(1, 2)) / error**2
            remainder = (
                remainder[..., :b, :b] - column[..., None] * column[..., None, :]
            )
    return np.where(np.isfinite(density), density, -np.inf)


def _sample_unknowns(
    program: NonlinearProgram,
    centre: Array,
    error: float,
    count: int,
    rng: np.random.Generator,
) -> Array:
    """Posterior samples of the m unknowns z within the constraints, (count, m).

    Elliptical slice sampling starts from a Gaussian approximation at the consistent bodies, in
    which each non-negative term is mapped to a truncated Gaussian. There are at least
    `CHAINS_PER_DIMENSION` chains per dimension.

    Args:
        program: Program of consistent bodies.
        centre: Consistent bodies, (m,).
        error: Relative error of the prior bodies.
        count: Number of samples.
        rng: Random number generator.
    """
    weight = 1 / error**2
    hessian = (
        program.normal_matrix
        + weight * program.prior_hessian(centre)
        + FREE_TERM_WEIGHT * np.eye(len(centre))
    )
    cholesky_factor = np.linalg.cholesky(
        program.null_space_basis.T @ hessian @ program.null_space_basis
    )
    # root root' is the Gaussian's covariance
    root = np.linalg.solve(cholesky_factor, program.null_space_basis.T).T
    # mode without the non-negativity constraints
    mean = centre + program.step(centre, weight, 0.0)[0]
    bodies, prior_terms = (
        10 * program.body_count,
        10 * program.body_count + np.flatnonzero(program.has_prior),
    )
    term_sigma, term_mean = (
        np.linalg.norm(root, axis=1)[program.nonnegative_indices],
        mean[program.nonnegative_indices],
    )
    log_mass = special.log_ndtr(term_mean / term_sigma)

    def unknowns(steps: Array) -> tuple[Array, Array]:
        """Unknowns z at given steps, and log Jacobian of the map of non-negative terms, (N,).

        The map transforms the Gaussian of each non-negative term to a Gaussian truncated at zero.
        """
        z = mean + steps @ root.T
        term_z = (z[:, program.nonnegative_indices] - term_mean) / term_sigma
        truncated_z = -special.ndtri_exp(special.log_ndtr(-term_z) + log_mass)
        z[:, program.nonnegative_indices] = np.maximum(
            term_mean + term_sigma * truncated_z, MIN_SIGMAS * term_sigma
        )
        return z, ((truncated_z**2 - term_z**2) / 2 + log_mass).sum(axis=1)

    def density(steps: Array) -> Array:
        """Log density at given steps, (N,); -inf for impossible robots."""
        z, log_density = unknowns(steps)
        log_density -= ((z @ program.rows.T - program.right_hand_side) ** 2).sum(
            axis=1
        ) / 2
        log_density += _log_prior(
            matrices_from_coordinates(z[:, :bodies].reshape(len(z), -1, 10)), error
        )
        logs = np.log(z[:, prior_terms])  # joint terms with a log-normal prior
        log_density -= (logs + 0.5 * (logs / error) ** 2).sum(axis=1)
        return np.where(np.isfinite(log_density), log_density, -np.inf)

    offset = centre - mean
    offset[program.nonnegative_indices] = 0.0
    centre_steps = np.linalg.lstsq(root, offset, rcond=None)[0]
    chains = max(count, CHAINS_PER_DIMENSION * root.shape[1])
    perturbation = rng.normal(size=(chains, root.shape[1]))
    while (is_outside := density(centre_steps + perturbation) == -np.inf).any():
        perturbation[is_outside] /= 2
    steps = centre_steps + perturbation
    for _ in range(GAUSSIAN_UPDATES):
        steps = elliptical_slice_samples(density, steps, SLICES, rng)
    return unknowns(steps[:count])[0]


def elliptical_slice_samples(
    density: Callable[[Array], Array],
    start: Array,
    slices: int,
    rng: np.random.Generator,
) -> Array:
    """Sample a density with many chains of elliptical slice sampling, one sample per chain.

    The ellipses are those of the Gaussian with the mean and covariance of all starting points.

    Args:
        density: Log density at N points in d dimensions, (N, d) -> (N,); -inf outside of the
            support.
        start: Starting points in the support, (N, d); N must be much larger than d.
        slices: Number of slices of each chain.
        rng: Random number generator.
    """
    mean, root = start.mean(axis=0), np.linalg.cholesky(np.cov(start.T))

    def log_ratio(points: Array) -> Array:
        return np.asarray(density(mean + points @ root.T) + (points**2).sum(axis=1) / 2)

    state = np.linalg.solve(root, (start - mean).T).T
    value = log_ratio(state)
    for _ in range(slices):
        directions = np.asarray(rng.normal(size=state.shape))
        threshold = value + np.log(rng.random(len(state)))
        angle = np.asarray(2 * np.pi * rng.random(len(state)))
        low, high = angle - 2 * np.pi, angle.copy()
        next_state, active = state.copy(), np.arange(len(state))
        while len(active):
            active_angle = angle[active, None]
            proposals = state[active] * np.cos(active_angle) + directions[
                active
            ] * np.sin(active_angle)
            proposal_values = log_ratio(proposals)
            is_accepted = proposal_values >= threshold[active]
            next_state[active[is_accepted]], value[active[is_accepted]] = (
                proposals[is_accepted],
                proposal_values[is_accepted],
            )
            active = active[~is_accepted]
            is_negative = angle[active] < 0
            low[active[is_negative]], high[active[~is_negative]] = (
                angle[active[is_negative]],
                angle[active[~is_negative]],
            )
            angle[active] = low[active] + (high - low)[active] * rng.random(len(active))
        state = next_state
    return np.asarray(mean + state @ root.T)
