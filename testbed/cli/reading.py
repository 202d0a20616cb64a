"""Options of commands for reading a robot and recordings, with the resulting objects."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from testbed.cli.opening import corrected_source, open_recording, require_different
from testbed.cli.options import OUTPUT, ROBOT, Gravity
from testbed.core.base.diagnostics import Diagnostic
from testbed.core.base.installation import user_or_shipped_file
from testbed.core.base.stages import timed_stage
from testbed.core.parameters.rules import Signal
from testbed.core.robot.refusals import FreeRootError

if TYPE_CHECKING:
    from testbed.bodies.consistency.options import ConsistencyOptions
    from testbed.bodies.prior import PriorBodies
    from testbed.core.estimation.estimate import Estimate
    from testbed.core.estimation.sensor.correction import CalibrationCovariance
    from testbed.core.recordings.recording import Recording
    from testbed.core.recordings.source import Source
    from testbed.core.robot.model_file import ModelFile
    from testbed.core.robot.tree import Tree
    from testbed.lab.experiment.robot_tables import RecordingTables


@dataclass(frozen=True)
class ReadingOptions:
    """Options for reading a robot's model file and recordings.

    Instances are immutable: methods that adapt the options to a recording return a copy.
    """

    model: Annotated[
        Path | None,
        typer.Option(
            "--model",
            metavar="PATH",
            parser=user_or_shipped_file,
            help="MJCF or URDF file of the robot; runs and results have their own.",
        ),
    ] = None
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="Set a key, e.g. identification.cutoff=8; repeatable.",
        ),
    ] = None
    zeros: Annotated[
        bool,
        typer.Option(
            "--zeros",
            help="Fix to zero all parameters that are zero in the model file.",
        ),
    ] = False
    zero: Annotated[
        list[str] | None,
        typer.Option(
            "--zero",
            metavar="NAME",
            help="Fix a parameter to zero, e.g. mb1x; repeatable.",
        ),
    ] = None
    gravity: Gravity = None
    sensor: Annotated[
        str | None,
        typer.Option(
            "--sensor",
            metavar="NAME|LINK",
            help="Use the wrench of this force sensor, or of the one that carries this link; "
            "plate: of the force plate, without what lies beyond the sensors.",
            rich_help_panel=ROBOT,
        ),
    ] = None
    weld_root: Annotated[
        bool,
        typer.Option(
            "--weld-root",
            help="Weld a floating root to the bedplate.",
            rich_help_panel=ROBOT,
        ),
    ] = False
    lock: Annotated[
        list[str] | None,
        typer.Option(
            "--lock",
            metavar="JOINT[=q]",
            help="Fix a joint at q [rad or m], default as recorded, or at rest; a pattern as "
            "arm_*, or !arm_* for all others; repeatable.",
            rich_help_panel=ROBOT,
        ),
    ] = None
    lock_mimic: Annotated[
        bool,
        typer.Option(
            "--lock-mimic",
            help="Fix all joints that follow others.",
            rich_help_panel=ROBOT,
        ),
    ] = False
    plate: Annotated[
        Path | None,
        typer.Option(help="Calibration file of the plate, by testbed calibrate."),
    ] = None
    terms: Annotated[
        str | None,
        typer.Option(
            metavar="TERM,...|auto",
            help="Joint terms, e.g. coulomb,viscous,rotor/elbow; auto: by cross-validation.",
        ),
    ] = None
    leave_out: Annotated[
        list[str] | None,
        typer.Option(
            "--leave-out",
            metavar="CHANNEL",
            help="Leave a channel out, e.g. torque/elbow, or several by a pattern as "
            "torque/wrist_*; nothing: faulty samples count, too; repeatable.",
        ),
    ] = None
    unchecked: Annotated[
        bool,
        typer.Option(
            "--unchecked", help="Skip the plausibility check of imported recordings."
        ),
    ] = False
    threads: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Number of processes; default one per processor.",
            rich_help_panel=OUTPUT,
        ),
    ] = None
    sensors: Mapping[str, Any] = field(default_factory=dict)
    """Force sensors of the recording by name."""
    locked_file: Any = None
    """`ModelFile` with joints locked for a recording; None for the file of the options."""

    @property
    def model_words(self) -> list[str]:
        """Arguments --model (ROBOT without a model), --set, --lock and flags, as printable text."""
        arguments = [("--model", str(self.model or "ROBOT"))]
        arguments += [("--set", each) for each in self.settings or ()]
        arguments += [("--lock", each) for each in self.lock or ()]
        flags = {"--weld-root": self.weld_root, "--lock-mimic": self.lock_mimic}
        return [
            *(word for pair in arguments for word in pair),
            *(w for w, on in flags.items() if on),
        ]

    @property
    def known_zeros(self) -> bool | list[str]:
        """Parameters known to be zero: the names given by --zero, or the value of --zeros."""
        return self.zero or self.zeros

    @cached_property
    def tables(self) -> RecordingTables:
        """Tables [robot] and [identification] of --set; other options take precedence.

        Raises:
            ExperimentError: A setting of --set is invalid.
        """
        from testbed.lab.experiment.robot_tables import RecordingTables

        overrides = ["identification.zeros=true"] if self.zeros else []
        if self.terms is not None:
            terms = self.terms if self.terms == "auto" else self.terms.split(",")
            overrides.append(f"identification.terms={json.dumps(terms)}")
        if self.leave_out:
            overrides.append(f"identification.leave_out={json.dumps(self.leave_out)}")
        if self.sensor is not None:
            overrides.append(f"robot.sensor={json.dumps(self.sensor)}")
        return RecordingTables.from_overrides(
            [*(self.settings or ()), *overrides], self.sensors
        )

    @property
    def prior_error(self) -> float | None:
        """Relative error of the model file's bodies, if given by --set; otherwise None."""
        is_set = any(
            word.startswith("consistent.prior_error") for word in self.settings or ()
        )
        return self.tables.consistent.prior_error if is_set else None

    @property
    def estimator_arguments(self) -> dict[str, Any]:
        """Keyword arguments that all estimators share: gravity, settings, threads."""
        settings = self.tables.identification
        return {"gravity": self.gravity, "settings": settings, "threads": self.threads}

    def identify(
        self, source: Source, label: str = "identifying", method: Signal = "wrench"
    ) -> Estimate:
        """Identify the robot from a recording, with a progress display on the terminal.

        Args:
            source: The recording.
            label: Text of the progress bar.
            method: Signal to be fitted, "wrench" or "torque".
        """
        from testbed.core.estimation.identify import identify
        from testbed.view.output import Progress

        with Progress(label) as bar:
            return identify(
                self.tree,
                source,
                method,
                doubt=self.doubt,
                progress=bar,
                **self.estimator_arguments,
            )

    @cached_property
    def file(self) -> ModelFile:
        """Model file with the locked joints and the root; `locked_file` if this is set.

        The option --lock overrides [robot] of --set.

        Raises:
            ModelError: A joint to be locked is given twice, or is not a joint of the file.
        """
        from testbed.core.robot.locks import parse_lock
        from testbed.core.robot.model_file import ModelFile, joint_names, mimic_joints

        if isinstance(self.locked_file, ModelFile):
            return self.locked_file
        assert self.model is not None
        path = self.model
        locked = parse_lock(self.lock or (), lambda: joint_names(path))
        weld_root, lock_mimic, bodies = self.weld_root, self.lock_mimic, None
        if self.settings:  # without settings the slow import of tables is avoided
            robot_table = self.tables.robot
            locked, weld_root = (
                {**robot_table.lock, **locked},
                weld_root or robot_table.base == "measured",
            )
            lock_mimic, bodies = (
                lock_mimic or robot_table.lock_mimic,
                robot_table.replacement_inertias or None,
            )
        mimic = mimic_joints(path) if lock_mimic else ()
        return ModelFile(path, weld_root, bodies, dict.fromkeys(mimic) | locked)

    @cached_property
    def tree(self) -> Tree:
        """Robot with joints and shafts of --set; with --sensor, only links beyond the sensor."""
        if not self.settings and self.sensor is None:
            return self.file.tree()
        return self.tables.sensed_part(
            self.tables.robot.configured_robot(self.file.tree())
        )

    def prepare_source(self, recording: Source) -> Source:
        """Recording with the robot's joints, corrected for the plate's calibration."""
        from testbed.core.recordings.views import adapt_to_robot
        from testbed.view import output

        with output.Progress("reading"):
            return corrected_source(
                adapt_to_robot(recording, self.tree), self.tree, self.plate
            )

    @timed_stage("reading and plausibility")
    def open_joined(
        self, paths: Sequence[Path]
    ) -> tuple[ReadingOptions, Source, list[Diagnostic]]:
        """Open recordings as one source, and check each imported recording for plausibility.

        Args:
            paths: Recordings or mapping files.

        Returns:
            Options with resting joints locked; the joined source; diagnostics.

        Raises:
            RecordingError: A recording is implausible for this robot, or recordings differ in
                channels, or a recording is given twice.
        """
        from testbed.core.recordings.joined import joined
        from testbed.view import output

        require_different(paths)
        sources: list[Source] = []
        diagnostics: list[Diagnostic] = []
        reading = self
        for path in paths:
            with output.Progress("checking the recording against the robot"):
                reading, segments, segment_diagnostics = reading.open_segments(path)
            recording_name = path.name if len(paths) > 1 else ""
            diagnostics += [
                replace(each, recording=recording_name) if recording_name else each
                for each in segment_diagnostics
            ]
            sources += segments
        return reading.with_resting_joints_locked(joined(sources), diagnostics)

    def open_segments(
        self, path: Path
    ) -> tuple[ReadingOptions, list[Source], tuple[Diagnostic, ...]]:
        """Open a recording as segments between gaps, and check the longest segment.

        Args:
            path: Recording or mapping file.

        Returns:
            Options for this recording; its segments; diagnostics of the check.

        Raises:
            RecordingError: The recording is implausible for this robot.
        """
        from testbed.core.recordings.source import segment_sources

        reading, source = self.for_recording(open_recording(path))
        segments = [
            corrected_source(segment, reading.tree, self.plate)
            for segment in segment_sources(source)
        ]
        longest = max(segments, key=lambda each: each.samples)
        if len(segments) > 1:
            longest = longest.part(0, longest.samples)
        return reading, segments, reading.plausibility_diagnostics(longest)

    def for_recording(self, source: Source) -> tuple[ReadingOptions, Source]:
        """Adapt the options to a recording, and the recording to the robot.

        Joints given by --lock without a position are locked at their recorded mean, and their
        columns are left out. Joints missing in the recording are locked at rest. --gravity replaces
        the recorded gravity.

        Args:
            source: The recording.

        Returns:
            Options for this recording; the recording with the robot's joints.

        Raises:
            RecordingError: A joint given by --lock moves by more than 0.01 rad or m.
        """
        from testbed.core.recordings.held import hold_still
        from testbed.core.recordings.views import adapt_to_robot, transform_source

        if (gravity := self.gravity) is not None:

            def under_gravity(part: Recording) -> Recording:
                return replace(part, metadata=replace(part.metadata, gravity=gravity))

            source = transform_source(source, under_gravity)
        file, reduced, _ = hold_still(self.file, source, lock_only=True)
        reading = (
            replace(self, locked_file=file)
            .with_sensors(source)
            .with_welded_root(source)
        )
        return reading, adapt_to_robot(reduced, reading.tree)

    def robot_of(self, source: Source) -> tuple[Tree, Source]:
        """Robot for a recording, and the recording with this robot's joints."""
        reading, source = self.for_recording(source)
        return reading.tree, source

    def with_welded_root(self, source: Source) -> ReadingOptions:
        """Options with a floating root welded to the bedplate, unless a base pose was recorded.

        Args:
            source: The recording.

        Raises:
            FreeRootError: The root floats, and the recording has a base pose.
        """
        try:
            self.tree  # noqa: B018
        except FreeRootError:
            if "base" in source.signals:
                raise
            return replace(self, locked_file=replace(self.file, weld_root=True))
        return self

    def with_sensors(self, source: Source, *, alone: bool = False) -> ReadingOptions:
        """Options with the recording's force sensors; sensors in `sensors` take precedence.

        If the recording has neither plate wrench nor torques, a single sensor becomes the value of
        --sensor, unless that is given.

        Args:
            source: The recording.
            alone: True to add only the sensor of --sensor, so that all links beyond it are
                included.
        """
        sensor_places = source.metadata.sensors
        if "sensors" not in source.signals:
            return self
        sensor = self.sensor
        if (
            sensor is None
            and len(sensor_places) == 1
            and not {"wrench", "torque"} & {*source.signals}
        ):
            (sensor,) = sensor_places
        selected = {
            name: place
            for name, place in sensor_places.items()
            if not alone or name == self.sensor
        }
        return replace(self, sensors={**selected, **self.sensors}, sensor=sensor)

    def with_resting_joints_locked(
        self, source: Source, check_diagnostics: Sequence[Diagnostic] = ()
    ) -> tuple[ReadingOptions, Source, list[Diagnostic]]:
        """Lock joints that a recording lacks, or that move by less than `MIN_MOTION_RANGE` (1e-3).

        Recorded joints remain free if an encoder may have failed ("position.still" in the check),
        if the root floats, and if only the links beyond a force sensor are identified.

        Args:
            source: The recording.
            check_diagnostics: Diagnostics of the plausibility check.

        Returns:
            Options with locked joints; the recording without these; diagnostics.
        """
        from testbed.core.recordings.held import (
            lock_resting_joints,
            lock_unrecorded_joints,
        )

        other_diagnostics = [
            each for each in check_diagnostics if each.code != "position.held"
        ]
        has_doubtful_encoder = any(
            each.code == "position.still" for each in check_diagnostics
        )
        file, missing_diagnostics = lock_unrecorded_joints(self.file, source)
        reading = replace(self, locked_file=file).with_welded_root(source)
        if has_doubtful_encoder or reading.tree.floating or reading.tree.is_part:
            return reading, source, [*other_diagnostics, *missing_diagnostics]
        file, reduced, lock_diagnostics = lock_resting_joints(reading.file, source)
        return (
            replace(reading, locked_file=file),
            reduced,
            [*other_diagnostics, *missing_diagnostics, *lock_diagnostics],
        )

    def plausibility_diagnostics(self, source: Source) -> tuple[Diagnostic, ...]:
        """Diagnostics of the plausibility check of an imported recording.

        The result is empty for a recording without a mapping.

        Raises:
            RecordingError: The recording is implausible for this robot, with consequences for
                the estimate.
        """
        from testbed.view.output import Progress

        if source.metadata.mapping is None:
            return ()
        from testbed.importing.check.check import check_recording

        with Progress("searching for the cause") as bar:
            checked = check_recording(
                self.tree, source, unchecked=self.unchecked, progress=bar
            )
        return checked.diagnostics

    @property
    def doubt(self) -> CalibrationCovariance | None:
        """Covariance of the plate's calibrated coefficients; None without --plate."""
        from testbed.lab.experiment.plate_file import read_calibration

        return (
            None
            if self.plate is None
            else read_calibration(self.plate, self.tree).doubt
        )

    def prior_and_options(
        self, source: Source
    ) -> tuple[PriorBodies, ConsistencyOptions]:
        """Prior bodies from the model file, and the table [consistent] of --set.

        Args:
            source: The recording; its gear matrix defines the robot's motor shafts.
        """
        from testbed.bodies.prior import prior_of
        from testbed.core.recordings.views import with_gear_shafts

        return prior_of(with_gear_shafts(self.tree, source)), self.tables.consistent
