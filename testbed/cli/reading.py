"""How commands about recordings read the robot and treat the signals: options that they share."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from testbed.cli.opening import corrected_source, opened_pieces, require_different
from testbed.core.base.diagnostics import Diagnostic
from testbed.core.base.errors import printable
from testbed.core.base.installation import own_or_shipped
from testbed.core.base.stages import stage
from testbed.core.robot.refusals import FreeRootError

if TYPE_CHECKING:
    from testbed.core.estimation.sensor.correction import CalibrationCovariance
    from testbed.core.recordings.source import Source
    from testbed.core.robot.model_file import ModelFile
    from testbed.core.robot.tree import Tree
    from testbed.lab.experiment.robot_tables import RecordingTables


def ending(*endings: str) -> Callable[[Path | None], Path | None]:
    """A check of the name of a file to write: it says what will be in it.

    Args:
        endings: That the file may have, as ".html".
    """

    def checked(path: Path | None) -> Path | None:
        if path is not None and path.suffix.lower() not in endings:
            raise typer.BadParameter(f"'{path}': it is written as {' or '.join(endings)}")
        return path

    return checked


def check_outputs(
    *paths: Path | None, force: bool, folder: bool = False, read: Iterable[Path | None] = ()
) -> None:
    """Check, before the work, that a command may write its outputs.

    Args:
        paths: Files to write; None for nothing.
        force: Whether what stands there is replaced.
        folder: Whether they are folders.
        read: Files that are read, and never replaced; None for nothing.

    Raises:
        BadParameter: Something stands there.
        OSError: As `check_writable`.
    """
    from testbed.core.base.files import check_writable

    check_writable(*paths, folder=folder, read=read)
    for path in paths:
        if path is not None and not force and path.exists() and (not folder or any(path.iterdir())):
            raise typer.BadParameter(
                f"'{path}' is there and is not replaced; choose another name, or say --force"
            )


class Vector(NamedTuple):
    """Three numbers with commas between them, as 0,0,-9.81."""

    x: float
    y: float
    z: float

    def __repr__(self) -> str:
        return f"{self.x:g} {self.y:g} {self.z:g}"

    @staticmethod
    def parse(word: str) -> Vector:
        """The numbers of a word."""
        try:
            x, y, z = map(float, word.split(","))
        except ValueError:
            raise typer.BadParameter(f"'{word}' is no vector; write it as 0,0,-9.81") from None
        return Vector(x, y, z)


def joined_vectors(words: list[str]) -> list[str]:
    """The command line's words, with `--gravity 0 0 -9.81` written as `--gravity 0,0,-9.81`."""
    found = list(words)
    for k, word in enumerate(words):
        if word == "--gravity" and len(words) > k + 3 and "," not in words[k + 1]:
            found[k + 1 : k + 4] = [",".join(words[k + 1 : k + 4])]
    return found


OUTPUT, ROBOT = "Output and speed", "Robot"
"""Groups of options in a command's help, after the common ones."""

app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode="markdown",  # paragraphs flow, words in [brackets] are words
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
    help="Identify the inertial parameters of a robot from joint torques or from a force plate "
    "under its base, simulated or real.",
)


