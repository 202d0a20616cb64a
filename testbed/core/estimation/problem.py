"""Estimation problem: a robot, one recording of it and one method, with complete settings.

Gravity, coupling shafts, base, samples, filters, terms and tare are set here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fnmatch import filter
from functools import cached_property
from typing import Any

from numpy.typing import ArrayLike

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, make_diagnostic
from testbed.core.base.errors import RecordingError, SettingsError, UnknownName
from testbed.core.base.stages import Progress, timed_stage
from testbed.core.dynamics.drive_set import make_drive_set
from testbed.core.dynamics.newton_euler import pedestal_wrench
from testbed.core.estimation.estimate import channel_names
from testbed.core.estimation.regression.normal_equations import (
    NormalEquations,
    assemble_normal_equations,
)
from testbed.core.estimation.regression.passes import Passes
from testbed.core.estimation.regression.windows import (
    ROWS_PER_CUTOFF,
    joint_law_filter,
    make_plan,
)
from testbed.core.estimation.selection.held_out import BASE_LAWS
from testbed.core.estimation.settings import DEFAULTS, Settings
from testbed.core.kernel.layout import Layout, make_layout
from testbed.core.parameters.joint_terms import DriveSet
from testbed.core.parameters.minimal_set import MinimalSet, minimal_set
from testbed.core.parameters.rules import SIGNALS, Signal
from testbed.core.recordings.channels import (
    ChannelFault,
    channel_faults,
    excluded_samples,
)
from testbed.core.recordings.columns import check_samples, column_members
from testbed.core.recordings.geometry import check_robot, with_recorded_gravity
from testbed.core.recordings.joined import Joined
from testbed.core.recordings.repeats import interpolate_repeated_poses
from testbed.core.recordings.sampling_times import (
    NO_TIMING_ERRORS,
    SamplingTimeErrors,
    detect_sampling_time_errors,
)
from testbed.core.recordings.source import (
    RecordingLike,
    Source,
    evaluated_samples,
    open_source,
)
from testbed.core.recordings.views import (
    adapt_to_robot,
    has_motor_torques,
    is_imported,
    with_gear_shafts,
)
from testbed.core.robot.friction import LOAD_MULTIPLIERS, OFFSET, ROTOR
from testbed.core.robot.tree import Tree

EXCLUDE_NOTHING = "nothing"
"""Entry of `Settings.leave_out` that includes faulty samples, too."""


@dataclass(frozen=True, eq=False)
class Problem:
    """Estimation problem: robot, recording, method and settings, before any sample is used.

    Attributes:
        tree: Robot with the recording's gravity and with the shafts of the recording's gear matrix.
        source: Selected samples; for a robot on a free base, with the coordinates of the base.
        method: "wrench" or "torque".
        settings: Complete settings: filters fit the sampling rate, and terms are stated ("auto"
            remains until cross-validation).
        requested_settings: Settings as requested, before completion.
        threads: Number of threads; None for one per processor.
        progress: Callback with the number of samples done and the total.
        diagnostics: Diagnostics of the recording's poses, channels and sampling times.
        channel_faults: Faults of channels, whose samples are excluded.
        sampling_times: Errors of the sampling times.
    """

    tree: Tree
    source: Source
    method: Signal
    settings: Settings
    requested_settings: Settings
    threads: int | None = None
    progress: Progress = lambda done, total: None
    diagnostics: tuple[Diagnostic, ...] = ()
    channel_faults: tuple[ChannelFault, ...] = ()
    sampling_times: SamplingTimeErrors = NO_TIMING_ERRORS

    @classmethod
    def from_recording(
        cls,
        tree: Tree,
        recording: RecordingLike,
        method: Signal | Signal,
        settings: Settings = DEFAULTS,
        *,
        gravity: ArrayLike | None = None,
        threads: int | None = None,
        progress: Progress = lambda done, total: None,
        knows_load: bool = False,
    ) -> Problem:
        """Set up the problem of a robot and its recording.

        Args:
            tree: Robot; its inertias are not used, except for `settings.zeros`.
            recording: Recording, whose columns are matched by joint name; its truth is not read.
            method: "wrench", which requires the measured wrench, or "torque", which requires the
                joint torques.
            settings: Filters, terms and known values.
            gravity: Gravity in the bedplate frame, (3,) [m/s^2]; default: gravity of the recording
                if stated, else of the tree.
            threads: Number of threads; default one per processor.
            progress: Callback with the number of samples done and the total.
            knows_load: True if the bodies' parameters will be known, as load-dependent joint laws
                require.

        Raises:
            RecordingError: The recording is of another robot, or lacks what the method needs.
            SettingsError: A time span is stated for several recordings.
            UnknownName: The method, or a channel to be excluded, does not exist.
        """
        if method not in SIGNALS:
            raise UnknownName("signal", method, SIGNALS)
        base_source = adapt_to_robot(selected_samples(recording, settings), tree)
        source, repeated = interpolate_repeated_poses(base_source)
        check_source(source, tree, method)
        tree = with_gear_shafts(with_recorded_gravity(tree, source, gravity), source)
        complete = _completed_settings(settings, tree, source, method)
        load_inputs = LOAD_MULTIPLIERS if knows_load or method == "wrench" else ()
        missing_inputs = {law.by for law in complete.laws} - {
            "",
            *source.signals,
            *load_inputs,
        }
        if missing_inputs:
            raise RecordingError(
                f"the recording has no {missing_inputs.pop()}, which the terms need"
            )
        diagnostics = (
            (make_diagnostic("encoder.interpolated", "the poses", repeated),)
            if repeated
            else ()
        )
        check_excluded_channels(source, settings)
        faults: tuple[ChannelFault, ...] = ()
        if is_imported(source) and EXCLUDE_NOTHING not in settings.leave_out:
            faults = channel_faults(source, torques=method == "torque")
        clock = detect_sampling_time_errors(source)
        channel_diagnostics = (each.diagnostic for each in faults)
        diagnostics = (*diagnostics, *channel_diagnostics, *clock.diagnostics())
        return cls(
            tree=tree,
            source=source,
            method=method,
            settings=complete,
            requested_settings=settings,
            threads=threads,
            progress=progress,
            diagnostics=diagnostics,
            channel_faults=faults,
            sampling_times=clock,
        )

    def with_settings(self, **changes: Any) -> Problem:
        """Problem with some settings changed.

        Args:
            **changes: New values of fields of `Settings`, by name.
        """
        changed = replace(self, settings=replace(self.settings, **changes))
        # the only settings on which the minimal set depends
        if not {"zeros", "tare"} & changes.keys():
            vars(changed)["minimal"] = self.minimal
        return changed

    @cached_property
    def tare(self) -> Array:
        """Pedestal's static wrench, subtracted from the measured wrench, (6,) [N, N m]."""
        return recording_tare(self.tree, self.source)

    @cached_property
    def minimal(self) -> MinimalSet:
        """Minimal set that the method can identify."""
        return method_minimal_set(self.tree, self.method, self.settings)

    @cached_property
    def drives(self) -> DriveSet | None:
        """Minimal set with the joint laws; None for the force plate."""
        if self.method == "wrench":
            return None
        return make_drive_set(self.tree, self.minimal, self.settings.words)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the robot's unknowns, (p,)."""
        return self.minimal.names if self.drives is None else self.drives.names

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the robot's unknowns, (p,)."""
        return self.minimal.units if self.drives is None else self.drives.units

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels, (C,): the wrench's six components or the joints."""
        return channel_names(self.tree, self.method)

    @cached_property
    def layout(self) -> Layout:
        """Layout of the regressor's rows and columns for the kernel."""
        terms = () if self.drives is None else self.drives.terms
        return make_layout(self.tree.without_inertias(), self.minimal, terms)

    def passes(
        self,
        number: int,
        source: Source | None = None,
        whole: bool = False,
        per_cutoff: float = ROWS_PER_CUTOFF,
        load: Array | None = None,
    ) -> Passes:
        """Passes over the regressor rows of the recording.

        Args:
            number: Total number of passes, for progress reports.
            source: Replacement of the problem's source, such as a recording with sensor errors
                corrected.
            whole: True to include rows near velocity reversals unless the settings state
                `reversal_reach`. Whitening accounts for the friction there, but single rows then do
                not represent joint torques.
            per_cutoff: Rows per second, per Hz of the low-pass cutoff on rows.
            load: Minimal parameters, (N,), for load-dependent joint laws; None if unknown.

        Raises:
            RecordingError: The recording is too short, or its sampling rate too low.
        """
        plan = make_plan(
            source or self.source, self.layout, self.tare, self.settings, per_cutoff
        )
        channels = [f"{self.method}/{name}" for name in self.channels]
        excluded, reach = self.settings.leave_out, plan.motion_kernels.shape[1] // 2
        plan = replace(
            plan,
            excluded_samples=excluded_samples(
                self.channel_faults, channels, excluded, reach
            ),
        )
        if whole and self.settings.reversal_reach is None:
            plan = replace(plan, reversal_reach=0)
        # friction alone is estimated: rows near reversals would bias it
        if load is not None:
            bodies = self.layout.theta.shape[2], self.minimal.count
            weights, rest_reach = joint_law_filter(self.settings, plan.source.rate)
            load = self.layout.basis[: bodies[0], : bodies[1]] @ load
            plan = replace(plan, load=load, weights=weights, reversal_reach=rest_reach)
        return Passes(plan, self.threads, self.progress, number)

    def equations(self, passes: Passes) -> NormalEquations:
        """Assemble the normal equations of all rows in one pass.

        Args:
            passes: Passes over the rows.
        """
        return assemble_normal_equations(
            self.layout, self.names, self.channels, passes.sums()
        )


