"""Which terms the joints' torques have, without a plate: chosen by data that no fit has seen.

Bodies and terms are fitted together, to all parts of a recording but one; that one is foretold. A
term, of one joint or of a shaft that turns with several, is added if it lessens what is foretold
wrongly, on average over the parts by more than the standard error of that gain.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from testbed.blas import one_blas_thread
from testbed.dynamics.drive_set import drive_set
from testbed.errors import RecordingError, plural
from testbed.identification.estimate import Estimate, channel_units
from testbed.identification.held_out import HeldOut, Parts, TermChoice, grown, stretches
from testbed.identification.normal_equations import NormalEquations, gather
from testbed.identification.offered_laws import ALWAYS, OFFERED, rivals
from testbed.identification.open_speed import with_speed
from testbed.identification.passes import Passes, Progress
from testbed.identification.settings import AUTO, USUAL, Settings
from testbed.identification.weights import noise_weights
from testbed.identification.windows import make_plan
from testbed.kernel.layout import layout
from testbed.kernel.records import products_wanted
from testbed.parameters.joint_terms import DriveSet
from testbed.parameters.minimal_set import MinimalSet, minimal_set
from testbed.recordings.coupled_gear import is_imported
from testbed.recordings.source import Source
from testbed.robot.friction import OFFSET, ROTOR, JointLaw, JointTerm
from testbed.robot.tree import Tree

PARTS = 6
"""Of a recording."""

ROUNDS = 2
"""Of a choice: the second knows how much noise the first one leaves."""

FEWEST = 4
"""Rows of a part for each joint, on average, below which nothing can be chosen."""


def with_usual_terms(settings: Settings, source: Source) -> Settings:
    """Settings whose terms are said: by default offsets are estimated where drives are real.

    Args:
        settings: "auto" stays.
        source: The recording.
    """
    if settings.terms is not None:
        return settings
    return replace(settings, terms=[law.kind for law in usual_laws(source)])


def as_settled(settings: Settings, estimates: Iterable[Estimate]) -> Settings:
    """Settings that say the terms of an estimate, where they left them open.

    Args:
        settings: Those by which the estimates were made.
        estimates: By one method or by both.
    """
    drives = next((each.drives for each in estimates if each.drives is not None), None)
    if drives is not None and settings.terms == AUTO:
        return replace(settings, terms=[term.name(drives.tree) for term in drives.asked])
    if drives is not None and settings.terms is None:
        kinds = tuple(dict.fromkeys(term.law.kind for term in drives.asked))
        return settings if kinds == USUAL else replace(settings, terms=kinds)
    return settings


def usual_laws(source: Source) -> tuple[JointLaw, ...]:
    """What every joint of a recording has unless something else is said.

    Args:
        source: The recording.
    """
    return (*ALWAYS, OFFSET) if is_imported(source) else ALWAYS


def with_all_terms(
    tree: Tree,
    source: Source,
    minimal: MinimalSet,
    settings: Settings,
    threads: int | None,
    progress: Progress,
) -> tuple[Settings, TermChoice | None]:
    """Settings that say all terms, and the evidence where held-out data chose them.

    Args:
        tree: The robot, under the recording's gravity.
        source: With joint torques.
        minimal: The dynamic set.
        settings: Those that were asked for.
        threads: How many to use.
        progress: Called with samples done and samples in all.
    """
    choice = None
    settings = with_usual_terms(settings, source)
    if settings.terms == AUTO:
        choice = choose_terms(tree, source, settings, threads, progress)
        settings = replace(settings, terms=choice.words)
    if settings.open_speed:
        settings = with_speed(tree, source, minimal, settings, threads, progress)
    return settings, choice


def choose_terms(
    tree: Tree,
    source: Source,
    settings: Settings,
    threads: int | None = None,
    progress: Progress = lambda done, total: None,
) -> TermChoice:
    """The terms that held-out data choose.

    Args:
        tree: The robot, under the recording's gravity; its inertias are not used.
        source: With joint torques.
        settings: How the signals are treated; its terms do not matter.
        threads: How many to use.
        progress: Called with samples done and samples in all.

    Raises:
        RecordingError: The recording is too short to be cut into parts.
    """
    usual = usual_laws(source)
    laws = tuple(dict.fromkeys((*usual, ROTOR, *OFFERED)))
    look = _Look(tree, source, settings, laws, threads, progress)
    count, terms = look.drives.minimal.count, look.drives.terms
    base = [term for term in terms if term.law in usual]
    at = {term: count + k for k, term in enumerate(terms)}
    always = [*range(count), *(at[term] for term in base)]
    more: list[JointTerm] = []
    with one_blas_thread():
        for _ in range(ROUNDS):
            parts = look.parts([*always, *(at[term] for term in more)])
            more, growth = grown(
                parts,
                always,
                {term: place for term, place in at.items() if term not in base},
                lambda term: term.name(tree),
                lambda one, other: one.joint == other.joint and rivals(one.law, other.law),
            )
        before = look.held_out(parts, always)
        after = look.held_out(parts, [*always, *(at[term] for term in more)])
    within = [term for term in look.drives.regrouped if term.law == ROTOR]
    words = tuple(term.name(tree) for term in (*base, *more, *within))
    return TermChoice(words, growth, before, after, PARTS)


def held_out(
    tree: Tree,
    source: Source,
    settings: Settings,
    threads: int | None = None,
    progress: Progress = lambda done, total: None,
) -> HeldOut:
    """What is left of unseen parts with the terms of the settings.

    Args:
        tree: The robot, under the recording's gravity; its inertias are not used.
        source: With joint torques.
        settings: How the signals are treated.
        threads: How many to use.
        progress: Called with samples done and samples in all.

    Raises:
        RecordingError: The recording is too short to be cut into parts.
    """
    look = _Look(tree, source, with_usual_terms(settings, source), None, threads, progress)
    every = [*range(look.drives.count)]
    with one_blas_thread():
        return look.held_out(look.parts(every), every)


class _Look:
    """A recording's rows with the columns of some terms, cut into parts."""

    def __init__(
        self,
        tree: Tree,
        source: Source,
        settings: Settings,
        laws: Sequence[str | JointLaw] | None,
        threads: int | None,
        progress: Progress,
    ) -> None:
        minimal = minimal_set(tree, "dynamic", zeros=settings.zeros)
        self.drives: DriveSet = drive_set(tree, minimal, settings.words if laws is None else laws)
        rows = layout(tree.without_inertias(), minimal, self.drives.terms, False)
        plan = make_plan(source, rows, np.zeros(6), settings)
        if plan.rows < FEWEST * PARTS:
            raise RecordingError(
                f"the recording gives {plural(plan.rows, 'row')}, too few to foretell "
                f"{PARTS} parts of it "
                "from the others; record longer"
            )
        self.passes = Passes(plan, threads, progress, 4)
        self.units = channel_units(tree, "internal")
        reach = -(-2 * (len(plan.weights) // 2) // plan.step)
        self.spans = list(stretches(plan.rows, PARTS, reach))
        with one_blas_thread():
            sums = self.passes.sums(products_wanted(tree.n))
            self.equations: NormalEquations = gather(rows, self.drives.names, tree.names, sums)

    def parts(self, columns: Sequence[int]) -> Parts:
        """Products of rows by parts, in units of the noise that a fit of some columns leaves."""
        weights = noise_weights(self.equations.of_unknowns(columns), None)
        root = np.sqrt(np.diagonal(weights))
        size = self.drives.count + 1
        unseen, near = np.zeros((2, PARTS, size, size))
        first = 0
        for every, measured in self.passes.rows(np.eye(self.drives.count)):
            rows = np.concatenate([every, measured[..., None]], axis=2) * root[:, None, None]
            for k, (own, beside) in enumerate(self.spans):
                for found, span in ((unseen[k], own), (near[k], beside)):
                    low, high = max(span.start - first, 0), max(span.stop - first, 0)
                    some = rows[:, low:high].reshape(-1, size)
                    found += some.T @ some
            first += rows.shape[1]
        return Parts(unseen, unseen.sum(axis=0) - near)

    def held_out(self, parts: Parts, columns: Sequence[int]) -> HeldOut:
        """What fits of some columns leave, channel by channel."""
        values = np.zeros((self.drives.count, PARTS))
        values[list(columns)] = parts.values(columns).T
        squares, first = np.zeros(len(self.units)), 0
        for foretold, measured in self.passes.rows(values):
            for k, (own, _) in enumerate(self.spans):
                low, high = max(own.start - first, 0), max(own.stop - first, 0)
                left = measured[:, low:high] - foretold[:, low:high, k]
                squares += (left**2).sum(axis=1)
            first += measured.shape[1]
        used = self.equations.used
        residual = np.sqrt(squares / np.maximum(used, 1.0))
        return HeldOut(self.equations.channels, self.units, self.equations.rms, residual, used)
