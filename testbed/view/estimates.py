"""Tables and sentences of estimates, instruments, payloads, tools, force-plate calibrations."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from testbed.applications.calibration import Calibration
from testbed.core.base.arrays import Array
from testbed.core.base.errors import count_with_noun, printable_line
from testbed.core.base.summary_table import number_with_sigma, numbers_with_sigma
from testbed.core.estimation.diagnostics.model_errors import coefficient_text, treatment
from testbed.core.estimation.diagnostics.residuals import p_value_text
from testbed.core.estimation.estimate import Estimate
from testbed.core.estimation.influence import names_by_influence
from testbed.core.estimation.model_errors.estimates import ModelErrorEstimate
from testbed.core.estimation.selection.held_out import TermChoice, TestResiduals
from testbed.core.recordings.columns import WRENCH_COMPONENTS
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
    max_rows: int | None = None,
) -> Iterator[list[Table]]:
    """Yield layouts of the table of parameters, from wide to narrow.

    The layouts are one table with 1.061 +- 0.001, one table with 1.061(1) and without units, and
    one table per method. Columns are the value with sigma and, if the truth is known, the error in
    sigmas. The parameters are in the order of decreasing influence on the predicted signals.

    Args:
        estimates: Estimates from one recording, one per method.
        truths: True values by name; {} if unknown.
        title: Title of the tables.
        max_rows: Largest number of rows; None for all parameters.
    """
    names = names_by_influence(estimates, truths)[:max_rows]
    yield [_parameter_table(estimates, names, truths, title, short=False)]
    yield [_parameter_table(estimates, names, truths, title, short=True)]
    yield [
        _parameter_table([each], names, truths, title, short=True) for each in estimates
    ]


def _parameter_table(
    estimates: Sequence[Estimate],
    names: Sequence[str],
    truths: Mapping[str, float],
    title: str,
    *,
    short: bool,
) -> Table:
    """Table with one row per parameter: unit, truth, value and error in sigmas by method.

    Args:
        estimates: Estimates, one per method.
        names: Names of the parameters in the order of rows; those that no estimate has are skipped.
        truths: True values by name; {} if unknown.
        title: Title of the table.
        short: True to write 1.0610(9) instead of 1.0610 +- 0.0009, and to omit units.
    """
    units = {
        name: unit
        for e in estimates
        for name, unit in zip(e.names, e.units, strict=True)
    }
    names = [name for name in names if name in units]
    columns: dict[str, list[str]] = {"parameter": names}
    if not short:
        columns["unit"] = [units[name] for name in names]
    if truths:
        columns["truth"] = [
            f"{truths[name]:.6g}" if name in truths else "-" for name in names
        ]
    heads = [*columns]
    cells = [*columns.values()]
    for estimate in estimates:
        numbers, errors = _parameter_cells(estimate, truths, short)
        heads.append(estimate.instrument)
        cells.append([numbers.get(name, "-") for name in names])
        if truths:
            heads.append("z" if short else "error/std")
            cells.append([errors.get(name, "") for name in names])
    return Table(heads, list(zip(*cells, strict=True)), title, left=["unit"])


def _parameter_cells(
    estimate: Estimate, truths: Mapping[str, float], short: bool
) -> tuple[dict[str, str], dict[str, str]]:
    """Texts of the values and of the normalised errors of an estimate, keyed by parameter.

    The normalised error is (value - truth) / sigma, or zero where sigma is zero. It is given for
    parameters with known truth and finite sigma.

    Args:
        estimate: The estimate.
        truths: True values by name; {} if unknown.
        short: True to write 1.0610(9) instead of 1.0610 +- 0.0009.
    """
    numbers, errors = {}, {}
    rows = zip(
        estimate.names, estimate.values.tolist(), estimate.sigma.tolist(), strict=True
    )
    for name, value, sigma in rows:
        is_short = short or name in estimate.unidentifiable
        numbers[name] = number_with_sigma(value, sigma, is_short)
        if name in truths and math.isfinite(sigma):
            errors[name] = f"{(value - truths[name]) / sigma if sigma else 0.0:+.1f}"
    return numbers, errors


def fit_quality_lines(estimates: Iterable[Estimate]) -> list[str]:
    """Lines on number of unknowns, condition number, noise, and rms residuals by channel.

    For each estimate, lines with the coefficients of sensor errors follow.

    Args:
        estimates: Estimates from one recording.
    """
    lines = []
    for estimate in estimates:
        residuals = ", ".join(
            f"{channel} {rms:.3g}"
            for channel, rms in zip(estimate.channels, estimate.residual, strict=True)
        )
        lines.append(
            f"{estimate.instrument}: {count_with_noun(len(estimate.names), 'unknown')}, "
            f"condition {estimate.condition:.1f}, {_noise_text(estimate)}"
            f"residual rms {residuals}"
        )
        lines += [
            f"{estimate.instrument}: {part}" for part in _sensor_error_lines(estimate)
        ]
    return lines


def _sensor_error_lines(estimate: Estimate) -> list[str]:
    """Lines with the estimated coefficients of sensor errors, one line per kind of error.

    If the estimate has diagnostics of level "error", the last line is a warning that the standard
    deviations do not include these errors.
    """
    kinds: dict[str, list[str]] = {}
    for each in estimate.nuisances:
        number = (
            f"{each.name} {each.value:.4g} +- {each.sigma:.2g} {each.unit}".rstrip()
        )
        kinds.setdefault(each.kind, []).append(number)
    lines = [", ".join(numbers) for numbers in kinds.values()]
    if estimate.has_errors:
        lines.append(
            "standard deviations do not include the errors that the warnings name"
        )
    return lines


def _noise_text(estimate: Estimate) -> str:
    """Text with the noise's longest correlation time and the bootstrap factor of the sigmas.

    It also states whether constant offsets of the channels were estimated, and which parameters
    assume a plate offset of zero. It is "" without a noise model.
    """
    noise = estimate.noise
    if noise is None:
        return ""
    constants = ", constants estimated" if noise.bias_weight > 0.5 else ""
    assumed_zero = [
        name for name in noise.hidden if name not in estimate.unidentifiable
    ]
    assumption = (
        f", zero plate offset assumed for {', '.join(assumed_zero)}"
        if assumed_zero
        else ""
    )
    return (
        f"noise correlation time {max(noise.memory):.2g} s (bootstrap factor {noise.factor:.2f}"
        f"{constants}{assumption}), "
    )


def choice_lines(estimates: Iterable[Estimate]) -> Iterator[str]:
    """Yield lines on joint terms selected by cross-validation.

    Estimates whose terms were not selected are skipped.

    Args:
        estimates: Estimates from one recording.
    """
    for estimate in estimates:
        if estimate.choice is not None:
            yield from (
                printable_line(line) for line in _selection_lines(estimate.choice)
            )


def _selection_lines(choice: TermChoice) -> Iterator[str]:
    """Yield lines on one forward selection of joint terms.

    They contain the rms test residuals with the default terms; for each added term, the relative
    residual and the gain in standard errors; the gain of the best rejected term; and the rms test
    residuals with all selected terms.
    """
    first, *added_steps = choice.growth.steps
    yield f"terms, by {choice.parts}-fold cross-validation: {_residuals_text(choice.before)}"
    previous = first.residual
    for step in added_steps:
        change = f"{100 * previous:.2f} % -> {100 * step.residual:.2f} %"
        yield f"  + {step.kind}: {change} in noise, {step.gain:.1f} standard errors"
        previous = step.residual
    if choice.growth.next_best is not None:
        next_best = choice.growth.next_best
        yield f"  not {next_best.kind}: {next_best.gain:.1f} standard errors, 2 are required"
    yield f"with all of them: {_residuals_text(choice.after)}"


def _residuals_text(residuals: TestResiduals) -> str:
    """Text with the rms test residuals, by channel and overall.

    There is no overall value if channels have different units (N and N m).
    """
    units = set(residuals.units)
    overall = f"rms {residuals.rms:.3f} {units.pop()} (" if len(units) == 1 else "rms ("
    pairs = zip(residuals.channels, residuals.residual, strict=True)
    return f"{overall}{', '.join(f'{name} {rms:.3g}' for name, rms in pairs)})"


def payload_table(payload: PayloadEstimate, title: str = "") -> Table:
    """Table of a payload's ten inertial parameters, with sigma and unit.

    The rows are m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz, about the origin and along the axes of
    the carrying link's frame. The text "only in combination" replaces values that are not
    identifiable individually.

    Args:
        payload: The payload.
        title: Title of the table; default a title with the name of the joint that moves the link.
    """
    numbers = numbers_with_sigma(payload.values, payload.sigma, short=True)
    values = [
        number if identifiable else "only in combination"
        for number, identifiable in zip(numbers, payload.identifiable, strict=True)
    ]
    columns = {"": payload.names, "value": values, "unit": payload.units}
    title = (
        title or f"payload on the link of {payload.joint}, about and along its frame"
    )
    return Table.from_columns(columns, title, left=["unit"])


def torque_scales_table(scales: TorqueScales) -> Table:
    """Table of ratios of reported to true torque for each joint, from a known payload.

    Args:
        scales: Torque scales.
    """
    numbers = numbers_with_sigma(scales.values, scales.sigma)
    columns = {"joint": scales.names, "reported over true torque": numbers}
    return Table.from_columns(columns, "divide torques, or gains, by")


def payload_lines(payload: PayloadEstimate) -> list[str]:
    """Sentences on a payload's number of identifiable parameters and centre of mass.

    The centre of mass, in the frame of the carrying link, is left out if the estimate has none.

    Args:
        payload: The payload.
    """
    count = sum(payload.identifiable)
    lines = [
        f"{count} of ten are identifiable alone, "
        f"{count_with_noun(payload.rank, 'combination')} in all."
    ]
    centre = payload.centre
    if centre is not None:
        lines.append(f"Centre of mass: {_centre_text(*centre)}.")
    return lines


def tool_lines(tool: ToolEstimate) -> list[str]:
    """Sentences on a tool estimated from static poses: mass, gravity, centre of mass, zeros.

    Gravity is in the base frame, the other vectors are in the sensor's frame. Quantities in
    `unidentifiable` are omitted. The number of poses and the rms residuals come last.

    Args:
        tool: The tool.
    """

    def texts(values: Sequence[tuple[float, float]], unit: str) -> str:
        return f"{', '.join(numbers_with_sigma(*np.transpose(values)))} {unit}"

    force, moment = tool.residual
    angle, angle_sigma = np.rad2deg(tool.tilt).tolist()
    direction = ", ".join(f"{x:.4f}" for x in tool.gravity)
    parts = {
        "mass and gravity": f"Mass: {texts([tool.mass], 'kg')}. Direction of gravity in the base "
        f"frame: {direction}, {texts([(angle, angle_sigma)], 'degrees')} from the model's.",
        "centre": f"Centre of mass in the sensor's frame: {texts(tool.centre, 'm')}.",
        "force zero": f"Force zero: {texts(tool.force_zero, 'N')}.",
        "moment zero": f"Moment zero: {texts(tool.moment_zero, 'N m')}.",
    }
    lines = [line for name, line in parts.items() if name not in tool.unidentifiable]
    lines.append(
        f"{tool.pose_count} poses; residuals {force:.3g} N, {moment:.3g} N m rms."
    )
    return lines


def _centre_text(centre: Array, sigma: Array) -> str:
    """Text of a centre of mass with sigma, by axis [m]; "not identifiable" for nan."""
    numbers = numbers_with_sigma(centre, np.nan_to_num(sigma))
    coordinates = (
        f"{axis} {number} m" if finite else f"{axis} not identifiable"
        for axis, number, finite in zip(
            "xyz", numbers, np.isfinite(centre), strict=True
        )
    )
    return ", ".join(coordinates)


def sensor_error_tables(run: Run) -> list[Table]:
    """Tables of sensor errors, model errors and repeatable residuals in a run's estimates.

    Args:
        run: The run.
    """
    return [
        table
        for estimate in run.estimates.values()
        for table in _estimate_tables(estimate)
    ]


def _estimate_tables(estimate: Estimate) -> Iterator[Table]:
    """Yield the tables of one estimate: sensor errors, model errors, repeatable residuals.

    The first has the coefficients of sensor errors with sigma, the second the detected model
    errors, and the third, by channel, the rms and share of the residual that repeats with the
    periodic motion. A table without content is skipped.
    """
    if estimate.nuisances:
        rows = [
            [
                nuisance.name,
                nuisance.unit,
                f"{nuisance.value:.4g}",
                f"{nuisance.sigma:.2g}",
            ]
            for nuisance in estimate.nuisances
        ]
        yield Table(
            ["what", "unit", "value", "std"], rows, "Estimated with the parameters"
        )
    if estimate.model_errors:
        heads = ["model error", "gain", "rms", "part", "channel", "treated", "size"]
        rows = [_model_error_row(estimate, each) for each in estimate.model_errors]
        yield Table(heads, rows, "Errors of the model that the residuals show")
    repeatable = estimate.repeatable
    if repeatable is not None:
        columns = zip(
            estimate.channels,
            repeatable.rms,
            estimate.channel_units,
            repeatable.share,
            strict=True,
        )
        yield Table(
            ["channel", "rms", "part"],
            [
                [channel, f"{rms:.2g} {unit}", f"{share:.0%}"]
                for channel, rms, unit, share in columns
            ],
            f"Part of the residuals that repeats with the motion {repeatable.repetition_text}: "
            f"{p_value_text(repeatable.chance)} of the F test against noise",
        )


def _model_error_row(estimate: Estimate, error: ModelErrorEstimate) -> list[str]:
    """Table row of a model error: gain, rms and share in a channel, treatment, coefficient.

    The channel is the one in whose residual the error has the largest share.
    """
    channel = int(np.argmax(np.nan_to_num(error.share)))
    return [
        error.label,
        f"{error.gain:.0f}",
        f"{error.effect[channel]:.2g} {estimate.channel_units[channel]}",
        f"{error.share[channel]:.0%}",
        estimate.channels[channel],
        treatment(error),
        coefficient_text(error),
    ]


def plate_matrix_table(plate: Calibration) -> Table:
    """Table of a plate's 6 x 6 matrix from wrench components (columns) to channels (rows).

    Estimated elements have a sigma; known elements are exact.

    Args:
        plate: The calibration.
    """
    numbers = numbers_with_sigma(plate.matrix, plate.matrix_sigma, short=True)
    exact_values = [f"{value:.6g}" for value in plate.matrix.ravel()]
    sigmas = plate.matrix_sigma.ravel()
    cells = (
        np.where(sigmas > 0, numbers, exact_values).reshape(plate.matrix.shape).tolist()
    )
    rows = [[name, *row] for name, row in zip(WRENCH_COMPONENTS, cells, strict=True)]
    title = "what a channel (row) shows of a component of the wrench (column)"
    return Table(
        ["", *WRENCH_COMPONENTS], rows, title, parts=(range(1, 4), range(4, 7))
    )


def plate_coefficient_lines(plate: Calibration) -> list[str]:
    """Lines with the coefficients of a plate's calibration other than the matrix.

    There is one line per kind of sensor error.

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