def selected_samples(recording: RecordingLike, settings: Settings) -> Source:
    """Samples of one or several recordings that are used for the estimate.

    Args:
        recording: Recording or recordings, as for `open_source`.
        settings: Settings, whose time span has priority over that of the recording.

    Raises:
        RecordingError: `recording` is no recording, or has no samples in the time span.
        SettingsError: A time span is stated for several recordings.
    """
    source = open_source(recording)
    if len(source.segments) == 1:
        return evaluated_samples(source, settings.span)
    if settings.span is not None:
        raise SettingsError(
            "identification.span is about one recording without a gap; cut others where they are "
            "imported"
        )
    return Joined([source])


def check_excluded_channels(source: Source, settings: Settings) -> None:
    """Check that the channels excluded by the settings exist in a recording.

    Args:
        source: Recording.
        settings: Settings with names or patterns of the channels.

    Raises:
        UnknownName: A pattern matches no channel.
    """
    signals = [signal for signal in SIGNALS if signal in source.signals]
    known = [f"{s}/{name}" for s in signals for name in column_members(s, source.names)]
    for pattern in settings.leave_out:
        if pattern != EXCLUDE_NOTHING and not filter(known, pattern):
            raise UnknownName("channel", pattern, known)


def check_source(source: Source, tree: Tree, method: Signal) -> None:
    """Check that a recording belongs to the robot and contains the signal of the method.

    Args:
        source: Recording.
        tree: Robot.
        method: "wrench", which requires the measured wrench, or "torque", which requires the joint
            torques.

    Raises:
        RecordingError: The recording is damaged, of another robot, or lacks the signal.
    """
    check_samples(source.samples, "the recording")
    if not source.rate > 0:
        raise RecordingError(
            "the recording: time does not increase from its first sample to its last"
        )
    check_robot(source, tree)
    if method in source.signals:
        return
    others = [other for other in SIGNALS if other in source.signals]
    advice = "".join(f"; its {other} allows the {other} one" for other in others)
    if "sensors" in source.signals:
        sensors = ", ".join(source.metadata.sensors)
        advice += f"; it has force sensors: --sensor NAME ({sensors})"
    raise RecordingError(
        f"the recording has no {method}, which the {method} method needs{advice}"
    )


