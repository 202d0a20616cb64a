"""A plant, the controller around it, and the log of both: the loop over samples."""

from __future__ import annotations

import copy
import ctypes
from dataclasses import dataclass

import mujoco
import numpy as np

from testbed.recordings.recording import Truth
from testbed.simulation.compiled_loop import (
    Clock,
    Engine,
    Log,
    State,
    follow,
    mujoco_functions,
)
from testbed.simulation.controller import Controller
from testbed.simulation.effect import StepForces
from testbed.simulation.plant import Plant

SMOOTH_STEP = 1e-3
"""Longest step where no joint sticks or turns round [s]."""

SMOOTH_DECAY = 0.2
"""Part of the shortest time in which damping or a spring acts that such a step may last."""


@dataclass(frozen=True)
class Sampling:
    """How a run is cut into samples.

    Attributes:
        rate: Samples a second, also the controller's rate [Hz].
        steps: Simulation steps a sample; fewer are taken where no joint sticks or turns round,
            and no force jumps.
        averaged: Each sample is the mean over its time (integrate and dump), else its
            first instant.
        warm_up: Time run before the recording starts [s].
        begin: When the recording begins, 0 or earlier [s].
    """

    rate: float
    steps: int
    averaged: bool
    warm_up: float
    begin: float = 0.0


class SampledLoop:
    """One run, some samples after others."""

    def __init__(
        self, plant: Plant, drive: Controller, sampling: Sampling, forces: StepForces | None = None
    ) -> None:
        """At the beginning of the reference.

        Args:
            plant: The robot on its bedplate.
            drive: Its controller.
            sampling: How the run is cut into samples.
            forces: Asked before every step.
        """
        self._plant, model = plant, plant.model
        self._data = data = mujoco.MjData(model)
        data.qpos[:] = plant.dofs @ drive.q[0]  # every joint has one position
        data.qvel[:] = plant.dofs @ drive.qd[0]
        mujoco.mj_forward(model, data)
        self._rate, period = sampling.rate, 1 / sampling.rate
        smooth = 0 if forces else _smooth_steps(model, period)
        smooth = smooth if smooth < sampling.steps else 0
        self._smooth_model = copy.copy(model)
        option = self._smooth_model.opt
        option.timestep = period / max(smooth, 1)
        option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_REFSAFE)  # friction as it is
        self._push = _Push(forces, plant, data)
        self._engine = Engine(
            **mujoco_functions(),
            model=model._address,
            smooth_model=self._smooth_model._address,
            data=data._address,
            push=self._push.address,
        )
        self._state = State(
            position=data.qpos,
            velocity=data.qvel,
            acceleration=data.qacc,
            motor=data.ctrl,
            pushed=data.qfrc_applied,
            sensed=data.sensordata,
            passive=data.qfrc_passive,
            constraint=data.qfrc_constraint,
            dry=model.dof_frictionloss,
            order=plant.order,
            kept=np.zeros((2, model.nv)),
        )
        self._drive = drive
        self._clock = Clock(period, sampling.steps, smooth, sampling.averaged)

    def run(self, samples: range) -> Truth:
        """Follow the next samples of the reference.

        Args:
            samples: Their numbers.
        """
        plant, model, n = self._plant, self._plant.model, len(self._plant.order)
        torque, velocity, acceleration = np.zeros((3, len(samples), n))
        sensed, lost = (
            np.zeros((len(samples), model.nsensordata)),
            np.zeros((len(samples), model.nv)),
        )
        log = Log(torque, velocity, acceleration, sensed, lost)
        follow(
            self._engine,
            self._state,
            self._drive,
            self._clock,
            log,
            samples.start,
            self._push.failed,
        )
        self._push.check()
        if self._clock.averaged:
            later = np.vstack([velocity[1:], self._data.qvel[plant.order]])
            acceleration = (later - velocity) * self._rate
        return Truth(
            position=sensed[:, plant.positions],
            velocity=sensed[:, plant.velocities],
            acceleration=acceleration,
            torque=torque,
            friction=-lost @ plant.dofs,
            wrench=plant.bedplate_wrench(sensed[:, plant.plate]),
        )


def _smooth_steps(model: mujoco.MjModel, period: float) -> int:
    """Steps that a smooth sample needs, for the fastest of what damps or springs."""
    loose = model.dof_invweight0
    spring = model.jnt_stiffness[model.dof_jntid]
    fastest = max(np.max(model.dof_damping * loose), np.sqrt(np.max(spring * loose)))
    return int(np.ceil(period / min(SMOOTH_STEP, SMOOTH_DECAY / max(fastest, 1e-9)) * (1 - 1e-9)))


class _Push:
    """Forces on the joints, as C calls them; an error waits until the loop has ended."""

    def __init__(self, forces: StepForces | None, plant: Plant, data: mujoco.MjData) -> None:
        self.failed, self.address = np.zeros(1, dtype=bool), 0
        self._error: BaseException | None = None
        if forces is None:
            return
        order = plant.order

        def push(time: float) -> None:
            try:
                state = data.qpos[order], data.qvel[order], data.ctrl.copy()
                data.qfrc_applied[order] = forces(time, *state)
            except BaseException as error:
                self._error, self.failed[0] = error, True

        self._callback = ctypes.CFUNCTYPE(None, ctypes.c_double)(push)
        self.address = ctypes.cast(self._callback, ctypes.c_void_p).value or 0

    def check(self) -> None:
        """Raise what a push has raised."""
        if self._error is not None:
            raise self._error
