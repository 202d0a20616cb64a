"""Other people's recordings: import, and mapping files proposed from what the files hold."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from testbed.cli.options import (
    Fields,
    Force,
    Json,
    check_outputs,
    command,
    ending,
    note,
)
from testbed.cli.reading import Reading
from testbed.core.base.diagnostics import Diagnostic, diagnose, ordered
from testbed.core.base.errors import RecordingError, few
from testbed.core.base.file_kinds import LOG, kind_of, misplaced

if TYPE_CHECKING:
    from testbed.core.recordings.recording import Recording
    from testbed.importing.check.check import CheckReport, Prepared
    from testbed.importing.check.mapping_solution import MappingSolution
    from testbed.importing.import_report import MappingDraft


def write_mapping(
    files: Sequence[Path],
    out: Path | None,
    reading: Reading,
    page: Path | None = None,
) -> MappingSolution | None:
    """Solve the mapping of logs, write it, and print the next command.

    Args:
        files: Of other programs.
        out: Mapping file to write.
        reading: The robot's model file, if it is known, and how it is read.
        page: HTML file to write of what was solved.

    Returns:
        The solved mapping; None where it is not complete.

    Raises:
        TestbedError: The data contradict the mapping, which is written as far as it is known.
    """
    from testbed.core.base.files import together
    from testbed.core.base.whole_files import write_whole
    from testbed.importing.check.draft_mapping import missing
    from testbed.view import output
    from testbed.view.mapping import solved_table, write_mapping_page

    written = out or Path("mapping.toml")
    solution = _solution(files, written, reading)
    draft = solution.draft
    solved = solved_table(draft)
    if out is not None and reading.model is not None and solved.rows:
        output.print_result([solved])
    with together():
        if page is not None:
            write_mapping_page(page, solution)
        if out is not None:
            write_whole(out, draft.text)
    if out is None:
        typer.echo(draft.text, nl=False)
    if solution.refusal is not None:
        raise _refused(solution.refusal, draft, written)
    if out is None:
        return None
    empty = missing(draft)
    notes = {
        f"{table}.{key}".removeprefix("."): said
        for (table, key), said in draft.notes.items()
    }
    note(
        f"{out}:{draft.line(key)}: {key}: {notes.get(key, 'not found')}"
        for key in empty
    )
    fill = f"fill in what is empty ({', '.join(empty)}), then " if empty else ""
    words = ["import", out, "--out", out.with_suffix(".parquet"), *reading.model_words]
    typer.echo(f"{out}: {fill}testbed {shlex.join(map(str, words))}")
    return None if empty else solution


def _solution(
    files: Sequence[Path], written: Path, reading: Reading
) -> MappingSolution:
    """Mapping by the columns' names and, where the robot is known, by the data."""
    from testbed.core.robot.gravity import in_words
    from testbed.core.robot.placeholders import placeholders
    from testbed.importing.check.draft_mapping import draft_mapping
    from testbed.importing.check.mapping_solution import MappingSolution, solve_mapping
    from testbed.importing.guess import guessed
    from testbed.view import output

    with output.Progress("reading"):
        if reading.model is None:
            return MappingSolution(guessed(files, written.parent))
        draft, file, tree = draft_mapping(files, written.parent, reading.file)
        if reading.gravity is not None:
            stated = in_words(reading.gravity)
            draft = draft.saying("", "gravity", stated, "by --gravity")
    with output.Progress("solving the mapping, hypotheses") as bar:
        solution = solve_mapping(draft, written, tree, bar)
    lock = solution.draft.tables.get("lock", {})
    locked = few([f"{name} at {q:.4g}" for name, q in lock.items()])
    said = [diagnose("robot.locked", locked)] if locked else []
    if file.weld_root and not reading.weld_root:
        said.append(diagnose("robot.welded", tree.name))
    found = (*solution.diagnostics, *said, *tree.diagnostics)
    # what the log contradicts comes before what its robot's file lacks
    lacking = placeholders(tree).diagnostics if solution.refusal is None else ()
    output.print_result(diagnostics=[*found, *lacking])
    return solution


def _refused(refusal: Exception, draft: MappingDraft, written: Path) -> RecordingError:
    """Refusal of a solved mapping that names the line in question."""
    reason = str(refusal).removeprefix(f"{written}: ")
    named = re.search(r"\[([\w.]+)\] (\w+)", reason)
    number = draft.line(f"{named[1]}.{named[2]}") if named else 1
    return RecordingError(f"{written}:{number}: {reason}")


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
        Reading,
        Fields(
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
    """Make a recording of other programs' files: CSV, MATLAB, HDF5, ROS, LeRobot, and others.

    With --model, signs, units, order, encoder zeros and clocks are checked against the robot. With
    --guess a mapping file is written from the column names; with --guess and --model what these do
    not state, such as the plate's frame, units, sense, zero and clock, is solved from the data.

    Example: testbed import examples/tx40/tx40.toml --out tx40.parquet
    """
    from testbed.importing.convert import concatenated
    from testbed.importing.mapping import sources
    from testbed.view import output

    for each in files:
        if not guess and each.suffix.lower() != ".toml":
            raise typer.BadParameter(misplaced(each, kind_of(each) or LOG, "mapping"))
    if page is not None and not (guess and reading.model):
        raise typer.BadParameter(
            "--page is of a mapping: --guess and --model go with it"
        )
    read = [*files, reading.model, *(() if guess or out is None else sources(files[0]))]
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
        known = reading.robot_of(recordings[0])[0].diagnostics
        report = replace(report, diagnostics=(*known, *report.diagnostics))
    clocks = list(_clock_lines(report, " (corrected)" if align else ""))
    concatenated(recordings, cuts).save(out)
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
    """Print what imports did, then further lines, cuts and doubts."""
    from testbed.importing.import_report import ImportReport
    from testbed.view import output

    reports = [ImportReport.from_dict(each) for each in imports]
    doubts = [each for report in reports for each in report.diagnostics]
    every = [*(line for report in reports for line in report.lines()), *lines]
    output.print_result((), every, [*cuts, *ordered([*doubts, *report.diagnostics])])


def _clock_lines(report: CheckReport, correction: str) -> Iterator[str]:
    """How late signals are, and what was done about it."""
    for each in report.offsets:
        yield each.diagnostic().text + (
            correction if each.matters else ", not significant"
        )


def checked_import(
    mapping: Path,
    reading: Reading,
    *,
    align: bool = False,
    prepared: Prepared | None = None,
) -> tuple[Sequence[Recording], list[Diagnostic], CheckReport]:
    """Recordings that a mapping file makes, where it was cut, and their check by the robot.

    Args:
        mapping: The file.
        reading: How the robot is read; without a model nothing is checked.
        align: Whether delays and drifts of clocks are taken back.
        prepared: The recordings, where they were made already.
    """
    from testbed.importing.check.check import CheckReport, import_and_check
    from testbed.importing.convert import pieces
    from testbed.view import output

    if reading.model is None:
        with output.Progress("importing"):
            return *pieces(mapping), CheckReport()
    with output.Progress("importing, checking against the robot") as bar:
        return import_and_check(
            mapping,
            reading.robot_of,
            align=align,
            unchecked=reading.unchecked,
            progress=bar,
            prepared=prepared,
        )
