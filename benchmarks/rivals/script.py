"""What people write themselves: Pinocchio's regressor, filters, least squares or a ridge.

Joints and coupled shafts have Coulomb's and viscous friction, joints an offset, a plate a zero. The
ridge draws bodies to the model file's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.signal import butter, filtfilt

Array = NDArray[np.float64]

CUTOFF, REVERSAL, EDGE = 3.0, 0.1, 0.5
"""Of rows, of positions twice that [Hz]; left out beside reversals and at both ends [s]. Of 3, 5,
10 Hz and 0.05, 0.1, 0.2 s these are the best on `python -m benchmarks real`."""

RIDGE, LEAST = {"lstsq": 1e-8, "ridge": 0.1}, 0.05
"""Penalty of a body that differs from the file's by its size; rows are in parts of their noise,
which is at least such a part of the signal: rows may be as few as unknowns."""


def model_of(
    urdf: Path, joints: Sequence[str], held: Mapping[str, float | None], free: bool
) -> pin.Model:
    """The robot with its other joints held, on a free root for the wrench of a plate."""
    whole = pin.buildModelFromUrdf(str(urdf), *[pin.JointModelFreeFlyer()] * free)
    rest = pin.neutral(whole)
    for name, position in held.items():
        rest[whole.joints[whole.getJointId(name)].idx_q] = position or 0.0
    others = {*whole.names} - {"universe", "root_joint", *joints}
    return pin.buildReducedModel(whole, [whole.getJointId(name) for name in others], rest)


def script(
    model: pin.Model, joints: Sequence[str], signals: tuple[Array, Array, Array],
    turns: Array | None, rotors: bool,
) -> dict[str, tuple[Array, dict[str, Array]]]:  # fmt: skip
    """Standard parameters, (n, 10), and coefficients of other terms by kind.

    Args:
        model: By `model_of`.
        joints: Names, in the order of the columns.
        signals: Times, (M,) [s], positions, (M, n), and torques, (M, n), or the wrench, (M, 6).
        turns: Of joints and coupled shafts, for one of each joint, (n + s, n); None of a plate.
        rotors: Whether motors have inertias.
    """
    ids = [model.getJointId(name) for name in joints]
    v, data, made = [model.joints[i].idx_v for i in ids], model.createData(), []
    columns = np.ravel([range(10 * i - 10, 10 * i) for i in ids])
    t, q, measured = signals
    rate = 1 / np.diff(t).mean()
    q = filtfilt(*butter(4, 2 * CUTOFF, fs=rate), q, axis=0)
    qd = np.gradient(q, t, axis=0)
    qdd = np.gradient(qd, t, axis=0)
    for state in zip(q, qd, qdd, strict=True):
        full = np.zeros((3, model.nv))
        full[:, v] = state
        at = pin.integrate(model, pin.neutral(model), full[0])
        row = pin.computeJointTorqueRegressor(model, data, at, *full[1:])
        made.append(row[slice(6) if turns is None else v][:, columns])
    own = {"offset": np.tile(np.eye(measured.shape[1]), (len(t), 1, 1))}
    used = np.isfinite(measured)
    if turns is not None:
        speed, acceleration = (each @ turns.T for each in (qd[:, None], qdd[:, None]))
        own |= {"coulomb": np.sign(speed) * turns.T, "viscous": speed * turns.T}
        own |= {"rotor": acceleration * turns.T} if rotors else {}
        near = np.ones(2 * round(REVERSAL * rate) + 1)
        reversals = np.diff(np.sign(qd), axis=0, prepend=np.sign(qd[:1])) != 0
        used = np.array([np.convolve(each, near, "same") == 0 for each in reversals.T]).T
    rows = np.concatenate([made, *own.values()], axis=2)
    rows, wanted = (filtfilt(*butter(4, CUTOFF, fs=rate), x, axis=0) for x in (rows, measured))
    part = slice(round(EDGE * rate), -round(EDGE * rate), int(rate / (4 * CUTOFF)))
    rows, wanted, used = rows[part], wanted[part], used[part]
    file = np.array([model.inertias[i].toDynamicParameters() for i in ids])
    mass = np.maximum(np.abs(file[:, :1]), 1e-3)
    length = np.maximum(np.sqrt(np.abs(file[:, 4:]).max(axis=1, keepdims=True) / mass), 0.03)
    scale = np.ones(rows.shape[2])
    scale[: file.size] = (mass * length ** ([0] + [1] * 3 + [2] * 6)).ravel()
    left = wanted - rows[..., : file.size] @ file.ravel()
    noise, answers = np.ones(wanted.shape[1]), {}
    for name in ("lstsq", *RIDGE):  # the first time for the noise
        penalty = np.diag(np.sqrt(RIDGE[name]) * (np.arange(len(scale)) < file.size))
        matrix = np.vstack([(rows * scale / noise[:, None])[used], penalty])
        vector = np.append((left / noise)[used], np.zeros(len(scale)))
        found = scale * np.linalg.lstsq(matrix, vector, rcond=1e-8)[0]
        residual = np.where(used, left - rows @ found, 0.0)
        noise = np.sqrt((residual**2).sum(axis=0) / np.maximum(used.sum(axis=0), 1))
        noise = np.maximum(noise, LEAST * np.sqrt((wanted**2).mean(axis=0)))
        ends = np.cumsum([file.size, *(each.shape[2] for each in own.values())])[:-1]
        more, *others = np.split(found, ends)
        answers[name] = file + more.reshape(-1, 10), dict(zip(own, others, strict=True))
    return answers
