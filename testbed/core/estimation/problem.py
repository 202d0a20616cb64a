"""A robot and a recording of it, made ready for one method: where every estimate starts.

Gravity, gear, base, samples, filters, terms and tare are settled here, once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import filter
from functools import cached_property
from typing import Any

from numpy.typing import ArrayLike

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, diagnose
from testbed.core.base.errors import RecordingError, SettingsError, UnknownName
from testbed.core.base.stages import Progress, stage
from testbed.core.dynamics.drive_set import drive_set
from testbed.core.dynamics.newton_euler import pedestal_wrench
from testbed.core.estimation.estimate import METHODS, SIGNAL_OF, Method, channels_of
from testbed.core.estimation.regression.normal_equations import NormalEquations, gather
from testbed.core.estimation.regression.passes import Passes
from testbed.core.estimation.regression.windows import (
    ROWS_PER_CUTOFF,
    drive_filter,
    make_plan,
)
from testbed.core.estimation.selection.held_out import ALWAYS
from testbed.core.estimation.settings import DEFAULTS, Settings
from testbed.core.kernel.layout import Layout, layout
from testbed.core.parameters.joint_terms import DriveSet
from testbed.core.parameters.minimal_set import MinimalSet, minimal_set
from testbed.core.parameters.rules import Signal
from testbed.core.recordings.channels import (
    ChannelFault,
    channel_faults,
    left_out,
)
from testbed.core.recordings.columns import check_samples, members_of
from testbed.core.recordings.geometry import check_robot, in_its_gravity
from testbed.core.recordings.joined import Joined
from testbed.core.recordings.repeats import without_repeated_poses
from testbed.core.recordings.sampling_times import (
    SOUND,
    SamplingTimes,
    sampling_times,
)
from testbed.core.recordings.source import RecordingLike, Source, counted, open_source
from testbed.core.recordings.views import (
    is_imported,
    is_of_motors,
    on_its_base,
    with_gear,
)
from testbed.core.robot.friction import BY_LOAD, OFFSET, ROTOR
from testbed.core.robot.tree import Tree

NOTHING = "nothing"
"""In place of channels to leave out: faulty samples count, too."""


@dataclass(frozen=True, eq=False)
class Problem:
    """One recording of a robot, by one method, before any of its samples is used.

    Attributes:
        tree: The robot under the recording's gravity, with the shafts of its gear.
        source: The samples that count; of a robot on a free base, with the base's coordinates.
        method: "external" or "internal".
        settings: Complete: filters fit the sampling rate, and the terms are said ("auto" stays
            until held-out data choose).
        asked: Settings before that.
        threads: How many to use; None for one a processor.
        progress: Called with samples done and samples in all.
        diagnostics: Of the recording's poses and channels.
        faults: Of its channels, whose samples do not count.
        clock: Errors of its sampling times.
    """

    tree: Tree
    source: Source
    method: Method
    settings: Settings
    asked: Settings
    threads: int | None = None
    progress: Progress = lambda done, total: None
    diagnostics: tuple[Diagnostic, ...] = ()
    faults: tuple[ChannelFault, ...] = ()
    clock: SamplingTimes = SOUND

    @classmethod
    def of(
        cls,
        tree: Tree,
        recording: RecordingLike,
        method: Method | Signal,
        settings: Settings = DEFAULTS,
        *,
        gravity: ArrayLike | None = None,
        threads: int | None = None,
        progress: Progress = lambda done, total: None,
        knows_load: bool = False,
    ) -> Problem:
        """A robot and a recording made ready.

        Args:
            tree: The robot; its inertias are not used, except for `settings.zeros`.
            recording: Columns are matched by joint name; its truth is not read.
            method: Needs the wrench, or the torques.
            settings: How the signals are treated; default those of `Settings()`.
            gravity: (3,) [m/s^2], bedplate frame; default the recording's, if it says, else
                the tree's.
            threads: How many to use; default one a processor.
            progress: Called with samples done and samples in all.
            knows_load: Whether the bodies will be known, for laws of the load.

        Raises:
            RecordingError: The recording is of another robot, or lacks what the method needs.
            SettingsError: A span of time is said of several recordings.
        """
        by_signal: Mapping[str, Method] = {SIGNAL_OF[each]: each for each in METHODS}
        method = by_signal.get(method, method)
        if method not in METHODS:
            raise UnknownName("signal", method, by_signal)
        based = on_its_base(samples_of(recording, settings), tree)
        source, repeated = without_repeated_poses(based)
        check_source(source, tree, method)
        tree = with_gear(in_its_gravity(tree, source, gravity), source)
        complete = _complete(settings, tree, source, method)
        by_load = BY_LOAD if knows_load or method == "external" else ()
        lacking = {law.by for law in complete.laws} - {"", *source.signals, *by_load}
        if lacking:
            raise RecordingError(
                f"the recording has no {lacking.pop()}, which the terms need"
            )
        diagnostics = (
            (diagnose("encoder.interpolated", "the poses", repeated),)
            if repeated
            else ()
        )
        check_left_out(source, settings)
        faults: tuple[ChannelFault, ...] = ()
        if is_imported(source) and NOTHING not in settings.leave_out:
            faults = channel_faults(source, torques=method == "internal")
        clock = sampling_times(source)
        found = (each.diagnostic for each in faults)
        diagnostics = (*diagnostics, *found, *clock.diagnostics())
        return cls(
            tree=tree,
            source=source,
            method=method,
            settings=complete,
            asked=settings,
            threads=threads,
            progress=progress,
            diagnostics=diagnostics,
            faults=faults,
            clock=clock,
        )

    def with_settings(self, **changes: Any) -> Problem:
        """The same with some settings changed.

        Args:
            **changes: Of `Settings`, by name.
        """
        changed = replace(self, settings=replace(self.settings, **changes))
        # all that the minimal set depends on
        if not {"zeros", "tare"} & changes.keys():
            vars(changed)["minimal"] = self.minimal
        return changed

    @cached_property
    def tare(self) -> Array:
        """What is taken off the plate's wrench, (6,) [N, N m]: the pedestal's weight."""
        return tare_of(self.tree, self.source)

    @cached_property
    def minimal(self) -> MinimalSet:
        """The minimal set that the method sees."""
        return set_of(self.tree, self.method, self.settings)

    @cached_property
    def drives(self) -> DriveSet | None:
        """The minimal set with the joints' own terms; None for the plate."""
        if self.method == "external":
            return None
        return drive_set(self.tree, self.minimal, self.settings.words)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the unknowns, (p,)."""
        return self.minimal.names if self.drives is None else self.drives.names

    @property
    def units(self) -> tuple[str, ...]:
        """Of the unknowns, (p,)."""
        return self.minimal.units if self.drives is None else self.drives.units

    @property
    def channels(self) -> tuple[str, ...]:
        """The plate's six components, or the joints' names, (C,)."""
        return channels_of(self.tree, self.method)

    @cached_property
    def layout(self) -> Layout:
        """The robot's rows."""
        terms = () if self.drives is None else self.drives.terms
        return layout(self.tree.without_inertias(), self.minimal, terms)

    def passes(
        self,
        number: int,
        source: Source | None = None,
        whole: bool = False,
        per_cutoff: float = ROWS_PER_CUTOFF,
        load: Array | None = None,
    ) -> Passes:
        """Passes over the rows.

        Args:
            number: How many there will be.
            source: Another form of the same samples, such as one with faults taken back.
            whole: Whether rows near reversals count, too, if the settings do not say how near:
                they are whitened, and single ones are no torques then.
            per_cutoff: Rows a second per Hz of the filter on rows.
            load: Minimal parameters, (N,), for laws of the load; None where they are not known.

        Raises:
            RecordingError: The recording is too short, or sampled too slowly.
        """
        plan = make_plan(
            source or self.source, self.layout, self.tare, self.settings, per_cutoff
        )
        channels = [f"{SIGNAL_OF[self.method]}/{name}" for name in self.channels]
        named, reach = self.settings.leave_out, plan.taps.shape[1] // 2
        plan = replace(plan, left_out=left_out(self.faults, channels, named, reach))
        if whole and self.settings.reversal_reach is None:
            plan = replace(plan, rest_reach=0)
        # friction alone is sought: what a reversal leaves would bias it
        if load is not None:
            bodies = self.layout.theta.shape[2], self.minimal.count
            weights, nearby = drive_filter(self.settings, plan.source.rate)
            load = self.layout.basis[: bodies[0], : bodies[1]] @ load
            plan = replace(plan, load=load, weights=weights, rest_reach=nearby)
        return Passes(plan, self.threads, self.progress, number)

    def equations(self, passes: Passes) -> NormalEquations:
        """The normal equations of all rows, by one of the passes.

        Args:
            passes: Over the rows.
        """
        return gather(self.layout, self.names, self.channels, passes.sums())