def _version(wanted: bool) -> None:
    """Print the version and stop."""
    if wanted:
        from testbed.core.base.installation import version

        typer.echo(f"testbed {version()}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    del version  # its callback has done it


Json = Annotated[bool, typer.Option("--json", help="Print JSON.", rich_help_panel=OUTPUT)]
Everything = Annotated[
    bool,
    typer.Option(
        "--all", help="Print all parameters, warnings and residuals.", rich_help_panel=OUTPUT
    ),
]


def _timed(context: typer.Context, wanted: bool) -> bool:
    if wanted:
        from testbed.view.output import printed_stages

        context.with_resource(printed_stages())
    return wanted


Timings = Annotated[
    bool,
    typer.Option(
        "--timings",
        callback=_timed,
        help="Print the CPU time of each stage.",
        rich_help_panel=OUTPUT,
    ),
]
Set = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="KEY=VALUE", help="Set a key, e.g. motion.duration=20; repeatable."
    ),
]
RecordingSet = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="KEY=VALUE", help="Set a key, e.g. identification.cutoff=8; repeatable."
    ),
]
Terms = Annotated[
    str | None,
    typer.Option(
        metavar="TERM,...|auto",
        help="Joint terms, e.g. coulomb,viscous,rotor/elbow; auto: by cross-validation.",
    ),
]
Weld = Annotated[
    bool,
    typer.Option(
        "--weld-root", help="Weld a floating root to the bedplate.", rich_help_panel=ROBOT
    ),
]
Lock = Annotated[
    list[str] | None,
    typer.Option(
        "--lock",
        metavar="JOINT[=q]",
        help="Fix a joint at q [rad or m], default as recorded, or at rest; a pattern as arm_*, or "
        "!arm_* for all others; repeatable.",
        rich_help_panel=ROBOT,
    ),
]
Sensor = Annotated[
    str | None,
    typer.Option(
        "--sensor",
        metavar="NAME|LINK",
        help="Use the wrench of this force sensor, or of the one that carries this link; plate: of "
        "the force plate, without what lies beyond the sensors.",
        rich_help_panel=ROBOT,
    ),
]
LockMimic = Annotated[
    bool,
    typer.Option("--lock-mimic", help="Fix all joints that follow others.", rich_help_panel=ROBOT),
]
Unchecked = Annotated[
    bool,
    typer.Option("--unchecked", help="Skip the plausibility check of imported recordings."),
]
Plate = Annotated[
    Path | None, typer.Option(help="Calibration file of the plate, by testbed calibrate.")
]
Zeros = Annotated[
    bool,
    typer.Option("--zeros", help="Fix to zero all parameters that are zero in the model file."),
]
Zero = Annotated[
    list[str] | None,
    typer.Option("--zero", metavar="NAME", help="Fix a parameter to zero, e.g. mb1x; repeatable."),
]
Gravity = Annotated[
    Vector | None,
    typer.Option(
        metavar="X,Y,Z",
        parser=Vector.parse,
        help="Gravity [m/s^2]; default from the recording or the model file.",
        rich_help_panel=ROBOT,
    ),
]
Threads = Annotated[
    int | None, typer.Option(min=1, help="Default: one per processor.", rich_help_panel=OUTPUT)
]
Force = Annotated[
    bool,
    typer.Option("--force", help="Replace files that are there.", rich_help_panel=OUTPUT),
]
Model = Annotated[
    Path, typer.Argument(metavar="MODEL", parser=own_or_shipped, help="MJCF or URDF file.")
]
RobotModel = Annotated[
    Path,
    typer.Option(
        "--model", metavar="PATH", parser=own_or_shipped, help="MJCF or URDF file of the robot."
    ),
]
OtherModel = Annotated[
    Path | None,
    typer.Option(
        "--model",
        metavar="PATH",
        parser=own_or_shipped,
        help="MJCF or URDF file of the robot; runs and results have their own.",
    ),
]
ExperimentFile = Annotated[
    Path,
    typer.Argument(
        metavar="FILE.toml",
        parser=own_or_shipped,
        help="Experiment file, or the name of a shipped one.",
    ),
]


def note(lines: Iterable[str]) -> None:
    """Say on standard error what a person should know, a line each."""
    for line in lines:
        typer.echo(printable(f"note: {line}"), err=True)


