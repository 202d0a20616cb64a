"""Command import: recordings from log files, and mapping files derived from logs."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from testbed.cli.options import (
    Force,
    Json,
    OptionFields,
    check_outputs,
    command,
    ending,
    print_notes,
)
from testbed.cli.reading import ReadingOptions
from testbed.core.base.diagnostics import (
    Diagnostic,
    make_diagnostic,
    ordered_diagnostics,
)
from testbed.core.base.errors import RecordingError, shortened_list
from testbed.core.base.file_kinds import FOREIGN_LOG, kind_of, wrong_kind_message

if TYPE_CHECKING:
    from testbed.core.recordings.recording import Recording
    from testbed.importing.check.check import CheckReport, PreparedRecordings
    from testbed.importing.check.mapping_solution import MappingSolution
    from testbed.importing.import_report import MappingDraft


def write_mapping(
    files: Sequence[Path],
    out: Path | None,
    reading: ReadingOptions,
    page: Path | None = None,
) -> MappingSolution | None:
    """Solve the mapping file for log files, write it, and print the next command.

    Notes on standard error list the keys that remain empty, with their line numbers.

    Args:
        files: Log files of other programs.
        out: Mapping file to write; None to print the mapping.
        reading: Options of the robot's model file, if a model is given.
        page: HTML page of the solution to write; None for no page.

    Returns:
        The solved mapping; None if keys remain empty (`missing_keys`), or if the mapping was
        printed.

    Raises:
        RecordingError: The data contradict the mapping. The mapping is written first, as far as it
            was solved; the message contains the line of the contradiction.
    """
    from testbed.core.base.files import replace_together
    from testbed.core.base.whole_files import write_atomically
    from testbed.importing.check.draft_mapping import missing_keys
    from testbed.view import output
    from testbed.view.mapping import mapping_table, write_mapping_page

    mapping_path = out or Path("mapping.toml")
    solution = _solve_and_print(files, mapping_path, reading)
    draft = solution.draft
    solved = mapping_table(draft)
    if out is not None and reading.model is not None and solved.rows:
        output.print_result([solved])
    with replace_together():
        if page is not None:
            write_mapping_page(page, solution)
        if out is not None:
            write_atomically(out, draft.text)
    if out is None:
        typer.echo(draft.text, nl=False)
    if solution.error is not None:
        raise _refusal_with_line(solution.error, draft, mapping_path)
    if out is None:
        return None
    missing = missing_keys(draft)
    notes = {
        f"{table}.{key}".removeprefix("."): text
        for (table, key), text in draft.key_comments.items()
    }
    print_notes(
        f"{out}:{draft.line_number(key)}: {key}: {notes.get(key, 'not found')}"
        for key in missing
    )
    instruction = (
        f"fill in what is empty ({', '.join(missing)}), then " if missing else ""
    )
    command_words = [
        "import",
        out,
        "--out",
        out.with_suffix(".parquet"),
        *reading.model_words,
    ]
    typer.echo(f"{out}: {instruction}testbed {shlex.join(map(str, command_words))}")
    return None if missing else solution


def _solve_and_print(
    files: Sequence[Path], mapping_path: Path, reading: ReadingOptions
) -> MappingSolution:
    """Solve a mapping from column names and, if a model is given, from the data.

    Without a model, the draft from the column names is returned and nothing is printed. With a
    model, diagnostics of the solution, of locked joints and of the robot are printed. --gravity
    overrides the draft.

    Args:
        files: Log files.
        mapping_path: Mapping file; paths in it are relative to its folder.
        reading: Options of the robot's model file.

    Returns:
        The solution. A contradiction by the data is not raised, but stored in its `error`.
    """
    from testbed.core.robot.gravity import mounting_name
    from testbed.core.robot.placeholders import find_placeholders
    from testbed.importing.check.draft_mapping import draft_mapping
    from testbed.importing.check.mapping_solution import MappingSolution, solve_mapping
    from testbed.importing.guess import guess_mapping
    from testbed.view import output

    with output.Progress("reading"):
        if reading.model is None:
            return MappingSolution(guess_mapping(files, mapping_path.parent))
        draft, file, tree = draft_mapping(files, mapping_path.parent, reading.file)
        if reading.gravity is not None:
            gravity_text = mounting_name(reading.gravity)
            draft = draft.with_key("", "gravity", gravity_text, "by --gravity")
    with output.Progress("solving the mapping, hypotheses") as bar:
        solution = solve_mapping(draft, mapping_path, tree, bar)
    lock = solution.draft.tables.get("lock", {})
    locked = shortened_list([f"{name} at {q:.4g}" for name, q in lock.items()])
    lock_diagnostics = [make_diagnostic("robot.locked", locked)] if locked else []
    if file.weld_root and not reading.weld_root:
        lock_diagnostics.append(make_diagnostic("robot.welded", tree.name))
    diagnostics = (*solution.diagnostics, *lock_diagnostics, *tree.diagnostics)
    # placeholders of the model file are not reported with a refused log
    placeholders = find_placeholders(tree).diagnostics if solution.error is None else ()
    output.print_result(diagnostics=[*diagnostics, *placeholders])
    return solution


def _refusal_with_line(
    refusal: Exception, draft: MappingDraft, mapping_path: Path
) -> RecordingError:
    """Error for a refused mapping, with the message "file:line: reason".

    Args:
        refusal: Original error. The line is that of the key if the message contains "[table] key",
            otherwise 1.
        draft: Draft of the mapping, with its text.
        mapping_path: Mapping file.
    """
    reason = str(refusal).removeprefix(f"{mapping_path}: ")
    match = re.search(r"\[([\w.]+)\] (\w+)", reason)
    number = draft.line_number(f"{match[1]}.{match[2]}") if match else 1
    return RecordingError(f"{mapping_path}:{number}: {reason}")


@command("import")
def import_(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="MAPPING.toml", help="Mapping file; with --guess foreign files."
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            callback=ending(".parquet", ".toml"),
            help="Recording to write (Parquet); with --guess a mapping file.",
        ),
    ] = None,
    guess: Annotated[
        bool, typer.Option("--guess", help="Write a draft mapping of the file.")
    ] = False,
    *,
    reading: Annotated[
        ReadingOptions,
        OptionFields(
            "model",
            "gravity",
            "settings",
            "weld_root",
            "lock",
            "lock_mimic",
            "unchecked",
        ),
    ],
    align: Annotated[
        bool,
        typer.Option(
            "--align", help="Correct delays of torques and plate (needs --model)."
        ),
    ] = False,
    page: Annotated[
        Path | None,
        typer.Option(
            callback=ending(".html"),
            help="With --guess and --model: HTML page of the solution.",
        ),
    ] = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Convert log files to a recording: CSV, MATLAB, HDF5, ROS, LeRobot, and others.

    With --model, signs, units, order, encoder zeros and clocks are checked against the robot. With
    --guess a mapping file is written from the column names; with --guess and --model the plate's
    frame, units, sense, zero and clock, if column names do not give them, are solved from the data.

    Example: testbed import examples/tx40/tx40.toml --out tx40.parquet
    """
    from testbed.importing.convert import joined_recording
    from testbed.importing.mapping import source_paths
    from testbed.view import output

    for each in files:
        if not guess and each.suffix.lower() != ".toml":
            raise typer.BadParameter(
                wrong_kind_message(each, kind_of(each) or FOREIGN_LOG, "mapping")
            )
    if page is not None and not (guess and reading.model):
        raise typer.BadParameter(
            "--page is of a mapping: --guess and --model go with it"
        )
    read = [
        *files,
        reading.model,
        *(() if guess or out is None else source_paths(files[0])),
    ]
    check_outputs(out, page, force=force, read=read)
    if guess:
        write_mapping(files, out, reading, page)
        return
    if len(files) > 1:
        raise typer.BadParameter(
            f"one mapping at a time, not {len(files)}; it may name many files"
        )
    (mapping,) = files
    if out is None:
        raise typer.BadParameter("--out is missing, e.g. --out recording.parquet")
    if reading.model is None and align:
        raise typer.BadParameter(
            "--align needs --model: delays are found by the robot's motion"
        )
    recordings, cuts, report = checked_import(mapping, reading, align=align)
    if reading.model is not None:
        robot_diagnostics = reading.robot_of(recordings[0])[0].diagnostics
        report = replace(report, diagnostics=(*robot_diagnostics, *report.diagnostics))
    clocks = list(_time_offset_lines(report, " (corrected)" if align else ""))
    joined_recording(recordings, cuts).save(out)
    imports = [recording.metadata.report for recording in recordings]
    if as_json:
        document: dict[str, object] = {
            "import": imports if cuts else imports[0],
            "clocks": clocks,
            "diagnostics": [each.as_dict() for each in report.diagnostics],
        }
        if cuts:
            document["cuts"] = [each.text for each in cuts]
        output.print_json(document)
        return
    _print_imports(imports, [*clocks, f"recording: {out}"], cuts, report)


