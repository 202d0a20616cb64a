"""A real Staubli TX40, whose published numbers are reproduced."""

from __future__ import annotations

import csv
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

import testbed as tb
from testbed.core.base.arrays import Array
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.selection.term_choice import choose_terms, cross_validate
from tests.helpers.paths import ROOT

TX40 = ROOT / "examples/tx40"
RATE = 5000.0
SLOW = np.array([0.05009095, 0.05009095, 0.07504916, 0.0715585, 0.05585054, 0.12217305])
"""Joint speeds below which the source leaves rows out [rad/s]."""

STANDARD = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
OWN = ("fv", "fs", "off", "Ia")
SHARED = ("Iam6", "fvm6", "fsm6")


def joint_side() -> tuple[Array, Array]:
    """Positions and torques of the joints, as the source makes them of its two files."""
    read = [
        np.loadtxt(TX40 / f"{name}.csv.gz", delimiter=",", skiprows=1)
        for name in ("pos_read_data", "curr_data")
    ]
    gear = np.diag([32.0, 32.0, 45.0, -48.0, 45.0, 32.0])
    gear[5, 4] = 32.0
    q = np.array(np.linalg.solve(gear, read[0].T).T, dtype=float)
    torque = np.array(read[1] @ gear, dtype=float)
    q[:, 1] -= np.pi / 2
    q[:, 2] += np.pi / 2
    return q, torque


def published() -> tuple[Array, Array, Array]:
    """Combinations of 60 standard parameters and 27 others, (60, 87), and their two estimates."""
    place = {f"{name}{j + 1}": 10 * j + k for j in range(6) for k, name in enumerate(STANDARD)}
    place |= {f"{key}{j + 1}": 60 + 6 * k + j for k, key in enumerate(OWN) for j in range(6)}
    place |= {name: 84 + k for k, name in enumerate(SHARED)}
    with (TX40 / "published_parameters.csv").open() as file:
        lines = list(csv.reader(file))
    told = np.zeros((60, 87))
    for row, line in zip(told, lines, strict=True):
        for sign, factor, name in re.findall(r"([+-] )?(?:([\d.]+)\*)?([A-Za-z]\w*)", line[0]):
            row[place[name]] = (-1.0 if sign == "- " else 1.0) * float(factor or 1.0)
    plain, weighted = (np.array([float(line[k]) for line in lines]) for k in (1, 3))
    return told, plain, weighted


def diagonal(values: Array) -> Array:
    found = np.zeros((*values.shape, values.shape[1]))
    found[:, range(values.shape[1]), range(values.shape[1])] = values
    return found


def rows_of_the_source(tree: tb.Tree, minimal: tb.MinimalSet) -> tuple[list[Array], list[Array]]:
    """Regressor and torques joint by joint, with the source's four slips.

    A filter at 25 Hz that is called 100 Hz; forward differences; no acceleration of joint 6; and
    torques that are two samples longer than the regressor, so that rows of later joints shift.
    """
    q, torque = joint_side()
    torque = torque[20:-20]
    q = signal.filtfilt(*signal.butter(4, 0.01), q, axis=0, padtype="odd", padlen=12)[20:-20]
    dq = np.diff(q, axis=0) * RATE
    ddq = np.zeros_like(dq)
    ddq[:, :5] = np.gradient(dq[:, :5], axis=0) * RATE
    q, dq, ddq = q[:-2], dq[:-1], ddq[:-1]
    motion = tb.Motion(np.arange(len(q)) / RATE, q, dq, ddq)
    wrist = np.zeros((len(q), 6, 3))
    both = np.sign(dq[:, 4] + dq[:, 5])
    wrist[:, 4] = np.stack([ddq[:, 5], dq[:, 5], both], axis=1)
    wrist[:, 5] = np.stack([ddq[:, 4], dq[:, 4], both], axis=1)
    own = [diagonal(dq), diagonal(np.sign(dq)), diagonal(np.ones_like(dq)), diagonal(ddq)[..., 2:5]]
    every = np.concatenate([tb.regressor(tree, motion, minimal), *own, wrist], axis=2)
    flat, size = every.transpose(1, 0, 2).reshape(6 * len(q), -1), len(torque)
    columns, measured = [], []
    for j in range(6):
        y, x = decimated(torque[:, j]), decimated(flat[j * size : (j + 1) * size])
        x = np.pad(x, ((0, len(y) - len(x)), (0, 0)))
        kept = np.abs(x[:, minimal.count + j]) >= SLOW[j]
        columns.append(x[kept])
        measured.append(y[kept])
    return columns, measured


def decimated(values: Array) -> Array:
    for _ in range(2):
        values = signal.decimate(values, 10, axis=0, zero_phase=True)
    return values


@pytest.mark.slow
def test_the_published_parameters_are_reproduced() -> None:
    """By our minimal set and regressor, and by all that the source did, slips included."""
    tree = tb.load_tree(TX40 / "tx40.urdf")
    minimal = tb.minimal_set(tree, "torque")
    columns, measured = rows_of_the_source(tree, minimal)
    x, y = np.concatenate(columns), np.concatenate(measured)
    assert len(y) == 2075
    plain = np.linalg.lstsq(x, y, rcond=None)[0]
    noise = [np.sqrt(np.mean((b - a @ plain) ** 2)) for a, b in zip(columns, measured, strict=True)]
    white = np.concatenate([a / s for a, s in zip(columns, noise, strict=True)])
    right = np.concatenate([b / s for b, s in zip(measured, noise, strict=True)])
    weighted = np.linalg.lstsq(white, right, rcond=None)[0]
    ours = np.zeros((60, 87))  # which parameters each of our unknowns is the sum of
    ours[:36, :60] = minimal.standard_matrix
    ours[36:54, 60:78] = np.eye(18)
    ours[54:57, 80:83] = ours[57:, 84:] = np.eye(3)
    for name, rotor in (("K*1zz", 78), ("K*2zz", 79)):
        ours[minimal.names.index(name), rotor] = 1.0
    told, by_plain, by_weighted = published()
    between = told @ np.linalg.pinv(ours)
    assert np.abs(between @ ours - told).max() < 1e-9
    assert np.abs(between @ plain - by_plain).max() < 4e-4
    assert np.abs(between @ weighted - by_weighted).max() < 4e-4
    assert np.sqrt(np.mean((y - x @ weighted) ** 2)) == pytest.approx(1.118, abs=5e-4)


@pytest.mark.slow
def test_unseen_sixths_are_foretold_better_with_the_coupled_wrist() -> None:
    """And with terms that are chosen by data that a fit has not seen."""
    tree, recording = (tb.load_tree(TX40 / "tx40.urdf"), tb.import_recording(TX40 / "tx40.toml"))
    geared = Problem.from_recording(tree, recording, "torque")
    alone, coupled = (cross_validate(each) for each in (replace(geared, tree=tree), geared))
    assert alone.residual[4] > 4 * coupled.residual[4]
    for cutoff, most in ((5.0, 1.10), (10.0, 1.04)):
        asked = tb.Settings(cutoff=cutoff)
        choice = choose_terms(Problem.from_recording(tree, recording, "torque", asked))
        assert choice.parts == 6
        assert choice.after.rms <= min(choice.before.rms, most)