def samples_of(recording: RecordingLike, settings: Settings) -> Source:
    """The samples of a recording, or of several, that count.

    Args:
        recording: As for `open_source`.
        settings: May say from when to when; else the recording may.

    Raises:
        RecordingError: It is no recording, or none of its samples is in that time.
        SettingsError: A time is said of several recordings.
    """
    source = open_source(recording)
    if len(source.segments) == 1:
        return counted(source, settings.span)
    if settings.span is not None:
        raise SettingsError(
            "identification.span is about one recording without a gap; cut others where they are "
            "imported"
        )
    return Joined([source])


def check_left_out(source: Source, settings: Settings) -> None:
    """Whether channels that are to be left out are some of a recording.

    Args:
        source: The recording.
        settings: May name some.

    Raises:
        UnknownName: A pattern names none.
    """
    signals = [signal for signal in SIGNAL_OF.values() if signal in source.signals]
    known = [f"{s}/{name}" for s in signals for name in members_of(s, source.names)]
    for pattern in settings.leave_out:
        if pattern != NOTHING and not filter(known, pattern):
            raise UnknownName("channel", pattern, known)


def check_source(source: Source, tree: Tree, method: Method) -> None:
    """Whether a recording is one, of this robot, with what a method needs.

    Args:
        source: The recording.
        tree: The robot.
        method: Reads torques or the wrench.

    Raises:
        RecordingError: It is not.
    """
    check_samples(source.samples, "the recording")
    if not source.rate > 0:
        raise RecordingError(
            "the recording: time does not increase from its first sample to its last"
        )
    check_robot(source, tree)
    if SIGNAL_OF[method] in source.signals:
        return
    others = [other for other in METHODS if SIGNAL_OF[other] in source.signals]
    advice = "".join(
        f"; its {SIGNAL_OF[other]} allows the {other} one" for other in others
    )
    if "sensors" in source.signals:
        named = ", ".join(source.metadata.sensors)
        advice += f"; it has force sensors: --sensor NAME ({named})"
    raise RecordingError(
        f"the recording has no {SIGNAL_OF[method]}, which the {method} method needs{advice}"
    )


