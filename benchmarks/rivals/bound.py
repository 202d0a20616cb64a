"""No tool: what the Cramer-Rao bound leaves, positions and the noise's spectrum being known.

Rows are made of smoothed positions; errors of encoders are not counted, so that no tool reaches the
bound where encoders are coarse. Dry and viscous friction is unknown.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import butter, filtfilt

import testbed as tb
from benchmarks.bench import MEMORY, PLATE_NOISE, TORQUE_NOISE
from benchmarks.rivals.case import Answer, Array, Case, answer


def solve(case: Case, signal: str) -> Answer:
    """Standard deviations of predictions by the least possible covariance."""
    tree = tb.load_tree(case.urdf)
    plate = signal == "wrench"
    minimal = tb.minimal_set(tree, "wrench" if plate else "torque")
    q = filtfilt(*butter(4, 5.0, fs=case.rate), case.q, axis=0)
    qd = np.gradient(q, 1 / case.rate, axis=0)
    motion = tb.Motion(case.t, q, qd, np.gradient(qd, 1 / case.rate, axis=0))
    rows = tb.regressor(tree, motion, minimal)
    if not plate:
        eye, v = np.eye(len(case.joints)), qd[:, :, None]
        rows = np.concatenate([rows, np.sign(v) * eye, v * eye], axis=2)
    size = PLATE_NOISE if plate else TORQUE_NOISE * np.abs(case.torque).max(axis=0)
    information = sum(_information(rows[:, k], case, size[k]) for k in range(rows.shape[1]))
    scale = 1 / np.sqrt(np.diagonal(information))
    spread = np.linalg.pinv(information * scale * scale[:, None], 1e-12) * scale * scale[:, None]
    new = tb.regressor(
        tree, tb.Motion(np.arange(float(len(case.unseen[0]))), *case.unseen), minimal
    )
    own = spread[: minimal.count, : minimal.count]
    sigma = np.sqrt(np.einsum("mki,ij,mkj->mk", new, own, new))
    return {"expected": sigma}


def _information(rows: Array, case: Case, size: float) -> Array:
    """Of one channel about all unknowns, by frequencies."""
    waves = np.fft.rfft(rows, axis=0)
    density = np.ones(len(waves))
    if "coloured" in case.name:
        kept = np.exp(-1 / (case.rate * MEMORY))
        turn = np.exp(-2j * np.pi * np.arange(len(waves)) / len(rows))
        density = 0.1**2 + 0.9**2 * (1 - kept**2) / np.abs(1 - kept * turn) ** 2
    weighted = waves / (size * np.sqrt(density[:, None]))
    doubled = np.where(np.arange(len(waves)) % (len(waves) - 1) == 0, 1.0, 2.0)[:, None]
    return np.asarray(((weighted.conj() * doubled).T @ weighted).real / len(rows))


if __name__ == "__main__":
    answer({"bound": solve}, "")
