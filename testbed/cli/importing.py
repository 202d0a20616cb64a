"""Commands about other people's recordings: import."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from testbed.cli.options import Json, app


@app.command("import")
def import_(
    mapping: Annotated[
        Path,
        typer.Argument(metavar="MAPPING.toml", help="Mapping file; with --guess a foreign file."),
    ],
    out: Annotated[
        Path | None,
        typer.Option(help="Recording to write (Parquet); with --guess a mapping file."),
    ] = None,
    guess: Annotated[
        bool, typer.Option("--guess", help="Write a mapping with what the file holds.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Make a recording of other programs' files: CSV, MATLAB, HDF5, ROS bags, C3D and others.

    Example: testbed import examples/tx40/tx40.toml --out tx40.parquet
    """
    from testbed.recordings.importing.import_report import ImportReport
    from testbed.recordings.recording import Recording
    from testbed.report import terminal

    if guess:
        _guess(mapping, out)
        return
    if out is None:
        raise typer.BadParameter("--out is missing: the recording to write (Parquet)")
    recording = Recording.from_mapping(mapping)
    recording.save(out)
    if as_json:
        terminal.print_json(recording.facts["import"])
    else:
        report = ImportReport.from_dict(recording.facts["import"])
        terminal.print_lines([*report.lines(), f"recording: {out}"], report.warnings())


def _guess(file: Path, out: Path | None) -> None:
    """A mapping file to start from, on standard output or where it is wanted."""
    from testbed.files import replacing
    from testbed.recordings.importing.guess import guessed

    if out is None:
        typer.echo(guessed(file, Path()), nl=False)
        return
    if out.exists():
        raise typer.BadParameter(f"--out {out} is there; a mapping is not replaced")
    text = guessed(file, out.parent)
    with replacing(out) as fresh:
        fresh.write_text(text, encoding="utf-8")
    typer.echo(f"{out}: fill in what is empty")
