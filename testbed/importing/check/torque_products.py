"""Torques of a log as linear models of bodies and friction, whatever gravity is.

Torques are linear in bodies' parameters and linear in gravity,

    tau_j = (Y_0 + g_x Y_x + g_y Y_y + g_z Y_z) theta + friction,

so that the products of columns for any gravity follow from products made once. Friction is
viscous, dry, Stribeck's and of the load, beside a rotor, an offset, and the neighbours' torques,
which a torque sensor feels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.blas import eigh
from testbed.core.dynamics.newton_euler import Motion, linear
from testbed.core.estimation.evidence import ChannelProducts, Evidence
from testbed.core.robot.tree import Tree
from testbed.importing.check.body_prior import BodyPrior
from testbed.importing.check.torque_signals import TorqueSignals

MEAN = np.array([0.15, 0.15, 0.03, 0.0, 0.0, 0.0, 0.0, 0.0])
SIGMA = np.array([0.3, 0.3, 0.15, 0.1, 0.1, 0.12, 0.015, 0.015])
"""Viscous, dry, rotor's, Stribeck's and constant torque in parts of the channel's size; friction by
the load in parts of the torque, and parts of both neighbours' torques."""

SCALED = 5
"""Number of these that are in parts of the channel's size."""

SPRING = 0.3
"""Sigma of the torque of a spring in parts of the channel's rms."""

LAW = 0.05
"""Error of a friction law in parts of the channel's size."""

DEPENDENT = 1e-10
"""Part of the largest eigenvalue below which parameters move no torque."""


class Grams(NamedTuple):
    """Gram matrices of shared columns, of shared with local, and of local columns."""

    shared: Array
    cross: Array
    local: Array


