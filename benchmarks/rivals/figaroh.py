"""FIGAROH, joint torques: as its examples go, and with a mask of reversals as an expert would set.

Its examples filter positions, decimate torques and regressor, and solve by weighted least squares.
Cutoffs are tried as those of the script on iDynTree. Its external wrench has no documented use.
"""

from __future__ import annotations

import tempfile
import time
from functools import partial
from importlib.metadata import version
from pathlib import Path

import numpy as np
from figaroh.data.trajectory import TrajectoryData
from figaroh.identification.base_identification import BaseIdentification
from figaroh.tools.load_robot import load_robot
from figaroh.tools.regressor import build_regressor_basic

from benchmarks.rivals.case import Answer, Array, Case, answer

SETTINGS = {"plain": 10.0, "expert, 3 Hz": 3.0, "expert, 5 Hz": 5.0}
"""Cutoffs of the filter on positions [Hz]; with masks 10 Hz was worse in nearly every case."""

EDGE = 0.5
"""Left out at both ends: filters start there [s]."""

REVERSAL = 0.03
"""Mask about each joint's reversals [s]. It takes whole samples, of all joints; the decimation's
filter spreads dry friction's jump no farther."""


# the user's lines
class Identification(BaseIdentification):  # type: ignore[misc]
    """As every example of FIGAROH makes a class of its own."""

    def __init__(self, robot: object, config: str, case: Case, expert: bool) -> None:
        self.case, self.expert = case, expert
        super().__init__(robot, config)
        model = self.robot.model
        joints = [model.joints[model.getJointId(name)] for name in case.joints]
        # not set by the configuration of 1.0.2, and a KeyError without
        self.identif_config["act_idxq"] = [joint.idx_q for joint in joints]
        self.identif_config["act_idxv"] = [joint.idx_v for joint in joints]
        self.identif_config["act_Jid"] = [model.getJointId(name) for name in case.joints]
        self.identif_config["act_J"] = joints

    def load_trajectory_data(self, data_source: str | None = None) -> TrajectoryData:
        """The recording; an expert masks reversals, and both leave out the ends."""
        case, edge = self.case, round(EDGE * self.case.rate)
        mask = np.ones(len(case.t), dtype=bool)
        mask[:edge] = mask[-edge:] = False
        if self.expert:
            smooth = self._apply_filters(case.q, **self.filter_config["filter_params"])
            mask &= case.away(np.gradient(smooth, 1 / case.rate, axis=0), REVERSAL).all(axis=1)
        model = self.robot.model
        turns = [model.joints[i].shortname().startswith("JointModelR") for i in
                 (model.getJointId(name) for name in case.joints)]  # fmt: skip
        kinds = ["joint_torque" if turn else "joint_force" for turn in turns]
        units = ["N·m" if turn else "N" for turn in turns]
        return TrajectoryData(case.t, case.joints, case.q, case.torque, kinds, units, mask=mask)


CONFIG = """
robot: {{name: robot, properties: {{joints: {{active_joints: {joints}}}}}}}
tasks:
  identification:
    enabled: true
    problem:
      model_components: {{friction: true, actuator_inertia: false, joint_offset: false}}
      wls: true
      qr_relative_tolerance: 1.0e-4
    signal_processing: {{sampling_frequency: {rate}, cutoff_frequency: {cutoff}}}
    coupling: {{has_coupled_wrist: false}}
"""
# end


def solve(case: Case, signal: str, *, cutoff: float, expert: bool) -> Answer:
    """Base parameters by weighted least squares, and their covariance."""
    if signal == "wrench":
        raise NotImplementedError
    start = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        # the user's lines
        file = Path(folder) / "robot.yaml"
        file.write_text(CONFIG.format(joints=[*case.joints], rate=case.rate, cutoff=cutoff))
        robot = load_robot(str(case.urdf), isFext=False, loader="figaroh")
        task = Identification(robot, str(file), case, expert)
        task.initialize()
        task.solve(
            decimate=True, decimation_factor=round(case.rate / 100), plotting=False, wls=True
        )
        # end
    cpu = time.process_time() - start
    rows = _rows(task, case)
    weight = task._wls_row_weight[:, None]
    covariance = np.linalg.inv((task.dynamic_regressor_base * weight).T
                               @ (task.dynamic_regressor_base * weight))  # fmt: skip
    return {
        "prediction": rows @ task.phi_base,
        "sigma": np.sqrt(np.einsum("mki,ij,mkj->mk", rows, covariance, rows)),
        "said": [f"{each.stage} {each.status}" for each in task.stages if each.status != "ok"],
        "cpu": cpu,
    }


def _rows(task: Identification, case: Case) -> Array:
    """The base regressor along the unseen motion without friction, (m, n, p)."""
    model, config = task.robot.model, task.identif_config
    whole = [np.zeros((len(case.unseen[0]), size)) for size in (model.nq, model.nv, model.nv)]
    for states, kept, places in zip(
        case.unseen, whole, ("act_idxq", "act_idxv", "act_idxv"), strict=True
    ):
        kept[:, config[places]] = states
    rows = build_regressor_basic(task.robot, *whole, config)
    rows[:, 10 * model.nv :] = 0.0
    rows = np.delete(rows, task._idx_eliminated, axis=1)[:, task._base_indices]
    return np.asarray(rows.reshape(model.nv, len(whole[0]), -1)[config["act_idxv"]].swapaxes(0, 1))


if __name__ == "__main__":
    ways = {
        name: partial(solve, cutoff=cutoff, expert=name != "plain")
        for name, cutoff in SETTINGS.items()
    }
    answer(ways, version("figaroh"))
