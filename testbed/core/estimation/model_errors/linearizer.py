"""Linearisation of a recording about an estimate, window by window."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from scipy.ndimage import convolve1d

from testbed.core.base.arrays import Array
from testbed.core.dynamics.force_derivatives import force_derivatives
from testbed.core.dynamics.newton_euler import Motion
from testbed.core.estimation.model_errors.estimates import SignalSizes
from testbed.core.estimation.model_errors.linearization import Linearization
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.normal_equations import SMALLEST_POSITIVE
from testbed.core.estimation.regression.passes import motion_rows, noise_variance
from testbed.core.estimation.regression.windows import ROW_ATTENUATION, Plan, low_pass
from testbed.core.kernel.numpy_engine import window_motion
from testbed.core.kernel.records import SignalWindow
from testbed.core.parameters.symbols import barycentric_from_standard
from testbed.core.robot.shafts import transmission_matrix
from testbed.sensors.predicted_wrench import RowFilter

TYPICAL_LENGTH = 0.2
"""Typical length of a body [m]."""

TYPICAL_BODY = np.array([1.0, *[TYPICAL_LENGTH] * 3, *[TYPICAL_LENGTH**2] * 6])
"""Typical standard parameters of a body of mass one."""

MIN_FINE_RATE = 160.0
"""Smallest rate of the instants at which positions are differentiated [Hz], against aliasing."""

VELOCITY_SIGMAS = 3.0
"""Multiple of the velocity noise's sigma below which the sign of a velocity is uncertain."""

MIN_SPECTRAL_RATIO = 10.0
"""Smallest ratio of the position's spectrum to the noise's at which it is kept."""

SMOOTHING_CUTOFF = 10.0
"""Cutoff of the low-pass filter on the motion in the columns [Hz]."""


@dataclass(frozen=True, eq=False)
class WindowStates:
    """Motion around the rows of a window.

    Attributes:
        fine: Motion at closely spaced instants, at a rate of at least MIN_FINE_RATE.
        smooth: Low-passed motion at the m instants of the row filter.
        time: Time of the smooth motion from the middle of the recording, (m,) [s].
        noise: Spectral density of the encoders' white noise, (n,) [rad^2 s or m^2 s].
    """

    fine: Motion
    smooth: Motion
    time: Array
    noise: Array

    @property
    def speed_threshold(self) -> Array:
        """Speeds below which noise hides the sign of the velocity, (n,) [rad/s or m/s].

        The threshold is VELOCITY_SIGMAS times the rms difference of fine and smooth velocity.
        """
        stride = round(float((self.smooth.t[1] - self.smooth.t[0]) / self.fine.t[1]))
        residual = self.fine.qd[::stride] - self.smooth.qd
        return np.asarray(VELOCITY_SIGMAS * np.sqrt((residual**2).mean(axis=0)))


@dataclass(frozen=True, eq=False)
class Linearizer:
    """Robot, recording and estimate about which model errors are linearised.

    Attributes:
        problem: Robot and recording.
        values: Unknowns, (p,).
        plan: Plan of the rows.
        filter: Filter from instants to rows.
    """

    problem: Problem
    values: Array
    plan: Plan
    filter: RowFilter

    @cached_property
    def fine_step(self) -> int:
        """Number of samples between instants of the fine motion.

        It is the largest divisor of the row filter's stride with a rate of at least MIN_FINE_RATE;
        1 without such a divisor.
        """
        rate, stride = self.plan.source.rate, self.filter.stride
        steps = [
            d
            for d in range(1, stride + 1)
            if stride % d == 0 and MIN_FINE_RATE * d <= rate
        ]
        return max(steps, default=1)

    def first_sample(self, row: int) -> int:
        """Index of the first sample that the filter of a row uses."""
        return row * self.plan.step + self.plan.reach - self.filter.half_width

    def states(self, signals: SignalWindow, row: int) -> WindowStates:
        """Fine and smooth motion around a window's rows.

        Smooth positions result from a Wiener filter and a low-pass at SMOOTHING_CUTOFF; velocities
        and accelerations are their finite differences. Sensed velocities are taken as noise-free,
        in which case the smooth motion is the fine motion.

        Args:
            signals: Signals of the window.
            row: Index of the window's first row.
        """
        rate = self.plan.source.rate
        begin = signals.start - self.filter.half_width
        span = (signals.row_count - 1) * signals.step + 2 * self.filter.half_width
        fine = window_motion(
            signals, begin, span // self.fine_step + 1, self.fine_step, rate
        )
        stride = self.filter.stride // self.fine_step
        middle = (self.plan.source.samples - 1) / 2
        time = fine.t[::stride] + (self.first_sample(row) - middle) / rate
        if len(signals.velocity):  # velocities are sensed, without noise
            return WindowStates(fine, fine[::stride], time, np.zeros(fine.q.shape[1]))
        noise = _noise_variances(signals.position) / rate
        fine_rate = rate / self.fine_step
        q = _wiener_filtered(fine.q, noise * fine_rate)
        weights = low_pass(
            fine_rate, min(SMOOTHING_CUTOFF, fine_rate / 4), ROW_ATTENUATION
        )
        q = convolve1d(q, weights, axis=0, mode="nearest")
        qd = np.gradient(q, 1 / fine_rate, axis=0)
        qdd = np.gradient(qd, 1 / fine_rate, axis=0)
        smooth = Motion(*(x[::stride] for x in (fine.t, q, qd, qdd)))
        return WindowStates(fine, smooth, time, noise)

    def linearization(
        self, states: WindowStates, sizes: SignalSizes | None
    ) -> Linearization:
        """Predicted forces of a window and their derivatives.

        Derivatives with respect to joint frames and base are included for a fixed base without a
        force sensor in the robot.

        Args:
            states: Motion of the window.
            sizes: Signal magnitudes of the recording; None for those of the window.
        """
        layout, tree = self.problem.layout, self.problem.layout.tree
        frames = not tree.lead and tree.sensor is None
        forces = force_derivatives(
            tree, states.smooth, self._barycentric_parameters, layout.gravity, frames
        )
        joint_torque = self._joint_torques(states.smooth)
        return Linearization(
            tree,
            self.problem.method,
            states.smooth,
            forces,
            joint_torque,
            states.time,
            sizes or _signal_sizes(states, forces.wrench, forces.torque + joint_torque),
            self.filter,
        )

    def unknown_columns(self, motion: Motion) -> Array:
        """Regressor columns of the unknowns at the instants of a motion, (m, C, p).

        Args:
            motion: Motion at m instants.
        """
        layout = self.plan.layout
        rows = motion_rows(self.plan, motion.q, motion.qd, motion.qdd)
        return layout.combine_columns(rows, layout.basis).transpose(1, 0, 2)

    @cached_property
    def _barycentric_parameters(self) -> Array:
        """Minimum-norm barycentric parameters for the estimated minimal parameters, (n, 10).

        The norm is that of the standard parameters relative to TYPICAL_BODY. Minimising it keeps
        unidentifiable parameters small, which enter the derivatives with respect to joint frames.
        """
        minimal, tree = self.problem.minimal, self.problem.tree
        forms = minimal.standard_matrix * np.tile(TYPICAL_BODY, tree.n)
        values = self.values[: minimal.count]
        relative = np.linalg.lstsq(forms, values, rcond=None)[0].reshape(tree.n, 10)
        return np.asarray(barycentric_from_standard(tree, TYPICAL_BODY * relative))

    def _joint_torques(self, motion: Motion) -> Array:
        """Torques of the joint terms along a motion, (m, n) [N m or N]; zero without joint terms.

        Terms that depend on other signals, such as temperature or load, are left out.
        """
        torques, drives = np.zeros_like(motion.q), self.problem.drives
        if drives is None:
            return torques
        turn = transmission_matrix(self.problem.tree)
        qd, qdd = motion.qd @ turn.T, motion.qdd @ turn.T
        values = self.values[self.problem.minimal.count :]
        for term, value in zip(drives.terms, values, strict=True):
            if not term.law.by:
                column = term.law.columns(qd, qdd)[:, term.joint]
                torques += value * column[:, None] * turn[term.joint]
        return torques


