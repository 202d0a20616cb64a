"""Linearizations of a recording, window by window."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from scipy.ndimage import convolve1d

from testbed.core.base.arrays import Array
from testbed.core.dynamics.force_derivatives import force_derivatives
from testbed.core.dynamics.newton_euler import Motion
from testbed.core.estimation.model_errors.estimates import Sizes
from testbed.core.estimation.model_errors.linearization import Linearization
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.normal_equations import TINY
from testbed.core.estimation.regression.passes import motion_rows, noise_square
from testbed.core.estimation.regression.windows import (
    ROW_ATTENUATION,
    Plan,
    low_pass,
)
from testbed.core.kernel.numpy_engine import motion_of
from testbed.core.kernel.records import Signals
from testbed.core.parameters.symbols import to_barycentric
from testbed.core.robot.shafts import shares
from testbed.sensors.predicted_wrench import RowFilter

LENGTH = 0.2
"""Typical of a body [m]."""

TYPICAL = np.array([1.0, *[LENGTH] * 3, *[LENGTH**2] * 6])
"""Standard parameters of a body beside its mass."""

FINE = 160.0
"""Instants a second at which positions are differentiated, at least: fewer fold noise."""

SIGMAS = 3.0
"""Of the velocities' noise, within which a sense is doubtful."""

CLEAR = 10.0
"""Times the noise's spectrum that a motion's is where it counts."""

SMOOTH = 10.0
"""Cutoff of the filter on the motion of the columns [Hz]."""


@dataclass(frozen=True, eq=False)
class States:
    """Motion around the rows of a window.

    Attributes:
        fine: At close instants.
        smooth: Low-passed, at the instants of the row filter.
        time: Of these, from the middle of the recording, (m,) [s].
        noise: Density of the encoders' white noise, (n,) [rad^2 s or m^2 s].
    """

    fine: Motion
    smooth: Motion
    time: Array
    noise: Array

    @property
    def uncertain(self) -> Array:
        """Speeds below which noise hides the sense of the motion, (n,) [rad/s or m/s]."""
        every = round(float((self.smooth.t[1] - self.smooth.t[0]) / self.fine.t[1]))
        left = self.fine.qd[::every] - self.smooth.qd
        return np.asarray(SIGMAS * np.sqrt((left**2).mean(axis=0)))