def tare_of(tree: Tree, source: Source) -> Array:
    """The static wrench to be taken off the plate's, (6,) [N, N m]: the pedestal's.

    Args:
        tree: The robot, under the gravity of the recording.
        source: A recording; it may say so.
    """
    return pedestal_wrench(tree) if source.tare is None else source.tare


@stage("minimal set")
def set_of(tree: Tree, method: Method, settings: Settings) -> MinimalSet:
    """The minimal set that a method sees: of an unknown tare, what the wrench's changes identify.

    Args:
        tree: The robot, under the gravity of the recording.
        method: By plate or by torques.
        settings: Which parameters are zero, and whether the tare is known.
    """
    tared = method == "external" and settings.tare == "unknown"
    return minimal_set(tree, SIGNAL_OF[method], zeros=settings.zeros, tared=tared)


def usual_terms(tree: Tree, source: Source) -> list[str]:
    """Words of the terms that joints have unless something else is said.

    Real drives have offsets, too; what motors deliver moves rotors, and a model file may state some
    (MJCF's armature).

    Args:
        tree: The robot.
        source: The recording.
    """
    words = [law.kind for law in (*ALWAYS, *[OFFSET] * is_imported(source))]
    if is_of_motors(source):
        return [*words, ROTOR.kind]
    return [
        *words,
        *(f"{ROTOR.kind}/{each.name}" for each in tree.joints if each.rotor_inertia),
    ]


def _complete(
    settings: Settings, tree: Tree, source: Source, method: Method
) -> Settings:
    """Settings with filters that fit the recording, all terms, and a zero that nobody knows."""
    nuisances: Sequence[str] = settings.nuisances
    if method == "external" and settings.tare == "unknown" and "bias" not in nuisances:
        nuisances = (*nuisances, "bias")
    terms = settings.terms
    if terms is None:
        terms = usual_terms(tree, source)
    return replace(settings.fitted(source.rate), nuisances=nuisances, terms=terms)