def _noise_variances(position: Array) -> Array:
    """Variance of each encoder's white noise, from differences of positions, (n,).

    Args:
        position: Positions, (M, n) [rad or m].
    """
    return np.array([noise_variance(column) for column in position.T])


def _wiener_filtered(position: Array, noise: Array) -> Array:
    """Positions after a Wiener filter, without frequencies dominated by noise, (m, n).

    Frequencies with less than MIN_SPECTRAL_RATIO times the power of the noise are removed, since
    noise in differentiated positions would correlate columns of model errors with the residuals.

    Args:
        position: Positions at closely spaced instants, (m, n) [rad or m].
        noise: Variance of white noise at that rate, (n,).

    Source    [Wie49]
    """
    m = len(position)
    drift = np.linspace(position[0], position[-1], m)
    extended = np.concatenate([position - drift, -(position - drift)[-2:0:-1]])
    spectrum = np.fft.rfft(extended, axis=0)
    square = np.abs(spectrum) ** 2 / len(extended)
    gain = 1 - noise / np.maximum(square, SMALLEST_POSITIVE)
    gain[square < MIN_SPECTRAL_RATIO * noise] = 0.0
    return np.asarray(np.fft.irfft(gain * spectrum, len(extended), axis=0)[:m] + drift)


def _signal_sizes(states: WindowStates, wrench: Array, torque: Array) -> SignalSizes:
    """Greatest magnitudes of a window's signals.

    Args:
        states: Motion of the window.
        wrench: Base wrench, (m, 6) [N, N m].
        torque: Joint torques, (m, n) [N m or N].
    """
    motion = states.smooth
    middle = motion.q.mean(axis=0)
    return SignalSizes(
        torque=_peak_magnitudes(torque),
        wrench=_peak_magnitudes(wrench),
        speed=_peak_magnitudes(motion.qd),
        acceleration=_peak_magnitudes(motion.qdd),
        range=_peak_magnitudes(motion.q - middle),
        middle=middle,
        duration=float(np.abs(states.time).max()),
    )


def _peak_magnitudes(signal: Array) -> Array:
    """Greatest magnitude of each column, at least SMALLEST_POSITIVE."""
    return np.asarray(np.maximum(np.abs(signal).max(axis=0), SMALLEST_POSITIVE))


def with_common_sizes(windows: Sequence[Linearization]) -> tuple[Linearization, ...]:
    """Linearisations with the signal magnitudes of the whole recording.

    They are the largest of the windows' magnitudes; mean positions are averaged over the windows.

    Args:
        windows: Linearisations of the recording's windows.
    """
    window_sizes = [linearization.sizes for linearization in windows]
    largest = {
        field.name: np.max(
            [getattr(sizes, field.name) for sizes in window_sizes], axis=0
        )
        for field in fields(SignalSizes)
    }
    middle = np.mean([sizes.middle for sizes in window_sizes], axis=0)
    sizes = SignalSizes(**{**largest, "middle": middle})
    return tuple(replace(linearization, sizes=sizes) for linearization in windows)
