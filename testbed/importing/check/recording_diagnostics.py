"""Diagnostics of a recording before any estimation: spikes, ranges, rest, plate, mapping."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnostic, make_diagnostic
from testbed.core.base.errors import round_significant, shortened_list, vector_text
from testbed.core.recordings.channels import ChannelFault
from testbed.core.recordings.columns import MIN_MOTION_RANGE, WRENCH_COMPONENTS
from testbed.core.recordings.recording import Recording
from testbed.core.recordings.source import Source
from testbed.core.robot.tree import Tree
from testbed.importing.check.explanation import Explanation
from testbed.importing.check.instants import Instants
from testbed.importing.check.plate import CROSSTALK_SHARE, UNEXPLAINED_SHARE
from testbed.importing.check.remedies import (
    HYPOTHESIS_KINDS,
    Hypothesis,
    Remedy,
    joints_without_free_base,
)
from testbed.importing.import_report import mapping_advice

MAX_NOISE_MOTION, ROUNDING_TOLERANCE = 1e-2, 1e-9
"""Motion of joints below which noise is no motion [rad or m]; relative change of a constant by the
rounding of a filter."""

SPIKE_SHARE, SPIKE_COUNT, MAX_SPIKE_SAMPLES = 1e-3, 5, 3
"""Largest share, and number, of samples in spikes; samples after which a spike has ended."""

OUTLIER_RANGES, MIN_RANGE_SHARE = 2.0, 1e-2
"""Distance of spikes from the other samples, in ranges of these; and least range of a channel,
relative to the largest range among the signal's channels."""

SPIKE_TEXT_LENGTH, RANGE_TEXT_LENGTH = 60, 110
"""Largest number of characters for a list of spikes, and of ranges."""

MOVING_RESIDUAL = 0.1
"""Unexplained share of a torque's variance from which a joint at rest by its position does move."""

NOISE_FACTOR = 3.0
"""Factor on a channel's noise share when residuals are compared."""

MIN_WEIGHT_RATIO = -0.1
"""Weight on the plate, relative to the robot's weight, below which it is implausibly negative."""

MIN_PEDESTAL_SHARE = 0.03
"""Mass of a pedestal, relative to the robot's mass, below which the plate's reading does not show
it."""

WARNING_FACTOR, ERROR_FACTOR = 2.5, 4.0
"""Ratios of torques to those of the model file's masses from which a warning, or an error, is
raised."""

THOUSANDTH_UNITS = {"N m": "N mm", "A": "mA", "V": "mV", "kN m": "N m", "N": "mN"}
"""Units a thousand times smaller, by unit."""

MIN_IMPROVEMENT = 1.2
"""Ratio of the unexplained shares without and with the remedies from which they are reported."""


def percentage(part: float) -> str:
    """Share of a channel's variance, formatted as a percentage.

    Args:
        part: Share, 1 for 100 %.
    """
    return f"{100 * min(part, 1.0):.3g}%"


def check_spikes(recording: Recording) -> Iterator[Diagnostic]:
    """Yield a diagnostic for each channel with a few samples far outside all others.

    Far means over two ranges beyond the channel's quantiles (0.1 %, or 5 samples, at either end);
    few means that no two of these samples are 3 samples apart.

    Args:
        recording: Recording, or a part of it.
    """
    for signal in ("position", "torque", "wrench"):
        if signal not in recording.signals:
            continue
        values = recording.measured(signal)
        level = min(max(SPIKE_COUNT / len(values), SPIKE_SHARE), 0.25)
        low, high = np.quantile(values, [level, 1 - level], axis=0)
        margin = OUTLIER_RANGES * np.maximum(
            high - low, MIN_RANGE_SHARE * (high - low).max()
        )
        outside = (values < low - margin) | (values > high + margin)
        lasting = outside[MAX_SPIKE_SAMPLES:] & outside[:-MAX_SPIKE_SAMPLES]
        for k in np.flatnonzero(outside.any(axis=0) & ~lasting.any(axis=0)):
            name = f"the {signal} of '{recording.names[k]}'"
            if signal == "wrench":
                name = f"the plate's {WRENCH_COMPONENTS[k]}"
            samples = np.flatnonzero(outside[:, k])
            spike_list = shortened_list(
                [f"{values[i, k]:.4g} at {recording.time[i]:.6g} s" for i in samples],
                SPIKE_TEXT_LENGTH,
            )
            yield make_diagnostic(
                "channel.spikes",
                name,
                len(samples),
                spikes=spike_list,
                low=low[k],
                high=high[k],
            )


