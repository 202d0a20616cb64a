"""Diagnostics of robot, recording and settings, before any sample is used."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from testbed.core.base.diagnostics import Diagnostic, make_diagnostic
from testbed.core.base.errors import shortened_list
from testbed.core.dynamics.newton_euler import pedestal_wrench
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.constraints import TOTAL_MASS
from testbed.core.estimation.settings import Settings
from testbed.core.recordings.views import is_imported
from testbed.core.robot.friction import (
    BACKWARD_CONSTANT,
    FORWARD_CONSTANT,
    JOINT_LAWS,
    ROTOR,
)
from testbed.core.robot.tree import Tree


def setup_diagnostics(problem: Problem) -> Iterator[Diagnostic]:
    """Diagnostics of robot, recording and settings before any sample is used.

    In addition to the diagnostics of recording and problem, they report a tare that was not
    measured, joint laws of the model file that are not estimated, joints that move in one direction
    only (for which the sum of dry friction and offset is estimated), and an offset or drift of the
    plate common to several recordings.

    Args:
        problem: Problem with chosen terms and filters.
    """
    source, settings = problem.source, problem.settings
    plate = problem.method == "wrench"
    yield from source.metadata.diagnostics
    yield from problem.diagnostics
    if plate and TOTAL_MASS not in settings.facts and "bias" not in settings.nuisances:
        yield from _unmeasured_pedestal(problem)
    if problem.drives is not None:
        yield from _missing_terms(problem.tree, settings)
        for term in problem.drives.asked:
            if term.law in (FORWARD_CONSTANT, BACKWARD_CONSTANT):
                yield make_diagnostic(
                    "drives.one-way", problem.tree.names[term.joint], method="torque"
                )
    offset_terms = [kind for kind in ("bias", "slope") if kind in settings.nuisances]
    if plate and offset_terms and len(source.segments) > 1:
        yield make_diagnostic(
            "plate.common-offset", " and ".join(offset_terms), method="wrench"
        )


def _unmeasured_pedestal(problem: Problem) -> Iterator[Diagnostic]:
    """Diagnostic of a tare that was not measured: the weight of the model's pedestal.

    A tare within 0.2 % of this weight is taken as not measured, unless it is stated by a recording
    that is not imported.
    """
    weight = float(np.linalg.norm(pedestal_wrench(problem.tree)[:3]))
    # relative difference above which a tare is not the weight of the model's pedestal
    by_model = abs(np.linalg.norm(problem.tare[:3]) - weight) <= 2e-3 * weight
    stated = problem.source.tare is not None and not is_imported(problem.source)
    if weight and by_model and not stated:
        yield make_diagnostic("plate.no-tare", "the tare", weight, method="wrench")


def _missing_terms(tree: Tree, settings: Settings) -> Iterator[Diagnostic]:
    """Diagnostics of joint laws with coefficients in the model file, but not in the settings."""
    for law in JOINT_LAWS:
        coefficients = law.coefficients(tree)
        if coefficients.any() and law not in settings.laws:
            names = ", ".join(
                name
                for name, value in zip(tree.names, coefficients, strict=True)
                if value
            )
            yield make_diagnostic("drives.term", names, method="torque", kind=law.kind)


def regrouped_rotor_diagnostics(problem: Problem) -> Iterator[Diagnostic]:
    """Diagnostic of rotors in the model file that torques identify only together with bodies.

    Args:
        problem: Problem of either method.
    """
    rotor_names = [
        f"+{ROTOR.kind}/{each.name}"
        for each in problem.tree.joints
        if each.rotor_inertia
    ]
    regrouped = [name for name in problem.names if name.endswith(tuple(rotor_names))]
    if regrouped:
        yield make_diagnostic(
            "drives.rotor", shortened_list(regrouped), method="torque"
        )