def _print_imports(
    imports: Iterable[Mapping[str, Any]],
    lines: Iterable[str],
    cuts: Iterable[Diagnostic],
    report: CheckReport,
) -> None:
    """Print import reports, further lines and diagnostics.

    Args:
        imports: Import reports as dictionaries, one per recording.
        lines: Further lines, printed after the reports.
        cuts: Diagnostics of the gaps at which recordings were split; printed first.
        report: Report of the plausibility check.
    """
    from testbed.importing.import_report import ImportReport
    from testbed.view import output

    reports = [ImportReport.from_dict(each) for each in imports]
    import_diagnostics = [each for report in reports for each in report.diagnostics]
    all_lines = [*(line for report in reports for line in report.text_lines()), *lines]
    output.print_result(
        (),
        all_lines,
        [*cuts, *ordered_diagnostics([*import_diagnostics, *report.diagnostics])],
    )


def _time_offset_lines(report: CheckReport, correction: str) -> Iterator[str]:
    """Yield one line per signal with its time offset relative to the positions.

    Args:
        report: Report of the plausibility check, with the offsets.
        correction: Text appended to a significant offset; other lines end in ", not significant".
    """
    for each in report.offsets:
        yield each.diagnostic().text + (
            correction if each.is_significant else ", not significant"
        )


def checked_import(
    mapping: Path,
    reading: ReadingOptions,
    *,
    align: bool = False,
    prepared: PreparedRecordings | None = None,
) -> tuple[Sequence[Recording], list[Diagnostic], CheckReport]:
    """Import the recordings of a mapping file, and check their plausibility.

    Args:
        mapping: Mapping file.
        reading: Options of the model file; without a model the check is skipped.
        align: True to correct delays and drifts of the clocks.
        prepared: Recordings of the mapping that have already been imported, to avoid a second
            import.

    Returns:
        Recordings, diagnostics of the gaps between them, and report of the check (empty without a
        model).

    Raises:
        RecordingError: The longest recording contradicts the robot.
    """
    from testbed.importing.check.check import CheckReport, import_and_check
    from testbed.importing.convert import import_recordings
    from testbed.view import output

    if reading.model is None:
        with output.Progress("importing"):
            return *import_recordings(mapping), CheckReport()
    with output.Progress("importing, checking against the robot") as bar:
        return import_and_check(
            mapping,
            reading.robot_of,
            align=align,
            unchecked=reading.unchecked,
            progress=bar,
            prepared=prepared,
        )
