"""The instrument's unknowns in an estimate: which can be told, found by Gauss and Newton, tested.

Columns of the unknowns are first-order effects. Each round corrects the recording by what was
found so far and estimates the rest, until nothing is left: the last fit has the columns beside
the robot's, and its covariance counts them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from testbed.arrays import Array
from testbed.diagnostics.diagnostic import Diagnostic, diagnose
from testbed.errors import SettingsError, few
from testbed.identification.noise.coloured_noise import GlsFit, sensor_step
from testbed.identification.noise.whitening import NuisanceColumns
from testbed.identification.problem import Problem
from testbed.identification.regression.constraints import LinearConstraints, facts
from testbed.identification.regression.least_squares import Fit
from testbed.identification.regression.normal_equations import NormalEquations
from testbed.identification.regression.passes import Passes
from testbed.identification.regression.windows import Plan
from testbed.identification.sensor.calibration_covariance import CalibrationCovariance
from testbed.identification.sensor.catalogue import NUISANCES, TESTED
from testbed.identification.sensor.correction import Corrected
from testbed.identification.sensor.estimates import NuisanceEstimate, TraceTest, in_order
from testbed.identification.sensor.identifiability import (
    NonIdentifiable,
    explain_nonidentifiable,
    identifiable_subset,
)
from testbed.identification.sensor.offsets import BIAS, SLOPE, TARE
from testbed.identification.sensor.predicted_wrench import row_filter
from testbed.identification.sensor.unknowns import Columns, Unknowns, unknowns_of
from testbed.identification.settings import Settings
from testbed.kernel.layout import Layout
from testbed.recordings.source import Source

ROUNDS = 8
"""Most corrections of a recording."""

OWN = 0.1
"""Share of an unknown's effect that has to be its own: below, columns made of noisy encoders are
no measure of it."""

ROUNDING = 1e-7
"""Of a nuisance: a correction that is smaller is the last."""

SETTLED = 0.05
"""Of sigma: a correction that is smaller is the last."""


class Start(NamedTuple):
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
class Side:
    """The instrument's unknowns beside the robot's.

    Attributes:
        settings: How signals are treated.
        unknowns: Which are estimated.
        nonidentifiable: Those asked for that cannot be told from others.
        tested: Faults whose traces are looked for.
        trends: Trends of the channels, which are beside them.
        stated: What is known of the robot's unknowns and of those that are estimated.
        taken: Names of unknowns that a calibrated plate has taken back: doubt alone is left.
    """

    settings: Settings
    unknowns: Unknowns
    nonidentifiable: tuple[NonIdentifiable, ...]
    tested: Unknowns
    trends: Unknowns
    stated: LinearConstraints
    taken: frozenset[str] = frozenset()

    @property
    def beside_zero(self) -> tuple[str, ...]:
        """What changes with constants of the plate that were asked for and cannot be told."""
        kinds = (BIAS.kind, TARE.kind)
        return tuple(
            n for i in self.nonidentifiable if i.name.partition("/")[0] in kinds for n in i.by
        )

    def beside(
        self, plan: Plan, values: Array, numbers: Array, tests: bool = True
    ) -> NuisanceColumns:
        """Columns to first order around an estimate.

        Args:
            plan: The rows.
            values: Minimal parameters, (p,).
            numbers: Of the instrument, taken back already, (s,).
            tests: Whether those of tested faults are among them.
        """
        shown = (self.unknowns, self.trends, self.tested) if tests else (self.unknowns,)
        left = self._left(values, numbers)
        if not any(each.kept for each in shown):
            return NuisanceColumns(facts=left)
        cutoff = self.settings.row_low_pass
        assert cutoff is not None, "settings refuse nuisances of rows that are not filtered"
        whole = any(n.whole for n in self.unknowns.nuisances)
        filtered = row_filter(plan, cutoff, exact=whole)
        kinds = [len(n.parts(plan.layout.tree)) for n in self.tested.nuisances]
        return NuisanceColumns(
            columns=Columns(
                plan,
                filtered,
                values,
                [each for each in shown if each.kept],
                self.unknowns,
                self.unknowns.unmixed(numbers),
                always=int(bool(self.unknowns.kept)),
            ),
            unknown=len(self.unknowns.kept),
            trends=len(self.trends.kept) if tests else 0,
            tested=tuple(kinds) if tests else (),
            facts=left,
        )

    def _left(self, values: Array, numbers: Array) -> LinearConstraints:
        """What is known of what is still to be added to all unknowns."""
        return self.stated.around(np.concatenate([values, numbers]))


def side(problem: Problem, doubt: CalibrationCovariance | None = None) -> Side:
    """Which unknowns of the instrument stand beside a robot's, before any data.

    Args:
        problem: Robot and recording. Its settings say which nuisances are asked for; tests need
            coloured noise and filtered rows.
        doubt: About the plate by which the recording was corrected.
    """
    settings, names = problem.settings, problem.names
    tree, none = problem.layout.tree, unknowns_of(problem.layout.tree, ())
    plate = problem.method == "external"
    asked = [n for n in NUISANCES if plate and n.kind in settings.nuisances]
    calibrated = doubt.nuisances(tree, asked) if plate and doubt is not None else []
    asked = [n for n in NUISANCES if n in asked or n in calibrated]
    every = unknowns_of(tree, asked)
    given = {n: v for n, v in settings.facts.items() if plate or n in names}
    stated = facts(tree, problem.minimal, names, every.names, given)
    taken = {part.name: part.right for n in calibrated for part in n.parts(tree)}
    if doubt is not None and taken:
        stated = doubt.added(stated, taken, (*names, *every.names))
    unknowns, nonidentifiable = identifiable_subset(problem, asked, stated) if asked else (none, ())
    _check_whole(every, nonidentifiable, settings)
    about = [*range(len(names)), *(len(names) + k for k in unknowns.kept)]
    tests = plate and settings.noise == "ar" and settings.row_low_pass is not None
    covered = {kind for n in asked for kind in (n.kind, *n.covers)}
    looked_for = [n for n in TESTED if n.kind not in covered]
    return Side(
        settings=settings,
        unknowns=unknowns,
        nonidentifiable=nonidentifiable,
        tested=unknowns_of(tree, looked_for) if tests else none,
        trends=unknowns_of(tree, [SLOPE]) if tests and SLOPE not in asked else none,
        stated=stated.about(about),
        taken=frozenset(taken),
    )


def _check_whole(
    every: Unknowns, nonidentifiable: Sequence[NonIdentifiable], settings: Settings
) -> None:
    """Whether all numbers can be told of those nuisances that are of no use otherwise.

    Raises:
        SettingsError: Some cannot; says which, and what to do.
    """
    needed = {n.kind for n in every.nuisances if n.whole}
    kinds = dict(zip(every.names, every.kinds, strict=True))
    open_ones = [each for each in nonidentifiable if kinds[each.name] in needed]
    if open_ones:
        raise SettingsError(explain_nonidentifiable(open_ones, settings.known, settings.nuisances))


class GaussNewtonResult(NamedTuple):
    """A recording whose nuisances are taken back.

    Attributes:
        start: Its weighted solution.
        values: Of the nuisances, (s,).
        calm: Whether the last correction was small.
        weak: Names of those that are hardly told.
    """

    start: Start
    values: Array
    calm: bool
    weak: tuple[str, ...]


def settled(source: Source, begin: Callable[[Source], Start], side: Side) -> GaussNewtonResult:
    """Passes over a recording whose nuisances are taken back, and the weighted solution.

    Args:
        source: The recording.
        begin: Finds the weighted solution of a recording.
        side: The instrument's unknowns.
    """
    values = side.unknowns.right
    start = begin(source)
    if not len(values):
        return GaussNewtonResult(start, values, calm=True, weak=())
    weak: tuple[str, ...] = ()
    for _ in range(ROUNDS):
        plan = start.passes.plan
        beside = side.beside(plan, start.fit.values, values, tests=False)
        step, sigma, share = sensor_step(start.fit, start.passes, beside)
        # with a whole matrix all numbers hang together, and sigma holds all the same: measured
        if not any(n.whole for n in side.unknowns.nuisances):
            each = zip(side.unknowns.names, share, strict=True)
            weak = tuple(n for n, s in each if s < OWN and n not in side.taken)
        values = values + step
        start = begin(Corrected(source, side.unknowns.by_kind(values), plan.layout.tree))
        if np.all(np.abs(step) <= SETTLED * sigma + ROUNDING * np.abs(values)):
            return GaussNewtonResult(start, values, calm=True, weak=weak)
    return GaussNewtonResult(start, values, calm=False, weak=weak)


def nuisance_estimates(side: Side, values: Array, found: GlsFit) -> tuple[NuisanceEstimate, ...]:
    """The instrument's numbers.

    Args:
        side: Which they are.
        values: What was taken back.
        found: What the last fit leaves of them.
    """
    sigma = np.sqrt(np.maximum(np.diagonal(found.further_covariance), 0.0))
    own = side.unknowns
    numbers = zip(own.kinds, own.names, own.units, values + found.further, sigma, strict=True)
    return tuple(
        NuisanceEstimate(kind, name, unit, float(value), float(spread))
        for kind, name, unit, value, spread in numbers
        if name not in side.taken
    )


def nuisance_covariance(side: Side, found: GlsFit) -> tuple[Array, Array]:
    """Covariance of the instrument's numbers, (s, s), and of the robot's with them, (p, s).

    Both in the order of `nuisance_estimates`.

    Args:
        side: Which they are.
        found: What the last fit leaves of them.
    """
    kept = [k for k, name in enumerate(side.unknowns.names) if name not in side.taken]
    return found.further_covariance[np.ix_(kept, kept)], found.across[:, kept]


def nuisance_diagnostics(side: Side, found: GaussNewtonResult) -> Iterator[Diagnostic]:
    """Calibration parameters that were asked for and are not identifiable.

    Args:
        side: The instrument's unknowns.
        found: What came of them.
    """
    groups: dict[tuple[str, ...], list[str]] = {}
    for each in side.nonidentifiable:
        groups.setdefault(each.by, []).append(each.name)
    for by, names in groups.items():
        verb = "is" if len(names) == 1 else "are"
        yield diagnose("plate.collinear", ", ".join(names), verb=verb, others=few(by))
    if found.weak:
        verb = "is" if len(found.weak) == 1 else "are"
        yield diagnose("plate.uncertain", few(found.weak), verb=verb, share=OWN)
    if not found.calm:
        yield diagnose("plate.not-converged", value=ROUNDS)


def trace_tests(
    layout: Layout, side: Side, names: Sequence[str], found: GlsFit
) -> tuple[TraceTest, ...]:
    """What the residuals hold of each kind of fault, the clearest first.

    Args:
        layout: The robot's rows.
        side: Which kinds were looked for.
        names: Of the parameters.
        found: The fit.
    """
    sigma = np.sqrt(np.maximum(np.diagonal(found.covariance), np.finfo(float).tiny))
    tests = []
    for nuisance, (trace, chance) in zip(side.tested.nuisances, found.traces, strict=False):
        moved = np.abs(trace.shift) / sigma
        parts = nuisance.parts(layout.tree)
        tests.append(
            TraceTest(
                nuisance=nuisance,
                chance=chance,
                clearness=trace.square - 2 * trace.count,
                names=tuple(part.name for part in parts),
                units=tuple(part.unit for part in parts),
                size=tuple(float(x) for x in trace.size),
                shift=float(moved.max()),
                parameter=names[int(moved.argmax())],
            )
        )
    return in_order(tests)