def recording_tare(tree: Tree, source: Source) -> Array:
    """Static wrench of the pedestal, subtracted from the plate's wrench, (6,) [N, N m].

    It is the tare of the recording if stated, else the weight of the model's pedestal.

    Args:
        tree: Robot under the gravity of the recording.
        source: Recording.
    """
    return pedestal_wrench(tree) if source.tare is None else source.tare


@timed_stage("minimal set")
def method_minimal_set(tree: Tree, method: Signal, settings: Settings) -> MinimalSet:
    """Minimal set that a method can identify.

    With an unknown tare, only changes of the wrench are used.

    Args:
        tree: Robot under the gravity of the recording.
        method: Method.
        settings: Settings with known zeros and the kind of tare.
    """
    tared = method == "wrench" and settings.tare == "unknown"
    return minimal_set(tree, method, zeros=settings.zeros, tared=tared)


def usual_terms(tree: Tree, source: Source) -> list[str]:
    """Default joint laws of a recording: friction, offsets and rotor inertias, as words.

    Offsets are included for imported recordings. Rotors are included at all joints if torques come
    from motors, else at joints whose rotor the model file states (MJCF's armature).

    Args:
        tree: Robot.
        source: Recording.
    """
    words = [law.kind for law in (*BASE_LAWS, *[OFFSET] * is_imported(source))]
    if has_motor_torques(source):
        return [*words, ROTOR.kind]
    return [
        *words,
        *(f"{ROTOR.kind}/{joint.name}" for joint in tree.joints if joint.rotor_inertia),
    ]


def _completed_settings(
    settings: Settings, tree: Tree, source: Source, method: Signal
) -> Settings:
    """Settings with filters fitted to the sampling rate, default terms and, if needed, a bias.

    An unknown tare adds a plate bias to the nuisances.
    """
    nuisances: Sequence[str] = settings.nuisances
    if method == "wrench" and settings.tare == "unknown" and "bias" not in nuisances:
        nuisances = (*nuisances, "bias")
    terms = settings.terms
    if terms is None:
        terms = usual_terms(tree, source)
    return replace(settings.fitted(source.rate), nuisances=nuisances, terms=terms)