@dataclass(frozen=True)
class Reading:
    """What was said of a recording's robot and treatment.

    Attributes:
        settings: Words of --set.
        zeros: Whether --zeros was given.
        weld_root: Whether --weld-root was given.
        lock: Words of --lock.
        lock_mimic: Whether --lock-mimic was given.
        plate: The file of --plate.
        terms: The word of --terms.
        sensor: The word of --sensor.
    """

    settings: Sequence[str] | None = None
    zeros: bool = False
    weld_root: bool = False
    lock: Sequence[str] | None = None
    lock_mimic: bool = False
    plate: Path | None = None
    terms: str | None = None
    sensor: str | None = None

    @property
    def model_words(self) -> list[str]:
        """Words of the command by which the model is read."""
        said = [*(("--set", each) for each in self.settings or ())]
        said += [("--lock", each) for each in self.lock or ()]
        flags = {"--weld-root": self.weld_root, "--lock-mimic": self.lock_mimic}
        return [*(word for pair in said for word in pair), *(w for w, on in flags.items() if on)]

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
        if self.sensor is not None:
            said.append(f"robot.sensor={json.dumps(self.sensor)}")
        return RecordingTables.of([*(self.settings or ()), *said])

    @property
    def prior_error(self) -> float | None:
        """Of the model file's bodies, where it is given."""
        said = any(word.startswith("consistent.prior_error") for word in self.settings or ())
        return self.tables().consistent.prior_error if said else None

    def model_file(self, path: Path) -> ModelFile:
        """A model file, and how to read it."""
        from testbed.core.robot.locks import parse_lock
        from testbed.core.robot.model_file import ModelFile, joint_names, mimic_joints

        held = parse_lock(self.lock or (), lambda: joint_names(path))
        welded, follow, bodies = self.weld_root, self.lock_mimic, None
        if self.settings:  # else there is no need to import the tables of experiments
            said = self.tables().robot
            held, welded = {**said.lock, **held}, welded or said.base == "measured"
            follow, bodies = follow or said.lock_mimic, said.bodies or None
        mimic = mimic_joints(path) if follow else ()
        return ModelFile(path, welded, bodies, dict.fromkeys(mimic) | held)

    def source(self, recording: Source, tree: Tree) -> Source:
        """A recording, as a perfect plate would have made it where the plate is known."""
        from testbed.core.recordings.views import on_its_base
        from testbed.view import output

        with output.Progress("reading"):
            return corrected_source(on_its_base(recording, tree), tree, self.plate)

    @stage("reading and plausibility")
    def joined(
        self, paths: Sequence[Path], model: Path, *, unchecked: bool
    ) -> tuple[Reading, Source, list[Diagnostic]]:
        """Recordings as one source, each held against the robot, and what to doubt of them.

        Of one that is cut where a source was silent, the longest piece is.

        Returns:
            How the model is read, with joints held that do not move; the source; doubts.

        Raises:
            RecordingError: One of them cannot be true of this robot, or they are not alike.
        """
        from testbed.core.recordings.joined import joined
        from testbed.view import output

        require_different(paths)
        several = len(paths) > 1
        sources: list[Source] = []
        said: list[Diagnostic] = []
        reading = self
        for path in paths:
            with output.Progress("checking the recording against the robot"):
                pieces, cuts = opened_pieces(path)
                made = []
                for piece in pieces:
                    reading, tree, source = reading.robot_of(piece, model)
                    made.append(corrected_source(source, tree, self.plate))
                longest = max(made, key=lambda source: source.samples)
                own = [*cuts, *self.accepted(longest, tree, unchecked=unchecked)]
            said += [replace(each, recording=path.name) for each in own] if several else own
            sources += made
        return reading.holding(joined(sources), model, said)

    def robot_of(self, source: Source, model: Path) -> tuple[Reading, Tree, Source]:
        """How the model is read for a recording, the robot, and the recording as its.

        Joints of --lock are held where the recording has them; their columns are left out.

        Raises:
            RecordingError: The recording moves a joint of --lock.
        """
        from testbed.core.recordings.held import hold_still
        from testbed.core.recordings.views import on_its_base

        given = self.model_file(model)
        file, fewer, _ = hold_still(given, source, lock_only=True)
        reading = (self if file.lock == given.lock else self.with_lock(file)).with_sensors(source)
        reading, tree = reading.on_its_root(source, model)
        return reading, tree, on_its_base(fewer, tree)

    def on_its_root(self, source: Source, model: Path) -> tuple[Reading, Tree]:
        """Reading and robot; a floating root is welded where no base pose was recorded.

        Args:
            source: The recording.
            model: The model file.

        Raises:
            FreeRootError: The root floats, and the recording has its pose.
        """
        try:
            return self, self.tree(model)
        except FreeRootError:
            if "base" in source.signals:
                raise
        reading = replace(self, weld_root=True)
        return reading, reading.tree(model)

    def with_sensors(self, source: Source, *, alone: bool = False) -> Reading:
        """The same with the force sensors that a recording has, where --set says nothing of them.

        The only one is meant where there is neither plate nor torque.

        Args:
            source: The recording.
            alone: Only the one of --sensor: with all that it carries.
        """
        places, said = source.facts.get("sensors"), list(self.settings or ())
        if not isinstance(places, Mapping) or "sensors" not in source.signals:
            return self
        for name, place in places.items():
            if alone and name != self.sensor:
                continue
            key = f"sensors.{name}" if name.isidentifier() else f"sensors.{json.dumps(name)}"
            if not any(word.startswith(f"{key}.") for word in said):
                said += [f"{key}.{what}={json.dumps(value)}" for what, value in place.items()]
        sensor = self.sensor
        if sensor is None and len(places) == 1 and not {"wrench", "torque"} & {*source.signals}:
            (sensor,) = places
        return replace(self, settings=said, sensor=sensor)

    def holding(
        self, source: Source, model: Path, said: Sequence[Diagnostic]
    ) -> tuple[Reading, Source, list[Diagnostic]]:
        """The same with joints held that do not move, unless their encoders are doubted.

        Args:
            source: The recording.
            model: The model file.
            said: What its check has said.
        """
        from testbed.core.recordings.held import hold_resting, lock_unrecorded

        kept = [each for each in said if each.code != "position.held"]
        doubted = any(each.code == "position.still" for each in said)
        file, locked = lock_unrecorded(self.model_file(model), source)
        reading = self.with_lock(file) if locked else self
        reading, tree = reading.on_its_root(source, model)
        if doubted or tree.floating or tree.is_part:
            return reading, source, [*kept, *locked]
        file, fewer, held = hold_resting(replace(file, weld_root=reading.weld_root), source)
        reading = reading if fewer is source else reading.with_lock(file)
        return reading, fewer, [*kept, *locked, *held]

    def with_lock(self, file: ModelFile) -> Reading:
        """The same with the joints held that a model file's lock names."""
        words = [name if q is None else f"{name}={float(q)!r}" for name, q in file.lock.items()]
        return replace(self, lock=words)

    def accepted(self, source: Source, tree: Tree, *, unchecked: bool) -> tuple[Diagnostic, ...]:
        """What to doubt of an imported recording; nothing is said of others.

        Raises:
            RecordingError: It cannot be true of this robot, and that matters.
        """
        from testbed.view.output import Progress

        if "mapping" not in source.facts:
            return ()
        from testbed.importing.check.check import check_recording

        with Progress("searching for the cause") as bar:
            return check_recording(tree, source, unchecked=unchecked, progress=bar).diagnostics

    def doubt(self, tree: Tree) -> CalibrationCovariance | None:
        """What the plate's calibration leaves open; None where the plate is taken as perfect."""
        from testbed.lab.experiment.plate_file import read_plate

        return None if self.plate is None else read_plate(self.plate, tree).doubt

    def tree(self, path: Path) -> Tree:
        """The robot of a model file, with what --set says of its joints and shafts."""
        file = self.model_file(path)
        if not self.settings and self.sensor is None:
            return file.tree()
        tables = self.tables()
        return tables.sensed(tables.robot.on(file.tree()), file)
