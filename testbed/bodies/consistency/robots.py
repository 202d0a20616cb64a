"""Robots drawn from what data and a model file say together; each of them can exist.

A body's pseudo-inertia is J = U L L' U' with that of the file U U' [RW22]. Before the data, the
logarithms of L's diagonal and the numbers above it are independent and Gaussian: the body's mass
has the file's as its median. The data are Gaussian in standard parameters, which are linear in
Y = L L'. So all is drawn in the coordinates of Y, where the data's narrow directions are straight:
from the Gaussian around the consistent bodies by elliptical slice sampling [MAM10], which is exact
whatever that Gaussian is, and has nothing to set.

Source    [RW22] for the coordinates, [MAM10] for the sampler.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from testbed.bodies.consistency.consistent import FAINT, problem_of, spread_at
from testbed.bodies.consistency.likelihood import terms_of
from testbed.bodies.consistency.options import ConsistencyOptions
from testbed.bodies.consistency.program import NonlinearProgram, solve
from testbed.bodies.prior import Prior
from testbed.core.base.arrays import Array, freeze
from testbed.core.base.blas import one_blas_thread
from testbed.core.base.codec import with_properties
from testbed.core.base.errors import SettingsError
from testbed.core.base.summary_table import Summarized, SummaryTable, parameter_rows
from testbed.core.estimation.estimate import Estimate
from testbed.core.parameters.pseudo_inertia import of_coordinates
from testbed.core.parameters.symbols import STANDARD, with_standard
from testbed.core.robot.friction import COULOMB, ROTOR, VISCOUS
from testbed.core.robot.tree import Tree

STAGES, ROUNDS = 4, 25
"""How often the chains' Gaussian is taken anew, and slices with each: a draw does not remember
where it began."""

CHAINS = 5
"""Least number of chains, in dimensions."""

BODY = len(STANDARD)
"""Numbers of a body."""

TINY = 1e-12
"""Sigmas that are zero, of what cannot be negative."""

LOSSES = (COULOMB, VISCOUS, ROTOR)
"""Of a joint: what model files have a place for."""

NAMES = (*STANDARD, *(law.kind for law in LOSSES))
"""Of what is drawn of a body and its joint."""


@dataclass(frozen=True, eq=False, repr=False)
class Robots(Summarized):
    """Draws of one robot.

    Attributes:
        joints: The joints' names, (n,).
        links: The bodies' names, (n,).
        names: Of the thirteen: a body's standard parameters and its joint's losses.
        values: Of all draws, (N, n, 13) [kg, kg m, kg m^2; N m, N m s/rad, kg m^2 or N, N s/m, kg].
        share: Part of the prior's variance of each that the data take away, (n, 13): 1 is the
            data's, 0 the model file's.
        prior_error: Of the model file, in parts of itself.
    """

    joints: tuple[str, ...]
    links: tuple[str, ...]
    values: Array
    share: Array
    prior_error: float
    names: tuple[str, ...] = NAMES

    __get_pydantic_core_schema__ = with_properties("mean", "sigma")

    def __post_init__(self) -> None:
        one = (len(self.joints), len(self.names))
        freeze(self, values=(len(self.values), *one), share=one)

    @property
    def summary(self) -> SummaryTable:
        """Mass of every body: mean and standard deviation of the draws."""
        masses = parameter_rows(
            self.links, self.mean[:, 0], self.sigma[:, 0], ["kg"] * len(self.links)
        )
        return SummaryTable(f"{len(self.values)} draws of a robot", masses)

    @property
    def mean(self) -> Array:
        """Of the draws, (n, 13)."""
        return np.asarray(self.values.mean(axis=0))

    @property
    def sigma(self) -> Array:
        """Standard deviations of the draws, (n, 13)."""
        return np.asarray(self.values.std(axis=0))

    def tree(self, k: int, tree: Tree) -> Tree:
        """One of them.

        Args:
            k: Its number.
            tree: The robot; geometry and limits are its.
        """
        fields, own = [str(law.parameter) for law in LOSSES], self.values[k]
        joints = tuple(
            replace(joint, **dict(zip(fields, losses, strict=True)))
            for joint, losses in zip(tree.joints, own[:, BODY:].tolist(), strict=True)
        )
        return replace(with_standard(tree, own[:, :BODY]), joints=joints)


def robots(
    tree: Tree,
    estimates: Sequence[Estimate],
    prior: Prior,
    count: int,
    rng: np.random.Generator,
    options: ConsistencyOptions | None = None,
) -> Robots:
    """Robots that could be the one that was measured.

    A joint's friction and rotor inertia that are among an estimate's terms are the data's; the
    others are the file's, wrong by the prior's error.

    Args:
        tree: The robot; friction that its joints state is the file's.
        estimates: Of one recording, one a method.
        prior: Bodies and rotors before the data.
        count: How many.
        rng: Draws the numbers.
        options: What is asked besides; default `ConsistencyOptions()`.

    Raises:
        SettingsError: As `consistent`; or `count` is not positive.
        RecordingError: There is no estimate whose covariance is one.
    """
    options = options or ConsistencyOptions()
    error = options.prior_error
    if count < 1:
        raise SettingsError("robots are drawn one or more")
    with one_blas_thread():
        used, _, program = problem_of(tree, estimates, prior, options)
        centre, _ = solve(program, 1 / error**2)
        z = _draws(program, centre, error, count, rng)
        _, share = spread_at(program, centre, 1 / error**2)
    x = z @ program.lead.T
    losses = losses_of_file(tree, prior, error, count, rng)
    loss_share = np.zeros(losses.shape[1:])
    for k, term in enumerate(terms_of(used), start=BODY * tree.n):
        if term.law in LOSSES and term.joint < tree.n:
            place = term.joint, LOSSES.index(term.law)
            losses[(slice(None), *place)], loss_share[place] = x[:, k], share[k]
    bodies = x[:, : BODY * tree.n].reshape(count, tree.n, BODY)
    body_share = share[: BODY * tree.n].reshape(tree.n, BODY)
    return Robots(
        joints=tree.names,
        links=tuple(joint.body for joint in tree.joints),
        values=np.concatenate([bodies, losses], axis=-1),
        share=np.hstack([body_share, loss_share]),
        prior_error=error,
    )


def losses_of_file(
    tree: Tree, prior: Prior, error: float, count: int, rng: np.random.Generator
) -> Array:
    """LOSSES as the file has them, (count, n, 3): logarithms are Gaussian, nothing stays nothing.

    Arguments are those of `robots`, and the file's error.
    """
    stated = [law.coefficients(tree) for law in LOSSES[:2]]
    file = np.stack([*stated, prior.rotors], axis=-1)
    return file * np.exp(error * rng.normal(size=(count, *file.shape)))


def _log_prior(bodies: Array, error: float) -> Array:
    """Logarithm of the density of bodies' coordinates, (N,); minus infinity where none is one.

    Args:
        bodies: Y, (N, bodies, 4, 4).
        error: Of the file's bodies.
    """
    density, rest = np.zeros(len(bodies)), bodies
    with np.errstate(invalid="ignore", divide="ignore"):
        for b in reversed(range(4)):
            size = np.sqrt(rest[..., b, b])
            # to the power b + 1 in |dY / dL|, once more in dL / dlog L
            logs = np.log(size)
            density -= (0.5 * (2 * logs / error) ** 2 + (b + 2) * logs).sum(axis=1)
            column = rest[..., :b, b] / size[..., None]
            density -= (column**2).sum(axis=(1, 2)) / error**2
            rest = rest[..., :b, :b] - column[..., None] * column[..., None, :]
    return np.where(np.isfinite(density), density, -np.inf)


def _draws(
    program: NonlinearProgram,
    centre: Array,
    error: float,
    count: int,
    rng: np.random.Generator,
) -> Array:
    """Unknowns z, (count, m), by data, prior and conditions together.

    Args:
        program: In numbers near one.
        centre: The consistent bodies, (m,).
        error: Of the file's bodies.
        count: How many.
        rng: Draws the numbers.
    """
    weight = 1 / error**2
    hessian = (
        program.square
        + weight * program.prior_hessian(centre)
        + FAINT * np.eye(len(centre))
    )
    inner = np.linalg.cholesky(program.free.T @ hessian @ program.free)
    # root root' is the Gaussian's covariance
    root = np.linalg.solve(inner, program.free.T).T
    # where terms at their limits would be without
    mean = centre + program.step(centre, weight, 0.0)[0]
    bodies, own = 10 * program.bodies, 10 * program.bodies + np.flatnonzero(program.own)
    size, most = np.linalg.norm(root, axis=1)[program.positive], mean[program.positive]
    above = special.log_ndtr(most / size)

    def unknowns(steps: Array) -> tuple[Array, Array]:
        """z, and the logarithm of how a step stretches what cannot be negative, (N,).

        To such a term alone the Gaussian becomes itself without its part below zero.
        """
        z = mean + steps @ root.T
        plain = (z[:, program.positive] - most) / size
        kept = -special.ndtri_exp(special.log_ndtr(-plain) + above)
        z[:, program.positive] = np.maximum(most + size * kept, TINY * size)
        return z, ((kept**2 - plain**2) / 2 + above).sum(axis=1)

    def density(steps: Array) -> Array:
        """Its logarithm, (N,); minus infinity where there are no such robots."""
        z, found = unknowns(steps)
        found -= ((z @ program.rows.T - program.right) ** 2).sum(axis=1) / 2
        found += _log_prior(
            of_coordinates(z[:, :bodies].reshape(len(z), -1, 10)), error
        )
        logs = np.log(z[:, own])  # of what the file states of the joints
        found -= (logs + 0.5 * (logs / error) ** 2).sum(axis=1)
        return np.where(np.isfinite(found), found, -np.inf)

    move = centre - mean
    move[program.positive] = 0.0
    inside = np.linalg.lstsq(root, move, rcond=None)[0]
    chains = max(count, CHAINS * root.shape[1])
    away = rng.normal(size=(chains, root.shape[1]))
    while (outside := density(inside + away) == -np.inf).any():
        away[outside] /= 2
    steps = inside + away
    for _ in range(STAGES):
        steps = elliptical_slices(density, steps, ROUNDS, rng)
    return unknowns(steps[:count])[0]


def elliptical_slices(
    density: Callable[[Array], Array],
    start: Array,
    rounds: int,
    rng: np.random.Generator,
) -> Array:
    """Draws of a density, each by a chain of its own, on ellipses of the Gaussian of all of them.

    Args:
        density: Its logarithm at points, (N, d) -> (N,); minus infinity outside.
        start: Inside, (N, d), many more than dimensions.
        rounds: Slices of each chain.
        rng: Draws the numbers.
    """
    mean, root = start.mean(axis=0), np.linalg.cholesky(np.cov(start.T))

    def advantage(points: Array) -> Array:
        return np.asarray(density(mean + points @ root.T) + (points**2).sum(axis=1) / 2)

    here = np.linalg.solve(root, (start - mean).T).T
    value = advantage(here)
    for _ in range(rounds):
        other = np.asarray(rng.normal(size=here.shape))
        height = value + np.log(rng.random(len(here)))
        angle = np.asarray(2 * np.pi * rng.random(len(here)))
        low, high = angle - 2 * np.pi, angle.copy()
        now, left = here.copy(), np.arange(len(here))
        while len(left):
            turn = angle[left, None]
            there = here[left] * np.cos(turn) + other[left] * np.sin(turn)
            found = advantage(there)
            taken = found >= height[left]
            now[left[taken]], value[left[taken]] = there[taken], found[taken]
            left = left[~taken]
            below = angle[left] < 0
            low[left[below]], high[left[~below]] = (
                angle[left[below]],
                angle[left[~below]],
            )
            angle[left] = low[left] + (high - low)[left] * rng.random(len(left))
        here = now
    return np.asarray(mean + here @ root.T)