@dataclass(frozen=True, eq=False)
class TorqueProducts:
    """Products of the columns of torques and of measurements, quadratic in gravity.

    Attributes:
        columns: On bodies without gravity and friction, in sigmas of the prior, (C, T, p).
        gravity_columns: On bodies per unit of gravity along each axis, (C, T, 3, P), or (C, T, 0,
            P) where gravity is in the columns.
        measured: Torques, (C, T).
        counted: Whether a torque counts, 1 or 0, (C, T).
        mean: Prior mean of each channel's coefficients, (p,).
        basis: Prior's coordinates by those of the columns, (10 n, P).
    """

    columns: Array
    gravity_columns: Array
    measured: Array
    counted: Array
    mean: Array
    basis: Array
    _known: dict[tuple[float, ...], tuple[Grams, Array]] = field(default_factory=dict)

    @property
    def shared(self) -> int:
        """Number of columns that all channels share."""
        return int(self.basis.shape[1])

    @cached_property
    def _gram(self) -> Array:
        return self.columns.transpose(0, 2, 1) @ self.columns

    @cached_property
    def _cross(self) -> Array:
        """Products of columns and gravity's columns, (C, p, 3, P)."""
        channels, samples, axes, size = self.gravity_columns.shape
        flat = self.gravity_columns.reshape(channels, samples, axes * size)
        cross = self.columns.transpose(0, 2, 1) @ flat
        return cross.reshape(channels, -1, axes, size)

    @cached_property
    def _gravity_gram(self) -> Array:
        """Products of gravity's columns, (C, 3, P, 3, P)."""
        channels, samples, axes, size = self.gravity_columns.shape
        flat = self.gravity_columns.reshape(channels, samples, axes * size)
        gram = flat.transpose(0, 2, 1) @ flat
        return gram.reshape(channels, axes, size, axes, size)

    @cached_property
    def count(self) -> Array:
        """Numbers of valid samples per channel, (C,)."""
        return np.asarray(self.counted.sum(axis=1))

    def whole(self, measured: Array | None = None) -> Array:
        """Sums of squared torques per channel, (C,) [N^2 m^2 or N^2].

        Args:
            measured: Other torques, (C, T).
        """
        torque = self.measured if measured is None else measured
        return np.asarray((self.counted * torque**2).sum(axis=1))

    def products(
        self, gravity: Array, measured: Array | None = None
    ) -> ChannelProducts:
        """Column products about the prior mean, under a given gravity.

        Args:
            gravity: (3,) [m/s^2].
            measured: Other torques, (C, T).
        """
        torque = self.counted * (self.measured if measured is None else measured)
        moment, size = (torque[:, None] @ self.columns)[:, 0], self.shared
        if self.gravity_columns.shape[2]:
            heavy = np.einsum("ct,ctkp->ckp", torque, self.gravity_columns)
            moment[:, :size] += np.tensordot(heavy, gravity, ([1], [0]))
        grams, expected = self._under(gravity)
        square = (torque**2).sum(axis=1) - (2 * moment - expected) @ self.mean
        return ChannelProducts(*grams, moment - expected, square, self.count)

    def _under(self, gravity: Array) -> tuple[Grams, Array]:
        """Gram matrices under a gravity, and their products with the prior mean."""
        key = tuple(gravity.tolist())
        if key not in self._known:
            self._known.clear()  # the last alone: they are large
            self._known[key] = self._made(gravity)
        return self._known[key]

    def _made(self, gravity: Array) -> tuple[Grams, Array]:
        size = self.shared
        shared, cross = self._gram[:, :size, :size], self._gram[:, :size, size:]
        if self.gravity_columns.shape[2]:
            mixed = np.tensordot(self._cross, gravity, ([2], [0]))
            both = np.tensordot(self._gravity_gram, gravity, ([1], [0]))
            bodies = mixed[:, :size]
            shared = shared + bodies + bodies.transpose(0, 2, 1)
            shared = shared + np.tensordot(both, gravity, ([2], [0]))
            cross = cross + mixed[:, size:].transpose(0, 2, 1)
        local = self._gram[:, size:, size:]
        grams = Grams(*(np.ascontiguousarray(each) for each in (shared, cross, local)))
        none = np.zeros((len(local), len(self.mean)))
        whole = ChannelProducts(*grams, none, none[:, 0], self.count)
        return grams, whole.times(np.broadcast_to(self.mean, none.shape))

    def residual(
        self, gravity: Array, estimate: Evidence, measured: Array | None = None
    ) -> Array:
        """Residual torques at the posterior mean, zero where none count, (C, T).

        Args:
            gravity: (3,) [m/s^2].
            estimate: Evidence of these columns.
            measured: Other torques, (C, T).
        """
        torque = self.counted * (self.measured if measured is None else measured)
        values = self.mean + estimate.coefficients
        predicted = (self.columns @ values[:, :, None])[:, :, 0]
        if self.gravity_columns.shape[2]:
            slopes = self.gravity_columns @ values[0, : self.shared]
            predicted = predicted + slopes @ gravity
        return np.asarray(torque - predicted)

    def gravity_step(
        self, gravity: Array, estimate: Evidence, residual: Array
    ) -> tuple[Array, Array]:
        """Gradient, (3,), and information, (3, 3), of gravity, other coefficients marginalised.

        Args:
            gravity: (3,) [m/s^2].
            estimate: Evidence of these columns under it.
            residual: As of `residual`, (C, T).
        """
        bodies = (self.mean + estimate.coefficients)[0, : self.shared]
        slopes = self.gravity_columns @ bodies  # (C, T, 3)
        cross = self._cross @ bodies  # (C, p, 3)
        gram = np.tensordot(self._gravity_gram @ bodies, gravity, ([1], [0]))
        cross[:, : self.shared] += gram
        moment = (residual[:, None] @ slopes)[:, 0]
        return estimate.marginal(cross, slopes.transpose(0, 2, 1) @ slopes, moment)


def friction(estimate: Evidence) -> tuple[Array, Array]:
    """Viscous and Coulomb friction of an estimate, and standard deviations, (C, 2) each.

    In parts of each channel's size; errors of the friction law are counted in.

    Args:
        estimate: Evidence of torques.
    """
    both = slice(0, 2)
    values = MEAN[both] + SIGMA[both] * estimate.local[:, both]
    variance = np.diagonal(estimate.local_covariance, axis1=1, axis2=2)[:, both]
    return values, np.sqrt(SIGMA[both] ** 2 * variance + LAW**2)


