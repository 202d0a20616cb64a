"""Linear models of a log's joint torques for bodies and friction, under any gravity.

Torques are linear in the parameters theta of the bodies and linear in gravity g,

    tau_j = (Y_0 + g_x Y_x + g_y Y_y + g_z Y_z) theta + friction,

where Y are regressors, so the products of the columns for any gravity follow from products that are
computed once. Friction is viscous, dry, Stribeck and load-dependent friction; the torque of the
rotor, an offset, and crosstalk from the torques of neighbouring joints are added.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.blas import eigh
from testbed.core.dynamics.newton_euler import Motion, linear_inverse_dynamics
from testbed.core.estimation.evidence import ChannelProducts, Evidence
from testbed.core.robot.tree import Tree
from testbed.importing.check.body_prior import BodyPrior
from testbed.importing.check.torque_signals import TorqueSignals

LOCAL_MEAN = np.array([0.15, 0.15, 0.03, 0.0, 0.0, 0.0, 0.0, 0.0])
LOCAL_SIGMA = np.array([0.3, 0.3, 0.15, 0.1, 0.1, 0.12, 0.015, 0.015])
"""Prior means and standard deviations of each channel's coefficients: viscous, dry, rotor's,
Stribeck's and constant torque relative to the channel's size; load-dependent friction relative to
the torque; crosstalk from both neighbours' torques."""

SCALED_COEFFICIENTS = 5
"""Number of coefficients relative to the channel's size."""

SPRING_SIGMA = 0.3
"""Prior standard deviation of a spring's torque, relative to the channel's rms."""

FRICTION_LAW_ERROR = 0.05
"""Error of a friction law, relative to the channel's size."""

RANK_TOLERANCE = 1e-10
"""Eigenvalue, relative to the largest, below which parameters are not identifiable."""


class Grams(NamedTuple):
    """Gram matrices of P shared and m local columns for C channels.

    Attributes:
        shared: Products of the columns shared by all channels, (C, P, P).
        cross: Products of shared and local columns, (C, P, m).
        local: Products of the columns that belong to one channel, (C, m, m).
    """

    shared: Array
    cross: Array
    local: Array


