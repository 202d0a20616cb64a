"""testbed by its defaults: no key is set."""

from __future__ import annotations

import time
from functools import lru_cache
from pathlib import Path

import numpy as np

import testbed as tb
from benchmarks.rivals.case import Answer, Case, answer


def solve(case: Case, signal: str) -> Answer:
    """Base parameters, their covariance, and diagnostics."""
    start = time.process_time()
    # the user's lines
    tree = tb.load_tree(case.urdf)
    signals = {"torque": case.torque, "wrench": case.wrench}
    recording = tb.Recording(case.joints, case.t, case.q, **signals)
    method = "external" if signal == "wrench" else "internal"
    estimate = tb.identify(tree, recording, method)
    # end
    cpu = time.process_time() - start
    count = estimate.minimal.count
    motion = tb.Motion(np.arange(len(case.unseen[0])), *case.unseen)
    rows = tb.regressor(tree, motion, estimate.minimal)
    spread = estimate.covariance[:count, :count]
    return {
        "prediction": rows @ estimate.values[:count],
        "sigma": np.sqrt(np.einsum("mki,ij,mkj->mk", rows, spread, rows)),
        "said": [each.code for each in estimate.diagnostics],
        "cpu": cpu,
    }


if __name__ == "__main__":
    from testbed.experiment.results import versions

    answer({"default": solve}, versions()["testbed"])
