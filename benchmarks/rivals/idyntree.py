"""A script on iDynTree's regressor, which has joint rows and base rows: nobody documents more."""

from __future__ import annotations

import time
from functools import partial
from importlib.metadata import version

import idyntree.bindings as idt
import numpy as np
from scipy.signal import butter, filtfilt

from benchmarks.rivals.case import Answer, Array, Case, answer

SETTINGS = {"plain": 10.0, "expert, 3 Hz": 3.0, "expert, 5 Hz": 5.0, "expert, 10 Hz": 10.0}
"""Cutoffs of every filter: motions reach 0.5 Hz, products of theirs a few times that. A coarse
encoder wants a slower filter; an expert tries some, and the best is counted."""

EDGE = 0.5
"""Left out at both ends: filters start there [s]."""


def solve(case: Case, signal: str, *, cutoff: float, expert: bool) -> Answer:
    """Least squares; an expert masks reversals, and weights channels by their noise."""
    start = time.process_time()
    # the user's lines
    loader, dynamics = idt.ModelLoader(), idt.KinDynComputations()
    loader.loadReducedModelFromFile(str(case.urdf), list(case.joints))
    dynamics.loadRobotModel(loader.model())
    dynamics.setFrameVelocityRepresentation(idt.BODY_FIXED_REPRESENTATION)
    b, a = butter(4, cutoff, fs=case.rate)
    q, torque, wrench = (filtfilt(b, a, s, axis=0) for s in (case.q, case.torque, case.wrench))
    qd = np.gradient(q, 1 / case.rate, axis=0)
    qdd = np.gradient(qd, 1 / case.rate, axis=0)
    every = round(case.rate / 100)
    rows = regressor(dynamics, q[::every], qd[::every], qdd[::every], signal)
    wanted = (wrench if signal == "wrench" else torque)[::every]
    used = np.ones_like(wanted, dtype=bool)
    if signal == "torque":  # dry and viscous friction of every joint
        v = qd[::every, :, None]
        eye = np.eye(len(case.joints))
        rows = np.concatenate([rows, np.sign(v) * eye, v * eye], axis=2)
        if expert:
            used &= case.away(qd, 0.75 / cutoff)[::every]
    used[: round(100 * EDGE)] = used[-round(100 * EDGE) :] = False
    weights = np.ones(wanted.shape[1])
    for _ in range(2 if expert else 1):
        weighted = (rows * weights[:, None])[used], (wanted * weights)[used]
        found = np.linalg.lstsq(*weighted, rcond=1e-8)[0]
        left = np.where(used, wanted - rows @ found, 0.0)
        weights = 1 / np.sqrt((left**2).sum(axis=0) / used.sum(axis=0))
    # end
    cpu = time.process_time() - start
    new = regressor(dynamics, *case.unseen, signal)
    return {"prediction": new @ found[: new.shape[2]], "cpu": cpu}


def regressor(
    dynamics: idt.KinDynComputations, q: Array, qd: Array, qdd: Array, signal: str
) -> Array:
    """Rows of joint torques or of the base wrench, (M, k, 10 links)."""
    # the user's lines
    n, links = q.shape[1], dynamics.model().getNrOfLinks()
    matrix, still, rest = idt.MatrixDynSize(6 + n, 10 * links), idt.Twist.Zero(), idt.Vector6()
    rest.zero()
    gravity = idt.Vector3()
    for axis, value in enumerate((0.0, 0.0, -9.81)):
        gravity.setVal(axis, value)
    s, sd, sdd = (idt.VectorDynSize(n) for _ in range(3))
    part, made = slice(6) if signal == "wrench" else slice(6, None), []
    for states in zip(q, qd, qdd, strict=True):
        for kept, values in zip((s, sd, sdd), states, strict=True):
            for joint, value in enumerate(values):
                kept.setVal(joint, float(value))
        dynamics.setRobotState(idt.Transform.Identity(), s, still, sd, gravity)
        dynamics.inverseDynamicsInertialParametersRegressor(rest, sdd, matrix)
        made.append(matrix.toNumPy()[part].copy())
    return np.array(made)
    # end


if __name__ == "__main__":
    ways = {
        name: partial(solve, cutoff=cutoff, expert=name != "plain")
        for name, cutoff in SETTINGS.items()
    }
    answer(ways, version("idyntree"))
