"""Diagnostics of robot, recording and settings, before any sample is used."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from testbed.core.base.diagnostics import Diagnostic, diagnose
from testbed.core.base.errors import few
from testbed.core.dynamics.newton_euler import pedestal_wrench
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.constraints import MASS
from testbed.core.estimation.settings import Settings
from testbed.core.recordings.views import is_imported
from testbed.core.robot.friction import BACKWARD, FORWARD, LAWS, ROTOR
from testbed.core.robot.tree import Tree


def setup_diagnostics(problem: Problem) -> Iterator[Diagnostic]:
    """What is wrong with robot, recording and settings before any sample is used.

    Args:
        problem: Its terms and filters are chosen.
    """
    source, settings = problem.source, problem.settings
    plate = problem.method == "external"
    yield from source.metadata.diagnostics
    yield from problem.diagnostics
    if plate and MASS not in settings.facts and "bias" not in settings.nuisances:
        yield from _of_pedestal(problem)
    if problem.drives is not None:
        yield from _missing_terms(problem.tree, settings)
        for term in problem.drives.asked:
            if term.law in (FORWARD, BACKWARD):
                yield diagnose(
                    "drives.one-way", problem.tree.names[term.joint], method="internal"
                )
    passing = [kind for kind in ("bias", "slope") if kind in settings.nuisances]
    if plate and passing and len(source.segments) > 1:
        yield diagnose("plate.common-offset", " and ".join(passing), method="external")


def _of_pedestal(problem: Problem) -> Iterator[Diagnostic]:
    """A pedestal whose weight nobody has measured: by the model file, or by a solved mapping."""
    weight = float(np.linalg.norm(pedestal_wrench(problem.tree)[:3]))
    # part of the model's pedestal by which a tare is not its weight
    by_model = abs(np.linalg.norm(problem.tare[:3]) - weight) <= 2e-3 * weight
    stated = problem.source.tare is not None and not is_imported(problem.source)
    if weight and by_model and not stated:
        yield diagnose("plate.no-tare", "the tare", weight, method="external")


def _missing_terms(tree: Tree, settings: Settings) -> Iterator[Diagnostic]:
    """Terms of the joints' torque that the model file states and the settings leave out."""
    for law in LAWS:
        given = law.coefficients(tree)
        if given.any() and law not in settings.laws:
            names = ", ".join(
                name for name, value in zip(tree.names, given, strict=True) if value
            )
            yield diagnose("drives.term", names, method="internal", kind=law.kind)


def regrouped_rotors(problem: Problem) -> Iterator[Diagnostic]:
    """Rotors that the model file states and that torques identify only in sums with bodies.

    Args:
        problem: By either method.
    """
    stated = [
        f"+{ROTOR.kind}/{each.name}"
        for each in problem.tree.joints
        if each.rotor_inertia
    ]
    sums = [name for name in problem.names if name.endswith(tuple(stated))]
    if sums:
        yield diagnose("drives.rotor", few(sums), method="internal")
