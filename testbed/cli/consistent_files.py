"""What `identify --consistent --write FILE` does beside identifying."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from testbed.cli.reading import Reading
    from testbed.diagnostics.diagnostic import Diagnostic
    from testbed.identification.consistency.consistent import Consistent
    from testbed.identification.estimate import Estimate, Method
    from testbed.recordings.source import Source


class Fixed(StrEnum):
    """What links get that are fixed to others."""

    lump = "lump"
    share = "share"


ConsistentBodies = Annotated[
    bool, typer.Option("--consistent", help="Bodies that can exist, near the model file's.")
]
Write = Annotated[
    Path | None,
    typer.Option(
        "--write", metavar="FILE", help="The model file with consistent bodies and friction."
    ),
]
FixedLinks = Annotated[
    Fixed, typer.Option("--fixed", help="What is fixed to a link: its mass lumped, or shared out.")
]
InPlace = Annotated[bool, typer.Option("--in-place", help="--write may replace the model file.")]


@dataclass(frozen=True)
class Writing:
    """What was said of consistent bodies.

    Attributes:
        consistent: Whether they are wanted.
        write: The file to write, which wants them too.
        fixed: What fixed links get.
        in_place: Whether the model file may be replaced.
    """

    consistent: bool = False
    write: Path | None = None
    fixed: Fixed = Fixed.lump
    in_place: bool = False

    @property
    def wanted(self) -> bool:
        """Whether consistent bodies are to be made."""
        return self.consistent or self.write is not None

    def check(self, reading: Reading, model: Path, recordings: Sequence[Path]) -> None:
        """Whether the file may be written, and wishes are of use: said before the work.

        Args:
            reading: What is wished.
            model: The model file.
            recordings: What is identified, which is not replaced.

        Raises:
            ModelError: It may not.
            SettingsError: Something is wished of bodies that nobody asked for.
        """
        from testbed.errors import SettingsError
        from testbed.files import check_writable
        from testbed.identification.consistency.options import ConsistencyOptions
        from testbed.robot.write_model import check_place

        if not self.wanted and reading.tables().consistent != ConsistencyOptions():
            raise SettingsError("--set consistent... is about consistent bodies: say --consistent")
        if self.in_place and self.write is None:
            raise SettingsError("--in-place is about the file that --write names: say which")
        if self.write is not None:
            check_writable(self.write, read=(*recordings, reading.plate))
            check_place(model, self.write, over_source=self.in_place)

    def bodies(
        self,
        reading: Reading,
        model: Path,
        source: Source,
        estimates: Sequence[Estimate],
        identified: Callable[[Source, Method], Estimate],
    ) -> Consistent:
        """The consistent bodies.

        Args:
            reading: How the model file is read, and what is wished.
            model: The model file.
            source: The recording.
            estimates: Of the recording.
            identified: Makes an estimate of a part of it.

        Raises:
            SettingsError: No bodies are as is wished.
        """
        from testbed.experiment.consistent_run import prior_from
        from testbed.identification.consistency.prior_weight import consistent_by_held_out
        from testbed.identification.problem import samples_of
        from testbed.recordings.coupled_gear import with_gear
        from testbed.reporting import output

        tree = with_gear(reading.tree(model), source)
        options = reading.tables().consistent
        file = reading.model_file(model)
        prior = prior_from(tree, file, shapes=options.centres_in_shapes)
        part = samples_of(source, reading.tables().identification)
        with output.Progress("looking for consistent bodies"):
            return consistent_by_held_out(tree, estimates, prior, options, part, identified)

    def written(
        self, found: Consistent, reading: Reading, model: Path, recordings: Sequence[Path]
    ) -> tuple[Diagnostic, ...]:
        """Write the file that was asked for.

        Args:
            found: What is written.
            reading: How the model file is read.
            model: The model file.
            recordings: What it was identified from.

        Raises:
            ModelError: The file cannot be written.
        """
        from testbed.experiment.versions import provenance
        from testbed.identification.consistency.consistent import robot_of
        from testbed.robot.write_model import write_model

        if self.write is None:
            return ()
        file = reading.model_file(model)
        return write_model(
            file,
            robot_of(found, file.tree()),
            self.write,
            fixed=self.fixed.value,
            note=provenance(found, file, recordings),
            over_source=self.in_place,
        )