@dataclass(frozen=True, eq=False)
class TorqueProducts:
    """Products of regressor columns with each other and with torques, quadratic in gravity.

    There are C channels, T instants, and p columns for each channel: first P columns of the bodies,
    which are shared by all channels, then local columns of friction.

    Attributes:
        columns: Columns of bodies without gravity and of friction, in prior standard deviations,
            (C, T, p).
        gravity_columns: Columns of bodies per unit of gravity along each axis, (C, T, 3, P); for a
            fixed gravity, which is included in `columns`, (C, T, 0, P).
        measured: Torques, (C, T).
        valid: 1 for valid torques, 0 otherwise, (C, T).
        mean: Prior mean of each channel's coefficients, (p,).
        basis: Identifiable directions of the whitened parameters, (10 n, P).
    """

    columns: Array
    gravity_columns: Array
    measured: Array
    valid: Array
    mean: Array
    basis: Array
    _cache: dict[tuple[float, ...], tuple[Grams, Array]] = field(default_factory=dict)

    @property
    def shared_count(self) -> int:
        """Number of columns shared by all channels."""
        return int(self.basis.shape[1])

    @cached_property
    def _gram(self) -> Array:
        """Gram matrices of the columns without gravity, (C, p, p)."""
        return self.columns.transpose(0, 2, 1) @ self.columns

    @cached_property
    def _cross(self) -> Array:
        """Products of columns and gravity columns, (C, p, 3, P)."""
        channels, samples, axes, size = self.gravity_columns.shape
        flat = self.gravity_columns.reshape(channels, samples, axes * size)
        cross = self.columns.transpose(0, 2, 1) @ flat
        return cross.reshape(channels, -1, axes, size)

    @cached_property
    def _gravity_gram(self) -> Array:
        """Gram matrices of the gravity columns, (C, 3, P, 3, P)."""
        channels, samples, axes, size = self.gravity_columns.shape
        flat = self.gravity_columns.reshape(channels, samples, axes * size)
        gram = flat.transpose(0, 2, 1) @ flat
        return gram.reshape(channels, axes, size, axes, size)

    @cached_property
    def valid_count(self) -> Array:
        """Number of valid samples of each channel, (C,)."""
        return np.asarray(self.valid.sum(axis=1))

    def square_sums(self, measured: Array | None = None) -> Array:
        """Sum of squared torques for each channel, (C,) [N^2 m^2 or N^2].

        Args:
            measured: Torques, (C, T); default: the torques of the log.
        """
        torque = self.measured if measured is None else measured
        return np.asarray((self.valid * torque**2).sum(axis=1))

    def products(
        self, gravity: Array, measured: Array | None = None
    ) -> ChannelProducts:
        """Products of columns and of residuals of the prior mean, under a given gravity.

        Args:
            gravity: Gravity, (3,) [m/s^2].
            measured: Torques, (C, T); default: the torques of the log.
        """
        torque = self.valid * (self.measured if measured is None else measured)
        moment, size = (torque[:, None] @ self.columns)[:, 0], self.shared_count
        if self.gravity_columns.shape[2]:
            gravity_moment = np.einsum("ct,ctkp->ckp", torque, self.gravity_columns)
            moment[:, :size] += np.tensordot(gravity_moment, gravity, ([1], [0]))
        grams, expected = self._gravity_products(gravity)
        square = (torque**2).sum(axis=1) - (2 * moment - expected) @ self.mean
        return ChannelProducts(*grams, moment - expected, square, self.valid_count)

    def _gravity_products(self, gravity: Array) -> tuple[Grams, Array]:
        """Gram matrices under a given gravity, and their products with the prior mean, cached."""
        key = tuple(gravity.tolist())
        if key not in self._cache:
            self._cache.clear()  # only the last is kept: the arrays are large
            self._cache[key] = self._computed_gravity_products(gravity)
        return self._cache[key]

    def _computed_gravity_products(self, gravity: Array) -> tuple[Grams, Array]:
        """Gram matrices under a given gravity, and their products with the prior mean."""
        size = self.shared_count
        shared, cross = self._gram[:, :size, :size], self._gram[:, :size, size:]
        if self.gravity_columns.shape[2]:
            mixed = np.tensordot(self._cross, gravity, ([2], [0]))
            quadratic = np.tensordot(self._gravity_gram, gravity, ([1], [0]))
            bodies = mixed[:, :size]
            shared = shared + bodies + bodies.transpose(0, 2, 1)
            shared = shared + np.tensordot(quadratic, gravity, ([2], [0]))
            cross = cross + mixed[:, size:].transpose(0, 2, 1)
        local = self._gram[:, size:, size:]
        grams = Grams(*(np.ascontiguousarray(each) for each in (shared, cross, local)))
        zero = np.zeros((len(local), len(self.mean)))
        products = ChannelProducts(*grams, zero, zero[:, 0], self.valid_count)
        return grams, products.predicted_products(
            np.broadcast_to(self.mean, zero.shape)
        )

    def residual(
        self, gravity: Array, estimate: Evidence, measured: Array | None = None
    ) -> Array:
        """Residual torques at the posterior mean, zero for invalid samples, (C, T).

        Args:
            gravity: Gravity, (3,) [m/s^2].
            estimate: Evidence with these columns.
            measured: Torques, (C, T); default: the torques of the log.
        """
        torque = self.valid * (self.measured if measured is None else measured)
        values = self.mean + estimate.coefficients
        predicted = (self.columns @ values[:, :, None])[:, :, 0]
        if self.gravity_columns.shape[2]:
            slopes = self.gravity_columns @ values[0, : self.shared_count]
            predicted = predicted + slopes @ gravity
        return np.asarray(torque - predicted)

    def gravity_step(
        self, gravity: Array, estimate: Evidence, residual: Array
    ) -> tuple[Array, Array]:
        """Gradient, (3,), and information, (3, 3), of gravity; other coefficients are marginalised.

        Args:
            gravity: Gravity, (3,) [m/s^2].
            estimate: Evidence with these columns under this gravity.
            residual: Residual torques, (C, T).
        """
        bodies = (self.mean + estimate.coefficients)[0, : self.shared_count]
        slopes = self.gravity_columns @ bodies  # (C, T, 3)
        cross = self._cross @ bodies  # (C, p, 3)
        gram = np.tensordot(self._gravity_gram @ bodies, gravity, ([1], [0]))
        cross[:, : self.shared_count] += gram
        moment = (residual[:, None] @ slopes)[:, 0]
        return estimate.additional_gradient(
            cross, slopes.transpose(0, 2, 1) @ slopes, moment
        )


def friction_coefficients(estimate: Evidence) -> tuple[Array, Array]:
    """Viscous and Coulomb friction of an estimate, and standard deviations, (C, 2) each.

    The values are relative to the size of each of the C channels; the standard deviations include
    errors of the friction law.

    Args:
        estimate: Evidence of torques.
    """
    selection = slice(0, 2)
    values = (
        LOCAL_MEAN[selection]
        + LOCAL_SIGMA[selection] * estimate.local_mean[:, selection]
    )
    variance = np.diagonal(estimate.local_covariance, axis1=1, axis2=2)[:, selection]
    return values, np.sqrt(
        LOCAL_SIGMA[selection] ** 2 * variance + FRICTION_LAW_ERROR**2
    )


