"""The command about motions: excite."""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from testbed.cli.options import (
    Force,
    Gravity,
    Json,
    Set,
    check_outputs,
    command,
    ending,
    note,
    with_gravity,
)
from testbed.core.base.diagnostics import sentences
from testbed.core.base.installation import own_or_shipped

if TYPE_CHECKING:
    from testbed.lab.experiment.experiment import Experiment
    from testbed.view.output import Progress

TIMED = 3
"""Steps by which the time that all would take is known."""


@command()
def excite(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="MODEL_OR_EXPERIMENT",
            parser=own_or_shipped,
            help="Model file, experiment, or with --check a motion.",
        ),
    ],
    out: Annotated[
        Path, typer.Option(callback=ending(".toml"), help="Motion to write.")
    ] = Path("motion.toml"),
    settings: Set = None,
    gravity: Gravity = None,
    prior: Annotated[
        Path | None,
        typer.Option(
            help="Earlier estimate: a run folder, or the output of identify --json."
        ),
    ] = None,
    check: Annotated[
        bool,
        typer.Option(
            "--check", help="Only verify the motion of a file against the limits."
        ),
    ] = False,
    trajectory: Annotated[
        Path | None,
        typer.Option(
            callback=ending(".csv"),
            help="Samples for a controller (.csv), from rest to rest.",
        ),
    ] = None,
    rate: Annotated[
        float, typer.Option(min=1e-3, help="Sampling rate of those [Hz].")
    ] = 1000.0,
    page: Annotated[
        Path | None,
        typer.Option(
            callback=ending(".html", ".htm"),
            help="HTML page of motion, limits and standard deviations.",
        ),
    ] = None,
    everything: Annotated[
        bool, typer.Option("--all", help="Print all parameters and limits.")
    ] = False,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Design the motion that makes parameters most certain, and prove that it may be run.

    What is wanted stands in the table [excitation] (docs/excitation.md). Every limit is proven at
    every moment: joints, motors with friction, plate, distances to the robot itself, to plate,
    floor and boxes around it. Stopped by Ctrl-C, it goes on with the best motion so far.

    Example: testbed excite models/puma562.xml --out motion.toml --set motion.duration=20
    """
    from testbed.core.base.files import together
    from testbed.lab.experiment.excite import excite as excited
    from testbed.lab.experiment.read_result import prior_covariance, read_result
    from testbed.motion.motion_file import write_motion, write_trajectory
    from testbed.view import output
    from testbed.view.motion import print_excitation

    settings = with_gravity(settings, gravity)
    if check:
        _require_nothing({"--trajectory": trajectory, "--page": page, "--prior": prior})
        _check(file, settings, everything=everything, as_json=as_json)
    check_outputs(out, trajectory, page, force=force, read=(file, prior))
    experiment = _experiment(file, settings)
    known = None if prior is None else prior_covariance(read_result(prior), experiment)
    with output.Progress("searching") as progress, _interrupt() as interrupted:
        found = excited(experiment, _Searching(progress), known, interrupted)
    with output.Progress("writing"), together():
        if trajectory is not None:
            write_trajectory(trajectory, found, rate, experiment.motion.duration)
        write_motion(out, found, Path(experiment.model))
        if page is not None:
            from testbed.view.motion import write_motion_page

            write_motion_page(page, found)
    if as_json:
        output.print_json(found.document() | {"file": str(out)})
    else:
        every = (*found.tree.diagnostics, *found.rules.diagnostics, *found.diagnostics)
        output.print_diagnostics(output.console(), every)
        print_excitation(output.console(), found, out, everything=everything)


class _Searching:
    """Report how long all steps of all searches would take, and the best so far."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress
        self._steps, self._began = -1, 0.0

    def __call__(self, done: int, total: int, best: float) -> None:
        from testbed.motion.problem import STEPS

        self._steps += 1
        now = time.monotonic()
        if not self._steps:  # loading, compiling and the search's start are over
            self._began = now
            return
        most = (now - self._began) / self._steps * STEPS * total
        if self._steps == TIMED and not sys.stderr.isatty():  # a terminal has the bar
            searches = f"{total} search{'es' * (total != 1)} of at most {STEPS} steps"
            said = "Ctrl-C keeps the best motion so far"
            note(
                [
                    f"{searches}, at most {most:.0f} s; {said}, "
                    "fewer excitation.starts stop earlier"
                ]
            )
        said = f"searching, at most {most:.0f} s, best standard deviation so far {best:.3g}"
        self._progress.say(done, total, said)


@contextmanager
def _interrupt() -> Iterator[Callable[[], bool]]:
    """Whether Ctrl-C was pressed; pressed again it ends the program as ever."""
    asked: list[bool] = []
    before = signal.getsignal(signal.SIGINT)

    def note_it(number: int, frame: object) -> None:
        asked.append(True)
        signal.signal(signal.SIGINT, before)

    signal.signal(signal.SIGINT, note_it)
    try:
        yield lambda: bool(asked)
    finally:
        signal.signal(signal.SIGINT, before)


def _experiment(file: Path, settings: list[str]) -> Experiment:
    """An experiment file, or one that says only which model."""
    from testbed.lab.experiment.experiment import Experiment

    if file.suffix.lower() == ".toml":
        return Experiment.from_toml(file, settings)
    experiment, said = Experiment.of_model(file, settings).with_nearest_bodies()
    note(sentences(said))
    return experiment


def _require_nothing(options: Mapping[str, Path | None]) -> None:
    """Of a design, where there is none."""
    said = [name for name, value in options.items() if value is not None]
    if said:
        raise typer.BadParameter(
            f"--check designs nothing; it cannot be combined with {', '.join(said)}"
        )


def _check(file: Path, settings: list[str], *, everything: bool, as_json: bool) -> None:
    """Prove a motion of a file; exit code 1 if it exceeds a limit."""
    from testbed.core.base.codec import encode
    from testbed.lab.experiment.motions import checked_motion
    from testbed.view import output
    from testbed.view.motion import print_proof

    with output.Progress("proving"):
        found = checked_motion(file, settings)
    proof = found.proof
    if as_json:
        output.print_json(encode(proof))
    else:
        every = (*found.rules.tree.diagnostics, *found.rules.diagnostics)
        output.print_diagnostics(output.console(), every)
        print_proof(output.console(), proof, everything=everything)
    raise typer.Exit(0 if proof.holds else 1)
