"""Sections of estimates, of the instrument, of two estimates compared, of a payload."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from testbed.applications.calibration import Calibration
from testbed.core.base.arrays import Array
from testbed.core.base.errors import plural, printable
from testbed.core.base.summary_table import number_with_sigma, numbers_with_sigma
from testbed.core.estimation.diagnostics.model_errors import numbers, treatment
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.influence import by_influence
from testbed.core.estimation.model_errors.estimates import ModelErrorEstimate
from testbed.core.estimation.selection.held_out import HeldOut, TermChoice
from testbed.core.recordings.columns import AXES
from testbed.lab.experiment.run import Run
from testbed.view.section import Table

if TYPE_CHECKING:
    from testbed.applications.payload.payload import PayloadEstimate
    from testbed.applications.payload.tool import ToolEstimate
    from testbed.applications.payload.torque_scales import TorqueScales


def parameter_tables(
    estimates: Sequence[Estimate],
    truths: Mapping[str, float],
    title: str = "",
    most: int | None = None,
) -> Iterator[list[Table]]:
    """What every method found: value and sigma, and, where it is known, the truth beside it.

    First what adds most to the predicted signals; layouts from wide to narrow.

    Args:
        estimates: Of one recording, one a method.
        truths: True values by name; {} where they are not known.
        title: Of the table.
        most: Rows in all; None for all that there are.
    """
    names = by_influence(estimates, truths)[:most]
    yield [_table(estimates, names, truths, title, short=False)]
    yield [_table(estimates, names, truths, title, short=True)]
    yield [_table([each], names, truths, title, short=True) for each in estimates]


def _table(
    estimates: Sequence[Estimate],
    names: Sequence[str],
    truths: Mapping[str, float],
    title: str,
    *,
    short: bool,
) -> Table:
    """Of some methods; short: 1.0610(9) for 1.0610 +- 0.0009, and no units."""
    units = {n: u for e in estimates for n, u in zip(e.names, e.units, strict=True)}
    names = [name for name in names if name in units]
    columns: dict[str, list[str]] = {"parameter": names}
    if not short:
        columns["unit"] = [units[name] for name in names]
    if truths:
        columns["truth"] = [f"{truths[n]:.6g}" if n in truths else "-" for n in names]
    heads = [*columns]
    cells = [*columns.values()]
    for estimate in estimates:
        numbers, errors = _cells(estimate, truths, short)
        heads.append(estimate.instrument)
        cells.append([numbers.get(name, "-") for name in names])
        if truths:
            heads.append("z" if short else "error/std")
            cells.append([errors.get(name, "") for name in names])
    return Table(heads, list(zip(*cells, strict=True)), title, left=["unit"])


def _cells(
    estimate: Estimate, truths: Mapping[str, float], short: bool
) -> tuple[dict[str, str], dict[str, str]]:
    """Values with sigmas by name; errors in sigmas of what is identifiable and known."""
    numbers, errors = {}, {}
    rows = zip(
        estimate.names, estimate.values.tolist(), estimate.sigma.tolist(), strict=True
    )
    for name, value, sigma in rows:
        brief = short or name in estimate.unidentifiable
        numbers[name] = number_with_sigma(value, sigma, brief)
        if name in truths and math.isfinite(sigma):
            errors[name] = f"{(value - truths[name]) / sigma if sigma else 0.0:+.1f}"
    return numbers, errors


def quality_lines(estimates: Iterable[Estimate]) -> list[str]:
    """One line an estimate: number of unknowns, condition, noise, residual of each channel."""
    lines = []
    for e in estimates:
        fits = ", ".join(
            f"{c} {r:.3g}" for c, r in zip(e.channels, e.residual, strict=True)
        )
        lines.append(
            f"{e.instrument}: {plural(len(e.names), 'unknown')}, condition {e.condition:.1f}, "
            f"{_noise(e)}"
            f"residual rms {fits}"
        )
        lines += [f"{e.instrument}: {part}" for part in _instrument(e)]
    return lines


def _instrument(estimate: Estimate) -> list[str]:
    """What was estimated of the instrument, a line each kind; whether sigma is to be doubted."""
    kinds: dict[str, list[str]] = {}
    for each in estimate.nuisances:
        number = (
            f"{each.name} {each.value:.4g} +- {each.sigma:.2g} {each.unit}".rstrip()
        )
        kinds.setdefault(each.kind, []).append(number)
    lines = [", ".join(numbers) for numbers in kinds.values()]
    if estimate.doubtful:
        lines.append(
            "standard deviations do not include the errors that the warnings name"
        )
    return lines


def _noise(estimate: Estimate) -> str:
    """How long the noise lasts and what that does to sigma."""
    noise = estimate.noise
    if noise is None:
        return ""
    constants = ", constants estimated" if noise.bias_weight > 0.5 else ""
    hidden = [name for name in noise.hidden if name not in estimate.unidentifiable]
    rests = f", zero plate offset assumed for {', '.join(hidden)}" if hidden else ""
    return (
        f"noise correlation time {max(noise.memory):.2g} s (bootstrap factor {noise.factor:.2f}"
        f"{constants}{rests}), "
    )


def choice_lines(estimates: Iterable[Estimate]) -> Iterator[str]:
    """Which terms were chosen, with the evidence, for all estimates that chose.

    Args:
        estimates: Of one recording.
    """
    for estimate in estimates:
        if estimate.choice is not None:
            yield from (printable(line) for line in _choice_lines(estimate.choice))


def _choice_lines(choice: TermChoice) -> Iterator[str]:
    first, *added = choice.growth.steps
    yield f"terms, by {choice.parts}-fold cross-validation: {_left(choice.before)}"
    before = first.residual
    for step in added:
        better = f"{100 * before:.2f} % -> {100 * step.residual:.2f} %"
        yield f"  + {step.kind}: {better} in noise, {step.gain:.1f} standard errors"
        before = step.residual
    if choice.growth.next_best is not None:
        left = choice.growth.next_best
        yield f"  not {left.kind}: {left.gain:.1f} standard errors, 2 are required"
    yield f"with all of them: {_left(choice.after)}"


def _left(found: HeldOut) -> str:
    units = set(found.units)
    whole = f"rms {found.rms:.3f} {units.pop()} (" if len(units) == 1 else "rms ("
    named = zip(found.channels, found.residual, strict=True)
    return f"{whole}{', '.join(f'{name} {left:.3g}' for name, left in named)})"


def payload_table(found: PayloadEstimate, title: str = "") -> Table:
    """The ten parameters: value and sigma, or that a parameter is identifiable in combination only.

    Args:
        found: The payload.
        title: Of the table; default which link carries the payload.
    """
    numbers = numbers_with_sigma(found.values, found.sigma, short=True)
    said = [
        number if identifiable else "only in combination"
        for number, identifiable in zip(numbers, found.identifiable, strict=True)
    ]
    columns = {"": found.names, "value": said, "unit": found.units}
    title = title or f"payload on the link of {found.joint}, about and along its frame"
    return Table.of(columns, title, left=["unit"])


def scales_table(found: TorqueScales) -> Table:
    """What torques are of the true ones, joint by joint.

    Args:
        found: By a known payload.
    """
    numbers = numbers_with_sigma(found.values, found.sigma)
    columns = {"joint": found.names, "reported over true torque": numbers}
    return Table.of(columns, "divide torques, or gains, by")


def payload_lines(found: PayloadEstimate) -> list[str]:
    """How much is identifiable, and the centre of mass, a sentence each.

    Args:
        found: The payload.
    """
    count = sum(found.identifiable)
    lines = [
        f"{count} of ten are identifiable alone, {plural(found.rank, 'combination')} in all."
    ]
    centre = found.centre
    if centre is not None:
        lines.append(f"Centre of mass: {_place(*centre)}.")
    return lines


def tool_lines(found: ToolEstimate) -> list[str]:
    """A tool by static poses, a sentence each.

    Args:
        found: The tool.
    """

    def each(values: Sequence[tuple[float, float]], unit: str) -> str:
        return f"{', '.join(numbers_with_sigma(*np.transpose(values)))} {unit}"

    force, moment = found.residual
    angle, doubt = np.rad2deg(found.tilt).tolist()
    direction = ", ".join(f"{x:.4f}" for x in found.gravity)
    parts = {
        "mass and gravity": f"Mass: {each([found.mass], 'kg')}. Direction of gravity in the base "
        f"frame: {direction}, {each([(angle, doubt)], 'degrees')} from the model's.",
        "centre": f"Centre of mass in the sensor's frame: {each(found.centre, 'm')}.",
        "force zero": f"Force zero: {each(found.force_zero, 'N')}.",
        "moment zero": f"Moment zero: {each(found.moment_zero, 'N m')}.",
    }
    lines = [line for name, line in parts.items() if name not in found.unidentifiable]
    lines.append(f"{found.poses} poses; residuals {force:.3g} N, {moment:.3g} N m rms.")
    return lines


def _place(centre: Array, sigma: Array) -> str:
    numbers = numbers_with_sigma(centre, np.nan_to_num(sigma))
    said = (
        f"{axis} {number} m" if known else f"{axis} not identifiable"
        for axis, number, known in zip("xyz", numbers, np.isfinite(centre), strict=True)
    )
    return ", ".join(said)


def instrument_tables(run: Run) -> list[Table]:
    """Numbers of the instrument and faults looked for; none without the plate's estimate.

    Args:
        run: The run.
    """
    return [
        table for estimate in run.estimates.values() for table in _of_estimate(estimate)
    ]


def _of_estimate(estimate: Estimate) -> Iterator[Table]:
    if estimate.nuisances:
        rows = [
            [n.name, n.unit, f"{n.value:.4g}", f"{n.sigma:.2g}"]
            for n in estimate.nuisances
        ]
        yield Table(
            ["what", "unit", "value", "std"], rows, "Estimated with the parameters"
        )
    if estimate.model_errors:
        heads = ["model error", "gain", "rms", "part", "channel", "treated", "size"]
        rows = [_model_error(estimate, each) for each in estimate.model_errors]
        yield Table(heads, rows, "Errors of the model that the residuals show")
    found = estimate.repeatable
    if found is not None:
        columns = zip(
            estimate.channels,
            found.rms,
            estimate.channel_units,
            found.share,
            strict=True,
        )
        yield Table(
            ["channel", "rms", "part"],
            [
                [channel, f"{rms:.2g} {unit}", f"{share:.0%}"]
                for channel, rms, unit, share in columns
            ],
            f"Part of the residuals that repeats with the motion {found.again}: "
            f"chance {_chance(found.chance)} if it were noise",
        )


def _chance(chance: float) -> str:
    return "below 1e-99" if chance < 1e-99 else f"{chance:.2g}"


def _model_error(estimate: Estimate, error: ModelErrorEstimate) -> list[str]:
    most = int(np.argmax(np.nan_to_num(error.share)))
    return [
        error.label,
        f"{error.gain:.0f}",
        f"{error.effect[most]:.2g} {estimate.channel_units[most]}",
        f"{error.share[most]:.0%}",
        estimate.channels[most],
        treatment(error),
        numbers(error),
    ]


def plate_table(plate: Calibration) -> Table:
    """The matrix of a plate.

    Args:
        plate: The calibration.
    """
    numbers = numbers_with_sigma(plate.matrix, plate.matrix_sigma, short=True)
    known = [f"{value:.6g}" for value in plate.matrix.ravel()]
    sigmas = plate.matrix_sigma.ravel()
    cells = np.where(sigmas > 0, numbers, known).reshape(plate.matrix.shape).tolist()
    rows = [[name, *row] for name, row in zip(AXES, cells, strict=True)]
    title = "what a channel (row) shows of a component of the wrench (column)"
    return Table(["", *AXES], rows, title, parts=(range(1, 4), range(4, 7)))


def plate_lines(plate: Calibration) -> list[str]:
    """The other numbers, a line each kind.

    Args:
        plate: The calibration.
    """
    kinds: dict[str, list[str]] = {}
    for each in plate.numbers:
        if each.kind != "matrix":
            number = (
                f"{each.name} {number_with_sigma(each.value, each.sigma)} {each.unit}"
            )
            kinds.setdefault(each.kind, []).append(number.rstrip())
    return [", ".join(numbers) for numbers in kinds.values()]