@dataclass(frozen=True, eq=False)
class Linearizer:
    """Robot and estimate about which model errors are linear.

    Attributes:
        problem: Robot and recording.
        values: Of the unknowns, (p,).
        plan: The rows.
        filter: From instants to rows.
    """

    problem: Problem
    values: Array
    plan: Plan
    filter: RowFilter

    @cached_property
    def step(self) -> int:
        """Samples from one close instant to the next."""
        rate, stride = self.plan.source.rate, self.filter.stride
        steps = [
            d for d in range(1, stride + 1) if stride % d == 0 and FINE * d <= rate
        ]
        return max(steps, default=1)

    def first_sample(self, row: int) -> int:
        """Sample of the first instant around a row."""
        return row * self.plan.step + self.plan.reach - self.filter.reach

    def states(self, signals: Signals, row: int) -> States:
        """Motion around a window's rows.

        Args:
            signals: The window's.
            row: Number of its first row.
        """
        rate = self.plan.source.rate
        begin = signals.start - self.filter.reach
        span = (signals.number - 1) * signals.step + 2 * self.filter.reach
        fine = motion_of(signals, begin, span // self.step + 1, self.step, rate)
        every = self.filter.stride // self.step
        middle = (self.plan.source.samples - 1) / 2
        time = fine.t[::every] + (self.first_sample(row) - middle) / rate
        if len(signals.velocity):  # sensed, without noise
            return States(fine, fine[::every], time, np.zeros(fine.q.shape[1]))
        noise = _noise_square(signals.position) / rate
        close = rate / self.step
        q = _denoised(fine.q, noise * close)
        weights = low_pass(close, min(SMOOTH, close / 4), ROW_ATTENUATION)
        q = convolve1d(q, weights, axis=0, mode="nearest")
        qd = np.gradient(q, 1 / close, axis=0)
        qdd = np.gradient(qd, 1 / close, axis=0)
        smooth = Motion(*(x[::every] for x in (fine.t, q, qd, qdd)))
        return States(fine, smooth, time, noise)

    def linearization(self, states: States, sizes: Sizes | None) -> Linearization:
        """Predicted forces of a window and their derivatives.

        Args:
            states: The window's.
            sizes: Of the recording; None for those of the window.
        """
        layout, tree = self.problem.layout, self.problem.layout.tree
        frames = not tree.lead and tree.sensor is None
        forces = force_derivatives(
            tree, states.smooth, self._bodies, layout.gravity, frames
        )
        own = self._joint_torques(states.smooth)
        return Linearization(
            tree,
            self.problem.method,
            states.smooth,
            forces,
            own,
            states.time,
            sizes or _sizes(states, forces.wrench, forces.torque + own),
            self.filter,
        )

    def unknowns(self, motion: Motion) -> Array:
        """Columns of the unknowns at instants, (m, C, p).

        Args:
            motion: Of the instants.
        """
        layout = self.plan.layout
        rows = motion_rows(self.plan, motion.q, motion.qd, motion.qdd)
        return layout.combined(rows, layout.basis).transpose(1, 0, 2)

    @cached_property
    def _bodies(self) -> Array:
        """Barycentric parameters, (n, 10), that have the minimal ones and are small else.

        By another frame of a joint, those that no motion shows become sums with others.
        """
        minimal, tree = self.problem.minimal, self.problem.tree
        forms = minimal.standard_matrix * np.tile(TYPICAL, tree.n)
        values = self.values[: minimal.count]
        least = np.linalg.lstsq(forms, values, rcond=None)[0].reshape(tree.n, 10)
        return np.asarray(to_barycentric(tree, TYPICAL * least))

    def _joint_torques(self, motion: Motion) -> Array:
        """Torques of the joints' own terms, (m, n) [N m or N]; not those by other signals."""
        torques, drives = np.zeros_like(motion.q), self.problem.drives
        if drives is None:
            return torques
        turn = shares(self.problem.tree)
        qd, qdd = motion.qd @ turn.T, motion.qdd @ turn.T
        values = self.values[self.problem.minimal.count :]
        for term, value in zip(drives.terms, values, strict=True):
            if not term.law.by:
                column = term.law.columns(qd, qdd)[:, term.joint]
                torques += value * column[:, None] * turn[term.joint]
        return torques


def _noise_square(position: Array) -> Array:
    """Mean square of encoders' white noise, (n,), by differences of positions (M, n)."""
    return np.array([noise_square(column) for column in position.T])


def _denoised(position: Array, noise: Array) -> Array:
    """Positions, (m, n), by Wiener's filter: where their spectrum is noise it is zero.

    Columns of model errors hold accelerations of accelerations; residuals hold the same noise.

    Args:
        position: At close instants.
        noise: Mean square of white noise at that rate, (n,).

    Source    [Wie49]
    """
    m = len(position)
    drift = np.linspace(position[0], position[-1], m)
    odd = np.concatenate([position - drift, -(position - drift)[-2:0:-1]])
    spectrum = np.fft.rfft(odd, axis=0)
    square = np.abs(spectrum) ** 2 / len(odd)
    gain = 1 - noise / np.maximum(square, TINY)
    gain[square < CLEAR * noise] = 0.0
    return np.asarray(np.fft.irfft(gain * spectrum, len(odd), axis=0)[:m] + drift)


def _sizes(states: States, wrench: Array, torque: Array) -> Sizes:
    """Sizes of the signals of a window."""
    motion = states.smooth
    middle = motion.q.mean(axis=0)
    return Sizes(
        torque=_greatest(torque),
        wrench=_greatest(wrench),
        speed=_greatest(motion.qd),
        acceleration=_greatest(motion.qdd),
        range=_greatest(motion.q - middle),
        middle=middle,
        duration=float(np.abs(states.time).max()),
    )


def _greatest(signal: Array) -> Array:
    """Greatest magnitude of each column, at least TINY."""
    return np.asarray(np.maximum(np.abs(signal).max(axis=0), TINY))


def with_sizes(windows: Sequence[Linearization]) -> tuple[Linearization, ...]:
    """Linearizations of windows with the sizes of all.

    Args:
        windows: Of one recording.
    """
    each = [at.sizes for at in windows]
    largest = {
        field.name: np.max([getattr(sizes, field.name) for sizes in each], axis=0)
        for field in fields(Sizes)
    }
    middle = np.mean([sizes.middle for sizes in each], axis=0)
    sizes = Sizes(**{**largest, "middle": middle})
    return tuple(replace(at, sizes=sizes) for at in windows)
