"""How commands about recordings read the robot and treat the signals."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from testbed.cli.opening import corrected_source, opened, require_different
from testbed.cli.options import OUTPUT, ROBOT, Gravity
from testbed.core.base.diagnostics import Diagnostic
from testbed.core.base.installation import own_or_shipped
from testbed.core.base.stages import stage
from testbed.core.robot.refusals import FreeRootError

if TYPE_CHECKING:
    from testbed.bodies.consistency.options import ConsistencyOptions
    from testbed.bodies.prior import Prior
    from testbed.core.estimation.estimate import Estimate, Method
    from testbed.core.estimation.sensor.correction import CalibrationCovariance
    from testbed.core.recordings.recording import Recording
    from testbed.core.recordings.source import Source
    from testbed.core.robot.model_file import ModelFile
    from testbed.core.robot.tree import Tree
    from testbed.lab.experiment.robot_tables import RecordingTables


@dataclass(frozen=True)
class Reading:
    """Options by which a robot and its recordings are read."""

    model: Annotated[
        Path | None,
        typer.Option(
            "--model",
            metavar="PATH",
            parser=own_or_shipped,
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
        typer.Option(min=1, help="Default: one per processor.", rich_help_panel=OUTPUT),
    ] = None
    sensors: Mapping[str, Any] = field(default_factory=dict)
    """Force sensors of the recording, by name."""
    resolved: Any = None
    """The `ModelFile` with joints held for a recording; default as the options say."""

    @property
    def model_words(self) -> list[str]:
        """Words of the command that name the model and how it is read."""
        said = [("--model", str(self.model or "ROBOT"))]
        said += [("--set", each) for each in self.settings or ()]
        said += [("--lock", each) for each in self.lock or ()]
        flags = {"--weld-root": self.weld_root, "--lock-mimic": self.lock_mimic}
        return [
            *(word for pair in said for word in pair),
            *(w for w, on in flags.items() if on),
        ]

    @property
    def known_zeros(self) -> bool | list[str]:
        """Parameters that are known to be zero: those named, or the model file's, or none."""
        return self.zero or self.zeros

    @cached_property
    def tables(self) -> RecordingTables:
        """Settings of robot and identification.

        Raises:
            ExperimentError: --set says what is not understood.
        """
        from testbed.lab.experiment.robot_tables import RecordingTables

        said = ["identification.zeros=true"] if self.zeros else []
        if self.terms is not None:
            listed = self.terms if self.terms == "auto" else self.terms.split(",")
            said.append(f"identification.terms={json.dumps(listed)}")
        if self.leave_out:
            said.append(f"identification.leave_out={json.dumps(self.leave_out)}")
        if self.sensor is not None:
            said.append(f"robot.sensor={json.dumps(self.sensor)}")
        return RecordingTables.of([*(self.settings or ()), *said], self.sensors)

    @property
    def prior_error(self) -> float | None:
        """Relative error of the model file's bodies, where it is given."""
        said = any(
            word.startswith("consistent.prior_error") for word in self.settings or ()
        )
        return self.tables.consistent.prior_error if said else None

    @property
    def arguments(self) -> dict[str, Any]:
        """Keyword arguments that all estimators take."""
        settings = self.tables.identification
        return {"gravity": self.gravity, "settings": settings, "threads": self.threads}

    def identify(
        self, source: Source, label: str = "identifying", method: Method = "external"
    ) -> Estimate:
        """Identify the robot from a recording, with progress on the terminal.

        Args:
            source: The recording.
            label: Name of the work.
            method: By which signals.
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
                **self.arguments,
            )

    @cached_property
    def file(self) -> ModelFile:
        """The model file, and how to read it.

        Raises:
            ModelError: A joint to be held is given twice, or is no joint of the file.
        """
        from testbed.core.robot.locks import parse_lock
        from testbed.core.robot.model_file import ModelFile, joint_names, mimic_joints

        if isinstance(self.resolved, ModelFile):
            return self.resolved
        assert self.model is not None
        path = self.model
        held = parse_lock(self.lock or (), lambda: joint_names(path))
        welded, follow, bodies = self.weld_root, self.lock_mimic, None
        if self.settings:  # else there is no need to import the tables of experiments
            said = self.tables.robot
            held, welded = {**said.lock, **held}, welded or said.base == "measured"
            follow, bodies = follow or said.lock_mimic, said.bodies or None
        mimic = mimic_joints(path) if follow else ()
        return ModelFile(path, welded, bodies, dict.fromkeys(mimic) | held)

    @cached_property
    def tree(self) -> Tree:
        """The robot of the model file, with what --set says of its joints and shafts."""
        if not self.settings and self.sensor is None:
            return self.file.tree()
        return self.tables.sensed(self.tables.robot.on(self.file.tree()))

    def source(self, recording: Source) -> Source:
        """A recording, as a perfect plate would have made it where the plate is known."""
        from testbed.core.recordings.views import on_its_base
        from testbed.view import output

        with output.Progress("reading"):
            return corrected_source(
                on_its_base(recording, self.tree), self.tree, self.plate
            )

    @stage("reading and plausibility")
    def joined(self, paths: Sequence[Path]) -> tuple[Reading, Source, list[Diagnostic]]:
        """Recordings as one source, each held against the robot, and what to doubt of them.

        Returns:
            How the model is read, with joints held that do not move; the source; doubts.

        Raises:
            RecordingError: One of them cannot be true of this robot, or they are not alike.
        """
        from testbed.core.recordings.joined import joined
        from testbed.view import output

        require_different(paths)
        sources: list[Source] = []
        said: list[Diagnostic] = []
        reading = self
        for path in paths:
            with output.Progress("checking the recording against the robot"):
                reading, segments, own = reading.segments(path)
            named = path.name if len(paths) > 1 else ""
            said += [replace(each, recording=named) if named else each for each in own]
            sources += segments
        return reading.holding(joined(sources), said)

    def segments(
        self, path: Path
    ) -> tuple[Reading, list[Source], tuple[Diagnostic, ...]]:
        """Segments of a recording, the longest held against the robot, and what to doubt of it.

        Raises:
            RecordingError: It cannot be true of this robot.
        """
        from testbed.core.recordings.source import by_segments

        reading, source = self.of_recording(opened(path))
        segments = [
            corrected_source(segment, reading.tree, self.plate)
            for segment in by_segments(source)
        ]
        longest = max(segments, key=lambda each: each.samples)
        if len(segments) > 1:
            longest = longest.part(0, longest.samples)
        return reading, segments, reading.accepted(longest)

    def of_recording(self, source: Source) -> tuple[Reading, Source]:
        """How the model is read for a recording, and the recording as its robot's.

        Joints of --lock are held where the recording has them; their columns are left out.

        Raises:
            RecordingError: The recording moves a joint of --lock.
        """
        from testbed.core.recordings.held import hold_still
        from testbed.core.recordings.views import on_its_base, transformed

        if (gravity := self.gravity) is not None:

            def under_gravity(part: Recording) -> Recording:
                return replace(part, metadata=replace(part.metadata, gravity=gravity))

            source = transformed(source, under_gravity)
        file, fewer, _ = hold_still(self.file, source, lock_only=True)
        reading = replace(self, resolved=file).with_sensors(source).on_its_root(source)
        return reading, on_its_base(fewer, reading.tree)

    def robot_of(self, source: Source) -> tuple[Tree, Source]:
        """The robot of a recording, and the recording as its robot's."""
        reading, source = self.of_recording(source)
        return reading.tree, source

    def on_its_root(self, source: Source) -> Reading:
        """The same; a floating root is welded where no base pose was recorded.

        Args:
            source: The recording.

        Raises:
            FreeRootError: The root floats, and the recording has its pose.
        """
        try:
            self.tree  # noqa: B018
        except FreeRootError:
            if "base" in source.signals:
                raise
            return replace(self, resolved=replace(self.file, weld_root=True))
        return self

    def with_sensors(self, source: Source, *, alone: bool = False) -> Reading:
        """The same with the force sensors that a recording has, where --set says nothing of them.

        The only one is meant where there is neither plate nor torque.

        Args:
            source: The recording.
            alone: Only the one of --sensor: with all that it carries.
        """
        places = source.metadata.sensors
        if "sensors" not in source.signals:
            return self
        sensor = self.sensor
        if (
            sensor is None
            and len(places) == 1
            and not {"wrench", "torque"} & {*source.signals}
        ):
            (sensor,) = places
        meant = {
            name: place
            for name, place in places.items()
            if not alone or name == self.sensor
        }
        return replace(self, sensors={**meant, **self.sensors}, sensor=sensor)

    def holding(
        self, source: Source, said: Sequence[Diagnostic] = ()
    ) -> tuple[Reading, Source, list[Diagnostic]]:
        """The same with joints held that do not move, unless their encoders are doubted.

        Args:
            source: The recording.
            said: What its check has said.
        """
        from testbed.core.recordings.held import hold_resting, lock_unrecorded

        kept = [each for each in said if each.code != "position.held"]
        doubted = any(each.code == "position.still" for each in said)
        file, locked = lock_unrecorded(self.file, source)
        reading = replace(self, resolved=file).on_its_root(source)
        if doubted or reading.tree.floating or reading.tree.is_part:
            return reading, source, [*kept, *locked]
        file, fewer, held = hold_resting(reading.file, source)
        return replace(reading, resolved=file), fewer, [*kept, *locked, *held]

    def accepted(self, source: Source) -> tuple[Diagnostic, ...]:
        """What to doubt of an imported recording; nothing is said of others.

        Raises:
            RecordingError: It cannot be true of this robot, and that matters.
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
        """What the plate's calibration leaves open; None where the plate is taken as perfect."""
        from testbed.lab.experiment.plate_file import read_plate

        return None if self.plate is None else read_plate(self.plate, self.tree).doubt

    def bodies(self, source: Source) -> tuple[Prior, ConsistencyOptions]:
        """Prior and conditions of consistent bodies for a recording.

        Args:
            source: The recording.
        """
        from testbed.bodies.prior import prior_of
        from testbed.core.recordings.views import with_gear

        return prior_of(with_gear(self.tree, source)), self.tables.consistent
