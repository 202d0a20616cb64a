"""testbed by its defaults: no key is set."""

from __future__ import annotations

import time

import numpy as np

import testbed as tb
from benchmarks.rivals.case import Answer, Case, answer
from testbed.core.base.installation import package_versions


def solve(case: Case, signal: str) -> Answer:
    """Base parameters and their covariance."""
    start = time.process_time()
    # the user's lines
    tree = tb.load_tree(case.urdf)
    recording = tb.Recording(case.joints, case.t, case.q, torque=case.torque, wrench=case.wrench)
    estimate = tb.identify(tree, recording, "wrench" if signal == "wrench" else "torque")
    # end
    cpu = time.process_time() - start
    count = estimate.minimal.count
    motion = tb.Motion(np.arange(float(len(case.unseen[0]))), *case.unseen)
    rows = tb.regressor(tree, motion, estimate.minimal)
    spread = estimate.covariance[:count, :count]
    return {
        "prediction": rows @ estimate.values[:count],
        "sigma": np.sqrt(np.einsum("mki,ij,mkj->mk", rows, spread, rows)),
        "said": [each.code for each in estimate.diagnostics],
        "cpu": cpu,
    }


def warn(case: Case, signal: str) -> Answer:
    """What is said of both signals together."""
    if signal == "torque":
        raise NotImplementedError
    tree = tb.load_tree(case.urdf)
    recording = tb.Recording(case.joints, case.t, case.q, torque=case.torque, wrench=case.wrench)
    run = tb.assemble_run(tree, recording, name="both")
    every = [*run.diagnostics, *(d for e in run.estimates.values() for d in e.diagnostics)]
    return {"said": [each.code for each in every]}


if __name__ == "__main__":
    answer({"default": solve, "both signals": warn}, package_versions()["testbed"])
