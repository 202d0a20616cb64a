"""Commands about recordings: identify, validate, and consistent bodies written to files."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from testbed.cli.opening import corrected_source, opened
from testbed.cli.options import (
    Everything,
    Fields,
    Force,
    Json,
    RobotModel,
    Timings,
    check_outputs,
    command,
)
from testbed.cli.reading import Reading
from testbed.core.base.diagnostics import diagnose

if TYPE_CHECKING:
    from testbed.applications.drives.identify_drives import DriveFindings
    from testbed.bodies.consistency.consistent import Consistent
    from testbed.core.base.diagnostics import Diagnostic
    from testbed.core.estimation.estimate import Method


ConsistentBodies = Annotated[
    bool,
    typer.Option(
        "--consistent",
        help="Also compute physically consistent bodies near the model file's.",
    ),
]
FixedLinks = Annotated[
    Literal["lump", "share"],
    typer.Option(
        "--fixed", help="With --write: lump the mass of fixed bodies, or share it."
    ),
]


@dataclass(frozen=True)
class Writing:
    """Options of consistent bodies and of the model file that holds them."""

    consistent: ConsistentBodies = False
    write: Annotated[
        Path | None,
        typer.Option(
            "--write",
            metavar="FILE",
            help="Write the model file with consistent bodies and friction.",
        ),
    ] = None
    fixed: FixedLinks = "lump"
    in_place: Annotated[
        bool,
        typer.Option("--in-place", help="Allow --write to replace the model file."),
    ] = False
    force: Force = False

    @property
    def wanted(self) -> bool:
        """Whether consistent bodies are to be made."""
        return self.consistent or self.write is not None

    def check(self, reading: Reading, recordings: Sequence[Path]) -> None:
        """Check, before the work, that the file may be written and conditions are of use.

        Args:
            reading: What is wished.
            recordings: What is identified, which is not replaced.

        Raises:
            ModelError: The file may not be written.
            SettingsError: Something is wished of bodies that nobody asked for.
        """
        from testbed.bodies.consistency.options import ConsistencyOptions
        from testbed.bodies.write_model import check_place
        from testbed.core.base.errors import SettingsError

        default = ConsistencyOptions()
        asked = replace(reading.tables.consistent, prior_error=default.prior_error)
        if not self.wanted and asked != default:
            raise SettingsError("--set consistent... needs --consistent")
        if self.in_place and self.write is None:
            raise SettingsError("--in-place needs --write FILE")
        if self.write is not None:
            model = reading.file.path
            check_place(model, self.write, over_source=self.in_place)
            own = self.in_place and self.write.resolve() == model.resolve()
            read = *recordings, reading.plate
            check_outputs(self.write, force=self.force or own, read=read)

    def written(
        self,
        found: Consistent,
        reading: Reading,
        recordings: Sequence[Path],
        drives: DriveFindings | None = None,
        delay: float = 0.0,
    ) -> tuple[Diagnostic, ...]:
        """Write the file that was asked for; diagnostics of bodies and file.

        Args:
            found: Consistent bodies.
            reading: How the model file is read.
            recordings: What it was identified from.
            drives: Their friction, rotors and torque constants are written, too.
            delay: Of their commands [s].

        Raises:
            ModelError: The file cannot be written.
        """
        from testbed.applications.drives.identify_drives import with_drives
        from testbed.bodies.consistency.consistent import robot_of
        from testbed.bodies.write_model import write_model
        from testbed.lab.experiment.results import provenance

        if self.write is None:
            return found.diagnostics
        robot = robot_of(found, reading.file.tree())
        return found.diagnostics + write_model(
            reading.file,
            robot if drives is None else with_drives(robot, drives),
            self.write,
            fixed=self.fixed,
            note=provenance(found, reading.file, recordings),
            over_source=self.in_place,
            gears=None if drives is None else drives.gears,
            delay=delay,
        )


@command()
def identify(
    recordings: Annotated[
        list[Path],
        typer.Argument(
            metavar="RECORDING...",
            help="Recordings (Parquet) or mapping files of one robot.",
        ),
    ],
    reading: Annotated[
        Reading,
        Fields(
            "settings",
            "zeros",
            "gravity",
            "sensor",
            "weld_root",
            "lock",
            "lock_mimic",
            "plate",
            "terms",
            "leave_out",
            "unchecked",
            "threads",
            model=RobotModel,
        ),
    ],
    writing: Annotated[
        Writing, Fields("consistent", "write", "fixed", "in_place", "force")
    ],
    method: Annotated[
        Literal["external", "internal", "both"],
        typer.Option(help="external: force plate, internal: joint torques."),
    ] = "both",
    plain: Annotated[
        bool,
        typer.Option(
            "--plain",
            help="Of an imported recording: least squares, without the model file as prior.",
        ),
    ] = False,
    timings: Timings = False,
    everything: Everything = False,
    as_json: Json = False,
) -> None:
    """Identify the base parameters from recordings, by force plate and by joint torques.

    Several recordings are combined into one estimate; they may be larger than memory. A method
    whose signal was not recorded is left out. Imported recordings are first checked against the
    model: signs, units, order, encoder zeros, clocks. Of parameters that they do not determine the
    model file's bodies are the prior, and what the data add is said.

    Example: testbed identify recording.parquet --model models/puma562.xml --zeros

    Example: testbed identify recording.parquet --model robot.urdf --write identified.urdf
    """
    from testbed.applications.analysis import analyse
    from testbed.core.base.errors import SettingsError
    from testbed.core.estimation.estimate import METHODS, NAMES, SIGNAL_OF
    from testbed.core.recordings.views import is_imported
    from testbed.core.robot.placeholders import placeholders
    from testbed.view import output, terminal

    writing.check(reading, recordings)
    reading, source, said = reading.joined(recordings)
    tree = reading.tree
    if reading.prior_error and not (writing.wanted or is_imported(source)):
        raise SettingsError(
            "--set consistent... needs --consistent, or an imported recording"
        )
    wanted = METHODS if method == "both" else (method,)
    there = [name for name in wanted if SIGNAL_OF[name] in source.signals]
    doubts = placeholders(tree).diagnostics if is_imported(source) else ()
    said = [*tree.diagnostics, *said, *doubts]
    if (
        everything or as_json
    ) and not tree.is_part:  # no fault: few recordings have both
        said += _unrecorded(name for name in wanted if name not in there)
    with output.Progress("identifying") as progress:
        found = analyse(
            tree,
            source,
            methods=there or wanted,  # the first says what lacks
            doubt=reading.doubt,
            prior_error=reading.prior_error,
            bodies=reading.bodies(source) if writing.wanted else None,
            progress=progress,
            **reading.arguments,
        )
    for name, error in found.failures.items():
        if plain or name not in found.posterior:
            raise error
        said.append(diagnose("estimate.missing", name, reason=error, name=NAMES[name]))
    if found.bodies_failure is not None:
        raise found.bodies_failure
    if found.bodies is not None:
        said += writing.written(found.bodies, reading, recordings)
    estimates, posteriors = (
        list(found.estimates.values()),
        list(found.posterior.values()),
    )
    if as_json:
        from testbed.lab.experiment.results import identified

        result = identified(
            estimates,
            reading.file,
            reading.tables,
            said,
            found.bodies,
            found.posterior,
            plain=plain,
        )
        output.print_json(result.document())
        return
    terminal.print_estimates(
        estimates,
        said,
        found.bodies,
        posteriors=posteriors,
        plain=plain,
        everything=everything,
    )
    if writing.write is not None:
        output.print_result(lines=[f"model file: {writing.write}"])


def _unrecorded(methods: Iterable[Method]) -> list[Diagnostic]:
    """Methods whose signal the recording lacks."""
    from testbed.core.estimation.estimate import NAMES, SIGNAL_OF

    return [
        diagnose("estimate.no-signal", m, signal=SIGNAL_OF[m], name=NAMES[m])
        for m in methods
    ]


@command()
def validate(
    recording: Annotated[
        Path,
        typer.Argument(
            metavar="RECORDING", help="Recording of another motion (Parquet)."
        ),
    ],
    result: Annotated[
        Path,
        typer.Argument(
            metavar="RESULT.json", help="Output of identify --json, or a run folder."
        ),
    ],
    reading: Annotated[
        Reading, Fields("model", "gravity", "settings", "plate", "threads")
    ],
    as_json: Json = False,
) -> None:
    """Hold estimates against a recording of a motion that they have not seen.

    Residuals stand beside the noise that the estimate found in its own recording and what the
    parameters' sigma adds; above twice what both make together there is a warning.

    Example: testbed validate other.parquet runs/table6-286a25ef
    """
    from testbed.applications.validate import validate as validated
    from testbed.core.base.codec import encode
    from testbed.core.base.errors import RecordingError
    from testbed.core.estimation.estimate import SIGNAL_OF
    from testbed.lab.experiment.read_result import read_result
    from testbed.view import output
    from testbed.view.posterior import validation_table

    kept = read_result(result, reading.model, reading.settings or ())
    source = corrected_source(
        kept.without_held(opened(recording)), kept.tree, reading.plate
    )
    there = [a for a in kept.answers if SIGNAL_OF[a.estimate.method] in source.signals]
    said = _unrecorded(a.estimate.method for a in kept.answers if a not in there)
    if not there:
        raise RecordingError("; ".join(map(str, said)))
    found = {}
    for answer in there:
        method = answer.estimate.method
        with output.Progress(f"validating, {method}") as progress:
            found[method] = validated(
                kept.tree,
                source,
                answer.estimate,
                gravity=reading.gravity,
                settings=kept.settings,
                threads=reading.threads,
                progress=progress,
                models=answer.models,
                held=answer.held,
            )
    if as_json:
        output.print_json({method: encode(each) for method, each in found.items()})
    else:
        said += [
            each for validation in found.values() for each in validation.diagnostics
        ]
        output.print_result(map(validation_table, found.values()), (), said)


@command()
def sample(
    result: Annotated[
        Path,
        typer.Argument(
            metavar="RESULT.json", help="Output of identify --json, or a run folder."
        ),
    ],
    out: Annotated[
        Path, typer.Option(help="New folder for model files and robots.npz.")
    ],
    *,
    count: Annotated[
        int, typer.Option("-n", min=1, max=100_000, help="How many robots.")
    ] = 100,
    seed: Annotated[int, typer.Option(min=0, help="Of the draws.")] = 0,
    reading: Annotated[Reading, Fields("model", "settings")],
    fixed: FixedLinks = "lump",
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Draw robots that could be the one that was measured, as model files and MuJoCo's fields.

    Draws are joint: of the estimates' covariance, and of the model file (wrong by
    consistent.prior_error) where data do not determine a parameter. Each is a robot that can exist.
    The table says of each parameter how much of it is the data's.

    Example: testbed sample identified.json -n 1000 --out robots
    """
    import numpy as np

    from testbed.bodies.consistency.robots import robots
    from testbed.bodies.prior import prior_of
    from testbed.bodies.write_model import ARCHIVE, write_models
    from testbed.core.base.codec import encode
    from testbed.core.base.errors import SettingsError
    from testbed.core.base.installation import versions
    from testbed.lab.experiment.read_result import read_result
    from testbed.view import output
    from testbed.view.bodies import draws_table

    check_outputs(out, force=True, folder=True, read=(result, reading.model))
    kept = read_result(result, reading.model, reading.settings or ())
    if kept.tree.is_part:
        raise SettingsError(
            f"'{result}' is of a force sensor: robots need plate or joint torques"
        )
    others = {each.name for each in out.iterdir()} if out.exists() else set()
    stem = f"{kept.file.path.stem}_"
    if others := {name for name in others - {ARCHIVE} if not name.startswith(stem)}:
        raise SettingsError(
            f"'{out}' holds {min(others)}, not robots alone: --out names a new folder"
        )
    check_outputs(out, force=force, folder=True)
    prior = prior_of(kept.prior)
    rng = np.random.default_rng(seed)
    with output.Progress("drawing robots"):
        found = robots(kept.tree, kept.whole_estimates, prior, count, rng, kept.options)
    note = [f"testbed {versions()['testbed']}: a draw by {result.name}, seed {seed}"]
    file = kept.file.tree()
    with output.Progress("writing model files"):
        trees = [found.tree(k, file) for k in range(count)]
        said = write_models(kept.file, trees, out, fixed=fixed, note=note)
    if as_json:
        output.print_json(encode(found, exclude={"values"}))
    else:
        written = [f"{count} robots: {out}"]
        output.print_result([draws_table(found)], written, [*prior.diagnostics, *said])