def check_position_ranges(tree: Tree, position: Array) -> Iterator[Diagnostic]:
    """Yield a diagnostic if positions exceed a joint's range by more than the range's width.

    Args:
        tree: Robot.
        position: Joint positions, (M, n) [rad or m].
    """
    low, high = np.array([joint.position_range for joint in tree.joints]).T
    minimum, maximum = position.min(axis=0), position.max(axis=0)
    width = high - low
    joints = np.flatnonzero((minimum < low - width) | (maximum > high + width))
    if not joints.size:
        return
    lines = [
        f"'{tree.names[k]}' {minimum[k]:.4g} to {maximum[k]:.4g} (its range is {low[k]:.4g} to "
        f"{high[k]:.4g} {'rad' if tree.joints[k].revolute else 'm'})"
        for k in joints
    ]
    turning = any(tree.joints[k].revolute for k in joints)
    cause, unit = ("degrees", "deg") if turning else ("millimetres", "mm")
    yield make_diagnostic(
        "position.range",
        "positions",
        len(lines),
        causes=(cause, "motor-side"),
        ranges=shortened_list(lines, RANGE_TEXT_LENGTH),
        unit=unit,
    )


def check_rest(tree: Tree, instants: Instants) -> Iterator[Diagnostic]:
    """Yield a diagnostic if the robot does not move, or the plate's wrench is constant.

    Args:
        tree: Robot.
        instants: Low-pass filtered signals of the recording.
    """
    position = instants.motion.q[:, list(joints_without_free_base(tree))]
    motion, wrench = np.ptp(position, axis=0).max(initial=0.0), instants.wrench
    # in a wrong unit noise may be larger; unlike motion, it changes from instant to instant
    noise = (np.diff(position, axis=0).var(axis=0) > position.var(axis=0)).all()
    if position.size and motion < (MAX_NOISE_MOTION if noise else MIN_MOTION_RANGE):
        yield make_diagnostic("robot.rest", "the robot", motion)
    elif (
        wrench.size
        and np.ptp(wrench, axis=0).max() <= ROUNDING_TOLERANCE * np.abs(wrench).max()
    ):
        yield make_diagnostic(
            "plate.silent", "the plate", 0.0, wrench=vector_text(wrench[0])
        )


def check_still_joints(
    tree: Tree, instants: Instants, unexplained: Array
) -> Iterator[Diagnostic]:
    """Yield a diagnostic of resting joints whose torques show motion, or of resting joints.

    Args:
        tree: Robot.
        instants: Low-pass filtered signals of the recording.
        unexplained: Unexplained shares of the torques' variance, (n,) or (0,); above 0.1 a torque
            shows motion.
    """
    position = instants.motion.q
    still = [
        k
        for k in joints_without_free_base(tree)
        if np.ptp(position[:, k]) < MIN_MOTION_RANGE
    ]
    moving = [k for k in still if unexplained.size and unexplained[k] > MOVING_RESIDUAL]
    if moving:
        yield make_diagnostic(
            "position.still",
            shortened_list([tree.names[k] for k in moving]),
            len(moving),
        )
    elif still:
        positions = position.mean(axis=0)
        resting = [f"{tree.names[k]} at {positions[k]:.4g}" for k in still]
        yield make_diagnostic("position.held", shortened_list(resting))


def check_plate_residual(best: Explanation) -> Iterator[Diagnostic]:
    """Yield a diagnostic if no hypothesis explains the force plate's channels.

    Unexplained variance, beyond 3 times the noise, is a warning above 0.3 % and an error above 5 %.

    Args:
        best: Best explanation of the recording.
    """
    evidence, plate = best.fit.plate, best.plate
    if plate.is_explained(CROSSTALK_SHARE):
        return
    shares, noise = plate.unexplained, plate.noise
    channel = int(np.argmax(shares - NOISE_FACTOR * noise))
    certain = not plate.is_explained(UNEXPLAINED_SHARE)
    yield make_diagnostic(
        "plate.crosstalk" if evidence.has_crosstalk(shares) else "plate.foreign",
        "the plate",
        shares[channel],
        level="error" if certain else "warning",
        channel=WRENCH_COMPONENTS[channel],
        share=percentage(shares[channel]),
        mixed=percentage(evidence.least_residual_share),
    )


def check_weight_sign(best: Explanation, tare: Array | None) -> Iterator[Diagnostic]:
    """Yield a diagnostic of a weight on the plate below -10 % of the robot's weight.

    Args:
        best: Best explanation of the recording, which has a wrench.
        tare: Stated wrench on the plate without the robot, as for `ScaledPrior.zero_wrench`.
    """
    tree = best.fit.prior.tree
    if tree.sensor is not None:
        return  # a sensor that moves with a link: the mean force is no weight
    carried, force = carried_mass(best, tare)
    if (
        carried * np.linalg.norm(tree.gravity)
        < MIN_WEIGHT_RATIO * best.fit.prior.weight
    ):
        yield make_diagnostic(
            "plate.weight", "the plate", carried, force=vector_text(force)
        )


