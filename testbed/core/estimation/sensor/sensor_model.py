"""Calibration parameters of the instruments beside the robot's: identifiable ones, by Gauss-Newton.

Their columns are first-order effects. Each iteration corrects the recording by the values so far
and estimates what remains; the last fit has the columns beside the robot's, and its covariance
counts them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, diagnose
from testbed.core.base.errors import SettingsError, few
from testbed.core.estimation.noise.coloured_noise import GlsFit, sensor_step
from testbed.core.estimation.noise.whitening import NuisanceColumns
from testbed.core.estimation.problem import Problem
from testbed.core.estimation.regression.constraints import LinearConstraints, facts
from testbed.core.estimation.regression.normal_equations import (
    NormalEquations,
    standard_deviations,
)
from testbed.core.estimation.regression.passes import Passes
from testbed.core.estimation.regression.solvers import Fit
from testbed.core.estimation.regression.windows import Plan
from testbed.core.estimation.sensor.correction import CalibrationCovariance
from testbed.core.estimation.sensor.estimates import NuisanceEstimate
from testbed.core.estimation.sensor.predicted_wrench import row_filter
from testbed.core.estimation.sensor.unknowns import (
    Columns,
    NonIdentifiable,
    Unknowns,
    explain_nonidentifiable,
    identifiable_subset,
    unknowns_of,
)
from testbed.core.estimation.settings import Settings
from testbed.core.recordings.source import Source
from testbed.core.robot.tree import Tree
from testbed.sensors.catalogue import estimable_errors
from testbed.sensors.corrected import Corrected
from testbed.sensors.errors.plate_bias import PlateBias
from testbed.sensors.errors.plate_tare import PlateTare
from testbed.sensors.systematic_error import SystematicError

ROUNDS = 8
"""Most corrections of a recording."""

OWN = 0.1
"""Share of an unknown's effect that has to be its own: below, columns made of noisy encoders are
no measure of it."""


class LinearFit(NamedTuple):
    """The weighted solution of a recording.

    Attributes:
        passes: Over its rows.
        equations: Of all rows.
        fit: The solution.
    """

    passes: Passes
    equations: NormalEquations
    fit: Fit


@dataclass(frozen=True, eq=False)
class SensorModel:
    """Calibration parameters of the instruments that are estimated or known.

    Attributes:
        settings: How signals are treated.
        unknowns: Which are estimated.
        nonidentifiable: Those asked for that are collinear with others.
        known: What is known of the robot's unknowns and of those that are estimated.
        corrected: Names of those that a calibrated plate has corrected: their covariance counts.
    """

    settings: Settings
    unknowns: Unknowns
    nonidentifiable: tuple[NonIdentifiable, ...]
    known: LinearConstraints
    corrected: frozenset[str] = frozenset()

    @classmethod
    def of(
        cls, problem: Problem, doubt: CalibrationCovariance | None = None
    ) -> SensorModel:
        """Which calibration parameters are identifiable beside a robot's, before any data.

        Args:
            problem: Robot and recording. Its settings say which nuisances are asked for.
            doubt: About the plate by which the recording was corrected.
        """
        settings, names, tree = problem.settings, problem.names, problem.layout.tree
        plate = problem.method == "external"
        terms = settings.nuisances if plate else ()
        asked = [error for error in estimable_errors() if error.term in terms]
        calibrated = doubt.nuisances(tree, asked) if plate and doubt is not None else []
        asked = [
            error
            for error in estimable_errors()
            if error in asked or error in calibrated
        ]
        _check_cut(tree, asked)
        every = unknowns_of(tree, asked)
        given = {n: v for n, v in settings.facts.items() if plate or n in names}
        known = facts(tree, problem.minimal, names, every.names, given)
        neutral = {
            c.name: c.neutral for error in calibrated for c in error.coefficients(tree)
        }
        if doubt is not None and neutral:
            known = doubt.added(known, neutral, (*names, *every.names))
        unknowns, nonidentifiable = identifiable_subset(problem, asked, known)
        _check_whole(every, nonidentifiable, settings)
        return cls(
            settings=settings,
            unknowns=unknowns,
            nonidentifiable=nonidentifiable,
            known=known.about(
                [*range(len(names)), *(len(names) + k for k in unknowns.kept)]
            ),
            corrected=frozenset(neutral),
        )

    @property
    def with_unknown_zero(self) -> tuple[str, ...]:
        """Parameters that are collinear with constants of the plate that were asked for."""
        terms = (PlateBias.term, PlateTare.term)
        return tuple(
            n
            for i in self.nonidentifiable
            if i.name.partition("/")[0] in terms
            for n in i.by
        )

    def columns(self, plan: Plan, values: Array, numbers: Array) -> NuisanceColumns:
        """Columns to first order around an estimate.

        Args:
            plan: The rows.
            values: Minimal parameters, (p,).
            numbers: Of the instrument, by which the recording was corrected, (s,).
        """
        known = self.known.around(np.concatenate([values, numbers]))
        if not self.unknowns.kept:
            return NuisanceColumns(facts=known)
        cutoff = self.settings.row_low_pass
        assert cutoff is not None, (
            "settings refuse nuisances of rows that are not filtered"
        )
        exact = any(error.jointly for error in self.unknowns.nuisances)
        filtered = row_filter(plan, cutoff, exact=exact)
        sensed = plan.source.senses_kinematics
        noisy = 0.0 if sensed else self.settings.position_low_pass or 0.0
        return NuisanceColumns(
            columns=Columns(
                plan,
                filtered,
                values,
                self.unknowns,
                self.unknowns.unmixing(numbers),
                unfolded=row_filter(plan, cutoff, exact=exact, noisy=noisy),
            ),
            unknown=len(self.unknowns.kept),
            facts=known,
        )

    def estimates(self, values: Array, fit: GlsFit) -> tuple[NuisanceEstimate, ...]:
        """The instrument's numbers.

        Args:
            values: By which the recording was corrected, (s,).
            fit: The last fit, of what remains.
        """
        sigma = standard_deviations(fit.sensor_covariance)
        own = self.unknowns
        numbers = zip(
            own.terms,
            own.names,
            own.units,
            values + fit.sensor_values,
            sigma,
            strict=True,
        )
        return tuple(
            NuisanceEstimate(kind, name, unit, float(value), float(spread))
            for kind, name, unit, value, spread in numbers
            if name not in self.corrected
        )

    def covariance(self, fit: GlsFit) -> Array:
        """Covariance of the instrument's numbers, (s, s), in the order of `estimates`.

        Args:
            fit: The last fit.
        """
        kept = [
            k
            for k, name in enumerate(self.unknowns.names)
            if name not in self.corrected
        ]
        return fit.sensor_covariance[np.ix_(kept, kept)]

    def diagnostics(self, result: GaussNewtonResult) -> Iterator[Diagnostic]:
        """Calibration parameters that were asked for and are not identifiable.

        Args:
            result: Of the iterations.
        """
        groups: dict[tuple[str, ...], list[str]] = {}
        for each in self.nonidentifiable:
            groups.setdefault(each.by, []).append(each.name)
        for by, names in groups.items():
            verb = "is" if len(names) == 1 else "are"
            yield diagnose(
                "plate.collinear", ", ".join(names), verb=verb, others=few(by)
            )
        if result.weak:
            verb = "is" if len(result.weak) == 1 else "are"
            yield diagnose("plate.uncertain", few(result.weak), verb=verb, share=OWN)
        if not result.converged:
            yield diagnose("plate.not-converged", value=ROUNDS)


def _check_cut(tree: Tree, asked: Sequence[type[SystematicError]]) -> None:
    """Raise SettingsError where more than zeros is asked of a difference of two sensors."""
    mixed = [
        error.term
        for error in asked
        if tree.cuts and (not error.added or error.jointly)
    ]
    if mixed:
        raise SettingsError(
            f"{', '.join(mixed)}: of a wrench that is a difference of two sensors' only zeros "
            "and trends can be estimated; calibrate each sensor with all that it carries"
        )


def _check_whole(
    every: Unknowns, nonidentifiable: Sequence[NonIdentifiable], settings: Settings
) -> None:
    """Whether all numbers are identifiable of those nuisances that are of no use otherwise.

    Raises:
        SettingsError: Some cannot; says which, and what to do.
    """
    needed = {error.term for error in every.nuisances if error.jointly}
    terms = dict(zip(every.names, every.terms, strict=True))
    open_ones = [each for each in nonidentifiable if terms[each.name] in needed]
    if open_ones:
        raise SettingsError(
            explain_nonidentifiable(open_ones, settings.known, settings.nuisances)
        )


class GaussNewtonResult(NamedTuple):
    """Calibration parameters, and the weighted solution of the corrected recording.

    Attributes:
        solution: Of the recording as the values correct it.
        values: Of the calibration parameters, (s,).
        converged: Whether the last correction was small.
        weak: Names of those of which the data hold hardly anything.
    """

    solution: LinearFit
    values: Array
    converged: bool
    weak: tuple[str, ...]


def gauss_newton(
    source: Source, solve: Callable[[Source], LinearFit], model: SensorModel
) -> GaussNewtonResult:
    """Calibration parameters by Gauss-Newton: correct the recording, estimate what remains.

    Args:
        source: The recording.
        solve: Finds the weighted solution of a recording.
        model: Which parameters.
    """
    values, solution = model.unknowns.neutral, solve(source)
    weak: tuple[str, ...] = ()
    if not len(values):
        return GaussNewtonResult(solution, values, True, weak)
    for _ in range(ROUNDS):
        plan = solution.passes.plan
        columns = model.columns(plan, solution.fit.values, values)
        step, sigma, share = sensor_step(solution.fit, solution.passes, columns)
        # with a whole matrix all numbers are correlated, and sigma holds all the same: measured
        if not any(error.jointly for error in model.unknowns.nuisances):
            each = zip(model.unknowns.names, share, strict=True)
            weak = tuple(n for n, s in each if s < OWN and n not in model.corrected)
        values = values + step
        solution = solve(
            Corrected(source, model.unknowns.by_error(values), plan.layout.tree)
        )
        # a correction that is smaller, beside sigma or the number itself, is the last
        if np.all(np.abs(step) <= 0.05 * sigma + 1e-7 * np.abs(values)):
            return GaussNewtonResult(solution, values, True, weak)
    return GaussNewtonResult(solution, values, False, weak)
