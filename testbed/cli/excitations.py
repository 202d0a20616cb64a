"""Command for excitation trajectories: excite."""

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
    print_notes,
    settings_with_gravity,
)
from testbed.core.base.diagnostics import sentences
from testbed.core.base.installation import user_or_shipped_file

if TYPE_CHECKING:
    from testbed.lab.experiment.experiment import Experiment
    from testbed.view.output import Progress

TIMED_STEPS = 3
"""Number of search steps after which the total time is estimated."""


@command()
def excite(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="MODEL_OR_EXPERIMENT",
            parser=user_or_shipped_file,
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
        float, typer.Option(min=1e-3, help="Sampling rate of --trajectory [Hz].")
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
    """Design a motion that minimises the parameters' standard deviations within all limits.

    Criterion and limits are in the table [excitation] (docs/excitation.md). Limits are proven at
    every moment: joints, motors with friction, plate, distances to the robot itself, to plate,
    floor and boxes around it. Ctrl-C ends the search with the best motion so far.

    Example: testbed excite models/puma562.xml --out motion.toml --set motion.duration=20
    """
    from testbed.core.base.files import replace_together
    from testbed.lab.experiment.excite import excite as design_excitation
    from testbed.lab.experiment.read_result import prior_covariance, read_result
    from testbed.motion.motion_file import write_motion, write_trajectory
    from testbed.view import output
    from testbed.view.motion import print_excitation

    settings = settings_with_gravity(settings, gravity)
    if check:
        _reject_design_options(
            {"--trajectory": trajectory, "--page": page, "--prior": prior}
        )
        _print_motion_proof(file, settings, everything=everything, as_json=as_json)
    check_outputs(out, trajectory, page, force=force, read=(file, prior))
    experiment = _load_experiment(file, settings)
    covariance = (
        None if prior is None else prior_covariance(read_result(prior), experiment)
    )
    with output.Progress("searching") as progress, _interrupt_flag() as interrupted:
        excitation = design_excitation(
            experiment, _SearchProgress(progress), covariance, interrupted
        )
    with output.Progress("writing"), replace_together():
        if trajectory is not None:
            write_trajectory(trajectory, excitation, rate, experiment.motion.duration)
        write_motion(out, excitation, Path(experiment.model))
        if page is not None:
            from testbed.view.motion import write_motion_page

            write_motion_page(page, excitation)
    if as_json:
        output.print_json(excitation.json_values() | {"file": str(out)})
    else:
        diagnostics = (
            *excitation.tree.diagnostics,
            *excitation.rules.diagnostics,
            *excitation.diagnostics,
        )
        output.print_diagnostics(output.console(), diagnostics)
        print_excitation(output.console(), excitation, out, everything=everything)


class _SearchProgress:
    """Progress display of the search, with its longest possible duration and best result.

    An instance is called after each step with the number of finished searches, the number of all
    searches, and the best criterion so far. The duration is the mean duration of the steps so far,
    multiplied by `MAX_SEARCH_STEPS` per search. Without a terminal, a note with it is printed once,
    after `TIMED_STEPS` steps.
    """

    def __init__(self, progress: Progress) -> None:
        self._progress = progress
        self._steps, self._start_time = -1, 0.0

    def __call__(self, done: int, total: int, best: float) -> None:
        from testbed.motion.problem import MAX_SEARCH_STEPS

        self._steps += 1
        now = time.monotonic()
        if not self._steps:  # loading, compiling and initialisation are excluded
            self._start_time = now
            return
        max_seconds = (now - self._start_time) / self._steps * MAX_SEARCH_STEPS * total
        # on a terminal the progress bar shows it
        if self._steps == TIMED_STEPS and not sys.stderr.isatty():
            searches = f"{total} search{'es' * (total != 1)} of at most {MAX_SEARCH_STEPS} steps"
            text = "Ctrl-C keeps the best motion so far"
            print_notes(
                [
                    f"{searches}, at most {max_seconds:.0f} s; {text}, "
                    "fewer excitation.starts stop earlier"
                ]
            )
        text = f"searching, at most {max_seconds:.0f} s, best standard deviation so far {best:.3g}"
        self._progress.update_step(done, total, text)


@contextmanager
def _interrupt_flag() -> Iterator[Callable[[], bool]]:
    """Context manager with a function that returns True after Ctrl-C.

    The first Ctrl-C sets the flag and restores the previous handler, so that a second Ctrl-C
    interrupts the program. The previous handler is also restored at the end of the block.
    """
    interrupts: list[bool] = []
    previous_handler = signal.getsignal(signal.SIGINT)

    def record_interrupt(number: int, frame: object) -> None:
        interrupts.append(True)
        signal.signal(signal.SIGINT, previous_handler)

    signal.signal(signal.SIGINT, record_interrupt)
    try:
        yield lambda: bool(interrupts)
    finally:
        signal.signal(signal.SIGINT, previous_handler)


def _load_experiment(file: Path, settings: list[str]) -> Experiment:
    """Load an experiment from a .toml file, or the default experiment of a model file.

    For a model file, bodies that are not physically consistent are replaced by the nearest
    consistent bodies, with notes on standard error.

    Args:
        file: Experiment file or model file.
        settings: Values of --set, which override the experiment.
    """
    from testbed.lab.experiment.experiment import Experiment

    if file.suffix.lower() == ".toml":
        return Experiment.from_toml(file, settings)
    experiment, diagnostics = Experiment.of_model(file, settings).with_nearest_bodies()
    print_notes(sentences(diagnostics))
    return experiment


def _reject_design_options(options: Mapping[str, Path | None]) -> None:
    """Raise BadParameter if --check is combined with options of the design.

    Args:
        options: Values of the design's options, keyed by name; None for an option that was not
            given.
    """
    design_options = [name for name, value in options.items() if value is not None]
    if design_options:
        raise typer.BadParameter(
            f"--check designs nothing; it cannot be combined with {', '.join(design_options)}"
        )


def _print_motion_proof(
    file: Path, settings: list[str], *, everything: bool, as_json: bool
) -> None:
    """Print the proven margins of a motion to its limits, then exit.

    Args:
        file: Motion file.
        settings: Values of --set, which override the motion's experiment.
        everything: True to print all limits.
        as_json: True to print the proof as JSON, without diagnostics.

    Raises:
        Exit: Always; the code is 0 if the limits are proven to hold at every moment, else 1.
    """
    from testbed.core.base.codec import to_json_values
    from testbed.lab.experiment.motions import prove_motion_file
    from testbed.view import output
    from testbed.view.motion import print_limit_margins

    with output.Progress("proving"):
        proven_motion = prove_motion_file(file, settings)
    proof = proven_motion.proof
    if as_json:
        output.print_json(to_json_values(proof))
    else:
        diagnostics = (
            *proven_motion.rules.tree.diagnostics,
            *proven_motion.rules.diagnostics,
        )
        output.print_diagnostics(output.console(), diagnostics)
        print_limit_margins(output.console(), proof, everything=everything)
    raise typer.Exit(0 if proof.is_valid else 1)