def carried_mass(best: Explanation, tare: Array | None) -> tuple[float, Array]:
    """Mass [kg] and mean force, (3,) [N], on the plate above its zero wrench.

    Args:
        best: Best explanation of the recording, which has a wrench.
        tare: Stated wrench on the plate without the robot, as for `ScaledPrior.zero_wrench`.
    """
    prior = best.fit.prior
    force = (best.fit.plate.wrench(best.plate).mean(axis=0) - prior.zero_wrench(tare))[
        :3
    ]
    size = float(np.linalg.norm(prior.tree.gravity))
    return (float(-force @ prior.tree.gravity / size**2) if size else 0.0), force


def robot_masses(best: Explanation) -> tuple[float, float, float] | None:
    """Robot masses [kg] measured with and without pedestal, and stated in the model.

    The result is None if the model's pedestal is below 3 % of the robot's mass.

    Args:
        best: Best explanation of the recording, which has a wrench.
    """
    tree = best.fit.prior.tree
    file, pedestal_mass = sum(each.mass for each in tree.inertias), tree.pedestal.mass
    if pedestal_mass < MIN_PEDESTAL_SHARE * file:
        return None
    included, without = (carried_mass(best, tare)[0] for tare in (None, np.zeros(6)))
    return included, without, float(file)


def check_unstated_pedestal(
    best: Explanation, mapping: Mapping[str, Any]
) -> Iterator[Diagnostic]:
    """Yield a diagnostic if the plate's wrench excludes the pedestal and the mapping omits this.

    Args:
        best: Best explanation of the recording.
        mapping: Content of the recording's mapping file; empty if there is no mapping.
    """
    table = mapping.get("wrench")
    masses = (
        robot_masses(best)
        if table and not {"pedestal", "tare"} & table.keys()
        else None
    )
    if masses is not None and is_pedestal_removed(*masses):
        pedestal = best.fit.prior.tree.pedestal.mass
        yield make_diagnostic(
            "plate.pedestal",
            "the plate",
            masses[0],
            pedestal=pedestal,
            other=masses[1],
            file=masses[2],
        )


def is_pedestal_removed(included: float, without: float, file: float) -> bool:
    """Test whether the measured wrench agrees better with the model's mass without the pedestal.

    Args:
        included: Mass of the robot if the measured wrench includes the pedestal [kg].
        without: Mass of the robot if the measured wrench excludes the pedestal [kg].
        file: Mass of the robot in the model file [kg].
    """
    ratios = np.maximum([included, without], 1e-9) / file
    return bool(np.diff(np.abs(np.log(ratios)))[0] < 0)


def plate_zero_diagnostic(remedy: Remedy) -> Diagnostic:
    """Diagnostic of a force plate whose only error is a shifted zero.

    Args:
        remedy: Remedy of the kind `tare`.
    """
    return make_diagnostic(
        "plate.zero",
        "the plate",
        np.abs(remedy.values).max(),
        causes=(HYPOTHESIS_KINDS["tare"].words,),
        wrench=vector_text(remedy.values),
        lines=mapping_advice(remedy.lines),
    )


def wrong_mapping_diagnostic(
    tree: Tree,
    remedies: Sequence[Remedy],
    equals: Sequence[str],
    gain: float,
    *,
    certain: bool,
) -> Diagnostic:
    """Diagnostic of a mapping that the data contradict, with the corrected lines.

    Args:
        tree: Robot.
        remedies: Corrections, to be applied together.
        equals: Descriptions of alternative explanations.
        gain: Log-likelihood ratio of the data with the remedies [nats].
        certain: True for an error, False for a warning.
    """
    names = list(dict.fromkeys(name for each in remedies for name in each.joints))
    joints = (
        f"joint '{names[0]}'" if len(names) == 1 else f"joints {shortened_list(names)}"
    )
    if len(names) == len(joints_without_free_base(tree)) > 1:
        joints = "all joints"
    tables = [HYPOTHESIS_KINDS[each.kind].table for each in remedies]
    subjects = ["the plate"] * ("wrench" in tables) + ["the base"] * ("base" in tables)
    main_remedy = max(remedies, key=lambda each: each.before - each.after)
    improved = main_remedy.before > MIN_IMPROVEMENT * main_remedy.after
    return make_diagnostic(
        "mapping.wrong" if improved else "mapping.unlikely",
        " and ".join([*subjects, *[joints][: len(names)]]),
        main_remedy.before,
        level="error" if certain else "warning",
        causes=[
            " and ".join(
                dict.fromkeys(HYPOTHESIS_KINDS[each.kind].words for each in remedies)
            )
        ],
        before=percentage(main_remedy.before),
        after=percentage(main_remedy.after),
        channel=main_remedy.channel,
        gain=gain,
        equals=", or ".join(equals),
        lines=mapping_advice(line for each in remedies for line in each.lines),
    )