def torque_products(
    tree: Tree,
    signals: TorqueSignals,
    prior: BodyPrior,
    size: Array,
    gravity: Array | None = None,
    sprung: Sequence[int] = (),
) -> TorqueProducts:
    """Column products of joint torques on bodies, friction and springs.

    Args:
        tree: The robot.
        signals: Of its joints.
        prior: Of its bodies.
        size: Of each channel's torques, (n,) [N m or N].
        gravity: (3,) [m/s^2], where it is not open.
        sprung: Indices of joints with a torque in proportion to their position.
    """
    time = np.arange(float(len(signals.q)))
    motion = Motion(time, signals.q, signals.qd, signals.qdd)
    counted = signals.counted.T.astype(np.float64)
    fixed = np.zeros(3) if gravity is None else gravity
    inertial = linear(tree, motion, prior.barycentric, fixed)[0].transpose(1, 0, 2)
    heavy = np.zeros((*inertial.shape[:2], 0, inertial.shape[2]))
    if gravity is None:
        heavy = _gravity_columns(tree, signals.q, prior)
    basis = _basis([inertial, *np.moveaxis(heavy, 2, 0)])
    inertial, heavy = inertial @ basis, heavy @ basis
    local = _local_columns(tree, signals, size)
    if sprung:
        at = np.isin(np.arange(tree.n), sprung)
        springs = (spring_torques(signals, size) * at).T
        local = np.concatenate([local, springs[..., None]], axis=2)
    columns = np.concatenate([inertial, local], axis=2) * counted[..., None]
    expected = np.zeros(local.shape[2])
    expected[: len(MEAN)] = MEAN / SIGMA
    return TorqueProducts(
        columns,
        heavy * counted[..., None, None],
        signals.torque.T,
        counted,
        np.concatenate([basis.T @ prior.mean, expected]),
        basis,
    )


def spring_torques(signals: TorqueSignals, size: Array) -> Array:
    """Spring torques at one prior standard deviation of stiffness, (T, n) [N m or N].

    Args:
        signals: Of the joints.
        size: Of each channel's torques, (n,).
    """
    q = signals.q - signals.q.mean(axis=0)
    rms = np.sqrt((q**2).mean(axis=0)) + 1e-12
    return np.asarray(q * SPRING * size / rms)


def _gravity_columns(tree: Tree, q: Array, prior: BodyPrior) -> Array:
    """Torques on bodies per unit of gravity along each axis, (C, T, 3, 10 n)."""
    still = Motion.at_rest(q)
    # gravity meets masses and first moments alone
    meets = np.flatnonzero(np.abs(prior.barycentric[:, :4]).max(axis=(0, 1)))
    theta = prior.barycentric[..., meets]
    columns = np.zeros((tree.n, len(q), 3, prior.barycentric.shape[2]))
    for k, axis in enumerate(np.eye(3)):
        columns[:, :, k, meets] = linear(tree, still, theta, axis)[0].transpose(1, 0, 2)
    return columns


def _basis(parts: Sequence[Array]) -> Array:
    """Orthonormal basis of the identifiable parameters, (10 n, P)."""
    width = parts[0].shape[-1]
    flat = [each.reshape(-1, width) for each in parts]
    values, axes = eigh(np.asarray(sum(each.T @ each for each in flat)))
    return np.asarray(axes[:, values > DEPENDENT * values.max()])


def _local_columns(tree: Tree, signals: TorqueSignals, size: Array) -> Array:
    """Friction, offset and neighbours' torques of each channel, in sigmas, (C, T, 8)."""
    torque, friction = signals.torque, signals.friction
    beside = np.zeros((*torque.shape, 2))
    for k, joint in enumerate(tree.joints):
        if joint.parent >= 0:
            beside[:, k, 0] = torque[:, joint.parent]
        for child in tree.children(k)[:1]:
            beside[:, k, 1] = torque[:, child]
    load = np.abs(torque)[..., None] * friction[..., 1:2]
    constant = np.ones((*torque.shape, 1))
    columns = np.concatenate([friction, constant, load, beside], axis=2) * SIGMA
    columns[..., :SCALED] *= size[:, None]
    return np.asarray(columns.transpose(1, 0, 2))