def torque_products(
    tree: Tree,
    signals: TorqueSignals,
    prior: BodyPrior,
    size: Array,
    gravity: Array | None = None,
    spring_joints: Sequence[int] = (),
) -> TorqueProducts:
    """Products of the regressor columns of joint torques for bodies, friction and springs.

    Args:
        tree: Robot.
        signals: Joint torques and motion of the log.
        prior: Prior of the bodies.
        size: Rms of each channel's torques, (n,) [N m or N].
        gravity: Fixed gravity, (3,) [m/s^2]; None for a free gravity.
        spring_joints: Indices of joints with a spring.
    """
    time = np.arange(float(len(signals.q)))
    motion = Motion(time, signals.q, signals.qd, signals.qdd)
    counted = signals.valid.T.astype(np.float64)
    fixed_gravity = np.zeros(3) if gravity is None else gravity
    inertial = linear_inverse_dynamics(tree, motion, prior.barycentric, fixed_gravity)[
        0
    ].transpose(1, 0, 2)
    gravity_columns = np.zeros((*inertial.shape[:2], 0, inertial.shape[2]))
    if gravity is None:
        gravity_columns = _gravity_columns(tree, signals.q, prior)
    basis = _identifiable_basis([inertial, *np.moveaxis(gravity_columns, 2, 0)])
    inertial, gravity_columns = inertial @ basis, gravity_columns @ basis
    local = _local_columns(tree, signals, size)
    if spring_joints:
        is_sprung = np.isin(np.arange(tree.n), spring_joints)
        springs = (spring_torques(signals, size) * is_sprung).T
        local = np.concatenate([local, springs[..., None]], axis=2)
    columns = np.concatenate([inertial, local], axis=2) * counted[..., None]
    expected = np.zeros(local.shape[2])
    expected[: len(LOCAL_MEAN)] = LOCAL_MEAN / LOCAL_SIGMA
    return TorqueProducts(
        columns,
        gravity_columns * counted[..., None, None],
        signals.torque.T,
        counted,
        np.concatenate([basis.T @ prior.mean, expected]),
        basis,
    )


def spring_torques(signals: TorqueSignals, size: Array) -> Array:
    """Spring torques at one prior standard deviation of stiffness, (T, n) [N m or N].

    They are proportional to the deviation of the position from its mean, with an rms of 30 % of the
    channel's rms, at T instants.

    Args:
        signals: Joint torques and motion of the log.
        size: Rms of each channel's torques, (n,) [N m or N].
    """
    q = signals.q - signals.q.mean(axis=0)
    rms = np.sqrt((q**2).mean(axis=0)) + 1e-12
    return np.asarray(q * SPRING_SIGMA * size / rms)


def _gravity_columns(tree: Tree, q: Array, prior: BodyPrior) -> Array:
    """Torques due to the bodies per unit of gravity along each base axis, (C, T, 3, 10 n)."""
    still = Motion.at_rest(q)
    # gravity acts on masses and first moments alone
    affected = np.flatnonzero(np.abs(prior.barycentric[:, :4]).max(axis=(0, 1)))
    theta = prior.barycentric[..., affected]
    columns = np.zeros((tree.n, len(q), 3, prior.barycentric.shape[2]))
    for k, axis in enumerate(np.eye(3)):
        columns[:, :, k, affected] = linear_inverse_dynamics(tree, still, theta, axis)[
            0
        ].transpose(1, 0, 2)
    return columns


def _identifiable_basis(parts: Sequence[Array]) -> Array:
    """Orthonormal basis of the identifiable parameters, (10 n, P), of dimension P.

    It consists of the eigenvectors of the sum of all Gram matrices whose eigenvalues exceed 1e-10
    times the largest eigenvalue.

    Args:
        parts: Columns of the parameters, (..., 10 n) each.
    """
    width = parts[0].shape[-1]
    flat = [each.reshape(-1, width) for each in parts]
    values, axes = eigh(np.asarray(sum(each.T @ each for each in flat)))
    return np.asarray(axes[:, values > RANK_TOLERANCE * values.max()])


def _local_columns(tree: Tree, signals: TorqueSignals, size: Array) -> Array:
    """Friction, offset and neighbours' torques of each channel, in standard deviations, (C, T, 8).

    The order is that of `LOCAL_SIGMA`: viscous, dry, rotor, Stribeck and constant torque,
    load-dependent friction, torque of the parent joint, torque of the first child joint.
    """
    torque, friction = signals.torque, signals.friction
    neighbours = np.zeros((*torque.shape, 2))
    for k, joint in enumerate(tree.joints):
        if joint.parent >= 0:
            neighbours[:, k, 0] = torque[:, joint.parent]
        for child in tree.children(k)[:1]:
            neighbours[:, k, 1] = torque[:, child]
    load = np.abs(torque)[..., None] * friction[..., 1:2]
    constant = np.ones((*torque.shape, 1))
    columns = (
        np.concatenate([friction, constant, load, neighbours], axis=2) * LOCAL_SIGMA
    )
    columns[..., :SCALED_COEFFICIENTS] *= size[:, None]
    return np.asarray(columns.transpose(1, 0, 2))