def check_torque_scales(
    tree: Tree, sizes: Array, mapping: Mapping[str, Any], *, certain: bool
) -> Iterator[Diagnostic]:
    """Yield a diagnostic of torques 2.5 times larger or smaller than predicted.

    Args:
        tree: Robot.
        sizes: Torques relative to the prediction from the model's masses, nan if unknown, (n,) or
            (0,).
        mapping: Content of the recording's mapping file; empty if there is no mapping.
        certain: True if scale factors explain the torques far better: ratios above 4 are then
            errors.
    """
    factors = np.maximum(sizes, 1 / sizes)
    certain = certain and bool((factors >= ERROR_FACTOR).any())
    joints = np.flatnonzero(factors >= (ERROR_FACTOR if certain else WARNING_FACTOR))
    if not joints.size:
        return
    too_small = bool((sizes[joints] < 1).all())
    unit = str((mapping.get("torque") or {}).get("unit"))
    units = (
        {larger: smaller for smaller, larger in THOUSANDTH_UNITS.items()}
        if too_small
        else THOUSANDTH_UNITS
    )
    causes: tuple[str, ...] = ("tool", "other-masses", "unit-n-mm")
    lines = "[torque] unit; or add the tool to the model file"
    if unit in units and 0.5 < np.nanmedian(sizes) * (1e3 if too_small else 1e-3) < 2.0:
        causes, lines = ("unit-n-mm",), f'[torque] unit = "{units[unit]}"'
    elif too_small:
        causes = ("motor-side", "currents")
        gains = ", ".join(
            f"{round_significant(1 / x, 5):g}" if x > 0 else "?" for x in sizes
        )
        lines = (
            f'[torque] side = "motor" with a table [gear] (ratio about [{gains}]), or '
            f'unit = "A" with gain about [{gains}]'
        )
    yield make_diagnostic(
        "torque.size",
        "the torque",
        sizes[joints[0]],
        level="error" if certain else "warning",
        causes=causes,
        size="small" if too_small else "large",
        sizes=", ".join(f"{tree.names[k]} {sizes[k]:.2g}" for k in joints[:6]),
        lines=lines,
    )


def check_undetermined_positions(
    tree: Tree, hypotheses: Sequence[Hypothesis]
) -> Iterator[Diagnostic]:
    """Yield a diagnostic of position zeros, signs and orders that the data do not determine.

    Args:
        tree: Robot.
        hypotheses: Hypotheses that explain the recording about as well as the recorded positions.
    """
    parts = []
    for kind in ("zero", "position_sign", "position_order"):
        joints = sorted(
            {k for each in hypotheses if each.kind == kind for k in each.joints}
        )
        if joints:
            property_name = kind.removeprefix("position_")
            parts.append(
                f"the {property_name} of {shortened_list([tree.names[k] for k in joints])}"
            )
    if parts:
        yield make_diagnostic("recording.undecided", "; ".join(parts))


ENCODER_STEP_CODES = ("position.step", "position.unwrapped")
"""Codes of diagnostics of encoder steps, from the import."""


def encoder_step_diagnostics(source: Source) -> list[Diagnostic]:
    """Diagnostics of encoder steps from the import of a recording.

    Args:
        source: Recording.
    """
    return [
        each for each in source.metadata.diagnostics if each.code in ENCODER_STEP_CODES
    ]


def check_assumed_gains(source: Source) -> Iterator[Diagnostic]:
    """Yield a diagnostic if torque constants are computed from the model file's masses.

    Args:
        source: Recording.
    """
    mapping = source.metadata.mapping or {}
    if (mapping.get("torque") or {}).get("gain_from") == "model":
        yield make_diagnostic("torque.gains", "the torque")


DELAY_HIDING_FAULTS = (
    "clipped",
    "dead",
    "stuck",
    "slow",
    "copied",
    "magnitude",
    "smoothed",
)
"""Faults of torques that make the torques' delay undeterminable."""


def signals_to_align(source: Source, faults: Iterable[ChannelFault]) -> list[str]:
    """Signals whose delay is estimated: the wrench, and torques with a separate clock.

    Args:
        source: Recording.
        faults: Faults of the recording's channels; torques with `DELAY_HIDING_FAULTS` are omitted.
    """
    mapping = source.metadata.mapping or {}
    torque, position = (
        (mapping.get(each) or {}).get("source") for each in ("torque", "position")
    )
    faulty = any(
        each.signal == "torque" and each.kind in DELAY_HIDING_FAULTS for each in faults
    )
    return ["wrench"] if faulty or torque == position else ["torque", "wrench"]
