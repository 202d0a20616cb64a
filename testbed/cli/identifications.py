"""Commands that estimate parameters from recordings: identify, validate, sample."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from testbed.cli.opening import corrected_source, open_recording
from testbed.cli.options import (
    Everything,
    Force,
    Json,
    OptionFields,
    RobotModel,
    Timings,
    check_outputs,
    command,
)
from testbed.cli.reading import ReadingOptions
from testbed.core.base.diagnostics import make_diagnostic
from testbed.core.parameters.rules import SIGNALS, Signal

if TYPE_CHECKING:
    from testbed.applications.drives.identify_drives import DriveIdentification
    from testbed.bodies.consistency.consistent import Consistent
    from testbed.core.base.diagnostics import Diagnostic


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
class BodyOptions:
    """Options for consistent bodies, and for a model file with these bodies.

    Attributes:
        consistent: True to compute physically consistent bodies.
        write: Model file to write; None for no file.
        fixed: Treatment of links that are fixed to each other in the written file: "lump" assigns
            their mass to one link, "share" distributes it among them.
        in_place: True if `write` may be the model file itself.
        force: True if an existing file may be replaced.
    """

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
    def computes_bodies(self) -> bool:
        """True if consistent bodies are to be computed."""
        return self.consistent or self.write is not None

    def check(self, reading: ReadingOptions, recordings: Sequence[Path]) -> None:
        """Check the options for bodies and the output of --write before the estimation.

        Args:
            reading: Options of model file and recordings.
            recordings: Recordings, which must not be overwritten.

        Raises:
            ModelError: The file has the wrong extension, or is the model file without --in-place.
            BadParameter: The file exists and --force is not given.
            SettingsError: A setting of [consistent] other than prior_error is given without
                --consistent or --write, or --in-place without --write.
        """
        from testbed.bodies.consistency.options import ConsistencyOptions
        from testbed.bodies.write_model import check_copy_path
        from testbed.core.base.errors import SettingsError

        default = ConsistencyOptions()
        options = replace(reading.tables.consistent, prior_error=default.prior_error)
        if not self.computes_bodies and options != default:
            raise SettingsError("--set consistent... needs --consistent")
        if self.in_place and self.write is None:
            raise SettingsError("--in-place needs --write FILE")
        if self.write is not None:
            model = reading.file.path
            check_copy_path(model, self.write, over_source=self.in_place)
            replaces_model = self.in_place and self.write.resolve() == model.resolve()
            read = *recordings, reading.plate
            check_outputs(self.write, force=self.force or replaces_model, read=read)

    def write_bodies(
        self,
        bodies: Consistent,
        reading: ReadingOptions,
        recordings: Sequence[Path],
        drives: DriveIdentification | None = None,
        delay: float = 0.0,
    ) -> tuple[Diagnostic, ...]:
        """Write a copy of the model file with consistent bodies to the path of --write.

        Nothing is written without --write. A comment in the copy lists recordings and methods.

        Args:
            bodies: Consistent bodies.
            reading: Options of the model file.
            recordings: Recordings used for the estimate, for the comment.
            drives: Drives whose friction, rotors and torque constants are also written.
            delay: Delay of the drives behind their commands [s], for the motors of an MJCF file.

        Returns:
            Diagnostics of the bodies, followed by those of the written file.

        Raises:
            ModelError: The file cannot be written.
        """
        from testbed.applications.drives.identify_drives import with_identified_drives
        from testbed.bodies.consistency.consistent import robot_of
        from testbed.bodies.write_model import write_model
        from testbed.lab.experiment.results import provenance_lines

        if self.write is None:
            return bodies.diagnostics
        robot = robot_of(bodies, reading.file.tree())
        return bodies.diagnostics + write_model(
            reading.file,
            robot if drives is None else with_identified_drives(robot, drives),
            self.write,
            fixed=self.fixed,
            note=provenance_lines(bodies, reading.file, recordings),
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
        ReadingOptions,
        OptionFields(
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
        BodyOptions, OptionFields("consistent", "write", "fixed", "in_place", "force")
    ],
    method: Annotated[
        Literal["wrench", "torque", "both"],
        typer.Option(help="wrench: force plate, torque: joint torques."),
    ] = "both",
    plain: Annotated[
        bool,
        typer.Option(
            "--plain",
            help="Least squares for an imported recording, without the model file as prior.",
        ),
    ] = False,
    timings: Timings = False,
    everything: Everything = False,
    as_json: Json = False,
) -> None:
    """Identify the base parameters from recordings, by force plate and by joint torques.

    Several recordings are combined into one estimate; they may be larger than memory. A method
    whose signal was not recorded is left out. Imported recordings are first checked against the
    model: signs, units, order, encoder zeros, clocks. For parameters that they do not determine the
    model file's bodies are the prior, and the share of the data is printed.

    Example: testbed identify recording.parquet --model models/puma562.xml --zeros

    Example: testbed identify recording.parquet --model robot.urdf --write identified.urdf
    """
    from testbed.applications.analysis import analyse
    from testbed.core.base.errors import SettingsError
    from testbed.core.estimation.estimate import METHOD_LABELS
    from testbed.core.recordings.views import is_imported
    from testbed.core.robot.placeholders import find_placeholders
    from testbed.view import output, terminal

    writing.check(reading, recordings)
    reading, source, diagnostics = reading.open_joined(recordings)
    tree = reading.tree
    if reading.prior_error and not (writing.computes_bodies or is_imported(source)):
        raise SettingsError(
            "--set consistent... needs --consistent, or an imported recording"
        )
    methods = SIGNALS if method == "both" else (method,)
    recorded = [name for name in methods if name in source.signals]
    doubts = find_placeholders(tree).diagnostics if is_imported(source) else ()
    diagnostics = [*tree.diagnostics, *diagnostics, *doubts]
    if (
        everything or as_json
    ) and not tree.is_part:  # info only: few recordings have both signals
        diagnostics += _missing_signals(
            name for name in methods if name not in recorded
        )
    with output.Progress("identifying") as progress:
        analysis = analyse(
            tree,
            source,
            methods=recorded
            or methods,  # without a signal the first method raises the error
            doubt=reading.doubt,
            prior_error=reading.prior_error,
            bodies=reading.prior_and_options(source)
            if writing.computes_bodies
            else None,
            progress=progress,
            **reading.estimator_arguments,
        )
    for name, error in analysis.failures.items():
        if plain or name not in analysis.posterior:
            raise error
        diagnostics.append(
            make_diagnostic(
                "estimate.missing", name, reason=error, name=METHOD_LABELS[name]
            )
        )
    if analysis.bodies_failure is not None:
        raise analysis.bodies_failure
    if analysis.bodies is not None:
        diagnostics += writing.write_bodies(analysis.bodies, reading, recordings)
    estimates, posteriors = (
        list(analysis.estimates.values()),
        list(analysis.posterior.values()),
    )
    if as_json:
        from testbed.lab.experiment.results import identification_result

        result = identification_result(
            estimates,
            reading.file,
            reading.tables,
            diagnostics,
            analysis.bodies,
            analysis.posterior,
            plain=plain,
        )
        output.print_json(result.document())
        return
    terminal.print_estimates(
        estimates,
        diagnostics,
        analysis.bodies,
        posteriors=posteriors,
        least_squares=plain,
        everything=everything,
    )
    if writing.write is not None:
        output.print_result(lines=[f"model file: {writing.write}"])


def _missing_signals(methods: Iterable[Signal]) -> list[Diagnostic]:
    """Diagnostics "estimate.no-signal", one per method.

    Args:
        methods: Methods ("wrench", "torque") whose signal the recording lacks.
    """
    from testbed.core.estimation.estimate import METHOD_LABELS

    return [
        make_diagnostic("estimate.no-signal", m, signal=m, name=METHOD_LABELS[m])
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
        ReadingOptions, OptionFields("model", "gravity", "settings", "plate", "threads")
    ],
    as_json: Json = False,
) -> None:
    """Validate estimates by the residuals of a recording that was not used for the fit.

    Residuals are compared with their expected size: the root of the sum of squares of the noise
    in the estimate's own recording and of the prediction's sigma. Residuals above twice the
    expected size cause a warning.

    Example: testbed validate other.parquet runs/table6-286a25ef
    """
    from testbed.applications.validate import validate as validate_estimate
    from testbed.core.base.codec import to_json_values
    from testbed.core.base.errors import RecordingError
    from testbed.lab.experiment.read_result import read_result
    from testbed.view import output
    from testbed.view.posterior import validation_table

    stored = read_result(result, reading.model, reading.settings or ())
    source = corrected_source(
        stored.without_locked_joints(open_recording(recording)),
        stored.tree,
        reading.plate,
    )
    estimates = [
        a for a in stored.reported_estimates if a.estimate.method in source.signals
    ]
    diagnostics = _missing_signals(
        a.estimate.method for a in stored.reported_estimates if a not in estimates
    )
    if not estimates:
        raise RecordingError("; ".join(map(str, diagnostics)))
    validations = {}
    for reported in estimates:
        method = reported.estimate.method
        with output.Progress(f"validating, {method}") as progress:
            validations[method] = validate_estimate(
                stored.tree,
                source,
                reported.estimate,
                gravity=reading.gravity,
                settings=stored.settings,
                threads=reading.threads,
                progress=progress,
                models=reported.models,
                held=reported.held,
            )
    if as_json:
        output.print_json(
            {method: to_json_values(each) for method, each in validations.items()}
        )
    else:
        diagnostics += [
            each
            for validation in validations.values()
            for each in validation.diagnostics
        ]
        output.print_result(
            map(validation_table, validations.values()), (), diagnostics
        )


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
        int, typer.Option("-n", min=1, max=100_000, help="Number of robots.")
    ] = 100,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random numbers.")] = 0,
    reading: Annotated[ReadingOptions, OptionFields("model", "settings")],
    fixed: FixedLinks = "lump",
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Draw robots from the posterior of an estimate, as model files and MuJoCo fields.

    Draws are joint: from the estimates' covariance, and from the model file (with relative error
    consistent.prior_error) where data do not determine a parameter. Each is physically consistent.
    The table gives the share of the data in each parameter.

    Example: testbed sample identified.json -n 1000 --out robots
    """
    import numpy as np

    from testbed.bodies.consistency.robots import robots
    from testbed.bodies.prior import prior_of
    from testbed.bodies.write_model import ARCHIVE_NAME, write_models
    from testbed.core.base.codec import to_json_values
    from testbed.core.base.errors import SettingsError
    from testbed.core.base.installation import package_versions
    from testbed.lab.experiment.read_result import read_result
    from testbed.view import output
    from testbed.view.bodies import sampled_robots_table

    check_outputs(out, force=True, folder=True, read=(result, reading.model))
    stored = read_result(result, reading.model, reading.settings or ())
    if stored.tree.is_part:
        raise SettingsError(
            f"'{result}' is of a force sensor: robots need plate or joint torques"
        )
    other_files = {each.name for each in out.iterdir()} if out.exists() else set()
    stem = f"{stored.file.path.stem}_"
    if other_files := {
        name for name in other_files - {ARCHIVE_NAME} if not name.startswith(stem)
    }:
        raise SettingsError(
            f"'{out}' holds {min(other_files)}, not robots alone: --out names a new folder"
        )
    check_outputs(out, force=force, folder=True)
    prior = prior_of(stored.prior)
    rng = np.random.default_rng(seed)
    with output.Progress("drawing robots"):
        draws = robots(
            stored.tree, stored.full_estimates, prior, count, rng, stored.options
        )
    note = [
        f"testbed {package_versions()['testbed']}: a draw by {result.name}, seed {seed}"
    ]
    file = stored.file.tree()
    with output.Progress("writing model files"):
        trees = [draws.tree(k, file) for k in range(count)]
        diagnostics = write_models(stored.file, trees, out, fixed=fixed, note=note)
    if as_json:
        output.print_json(to_json_values(draws, exclude={"values"}))
    else:
        summary = [f"{count} robots: {out}"]
        output.print_result(
            [sampled_robots_table(draws)], summary, [*prior.diagnostics, *diagnostics]
        )
