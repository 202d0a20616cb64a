"""A mapping that nobody has to write: what the columns' names leave open, solved from the data.

What is open is assumed, the recording is made, and the assessment says what the mapping must say
instead, until it finds nothing wrong. Then the clocks are aligned (`time_offset`), and the plate's
frame is refined (`correction`). Beside each value stands what it is known by.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnosed, Diagnostic, diagnose
from testbed.core.base.errors import (
    ExperimentError,
    RecordingError,
    TestbedError,
    round_significant,
)
from testbed.core.base.toml_text import checked
from testbed.core.recordings.source import Source
from testbed.core.recordings.views import on_its_base
from testbed.core.robot.inertia import from_rpy, from_vector, to_rpy
from testbed.core.robot.tree import Tree
from testbed.importing.check.check import Assessment, assess, zero_hypothesis
from testbed.importing.check.explanation import Explanation
from testbed.importing.check.plate import WrenchFit, frame_of
from testbed.importing.check.plate_map import (
    LATE,
    RATIO,
    SHIFT,
    TURN,
    rotation_vector,
    transform,
)
from testbed.importing.check.recording_diagnostics import (
    CLEARLY,
    encoder_steps,
    removed,
    share,
    weights,
)
from testbed.importing.check.search import Progress
from testbed.importing.check.time_offset import alignment, moving_average, time_offsets
from testbed.importing.convert import clock_ranges, pieces
from testbed.importing.derivative import DerivativeError
from testbed.importing.foreign_table import FORCES, MOMENTS
from testbed.importing.import_report import Draft, in_toml
from testbed.importing.mapping import Mapping as MappingFile
from testbed.importing.mapping import empty_keys

ASSUMED = "ASSUMED"
"""Mark of what neither names nor data determine."""

KNOWN = (ASSUMED, "solved", "by the data")
"""Beginnings of what is said beside a value that no name states."""

USUAL = {
    "position": ("rad", "m"), "velocity": ("rad/s", "m/s"), "acceleration": ("rad/s^2", "m/s^2"),
    "torque": ("N m", "N"), "base": ("m", "m"),
}  # fmt: skip
"""Units that are assumed, of joints that turn and of those that slide; of a base's place."""

ROUNDS = 4
"""Most times that a recording is made and assessed."""

SHORT = 10
"""Values at instants for each parameter below which data may fit another mapping as well."""

THOUSAND = 1000.0
"""Ratio of N m to N mm."""

COMMON = 0.9
"""Part of the shorter of two files that they must have in common by their clocks."""

STEPS = tuple(np.deg2rad(step) for step in (90, 45, 30, 15))
"""Of angles that a person writes [rad]."""

CLEAR = 4.0
"""Standard deviations from which a plate is late by a clock that it shares with the positions."""

FAR, LOOSE = 0.02, 1.5e-3
"""Standard deviations from which a place is not known, and may well be some millimetres off [m]."""

NEAR = 14.2
"""Squared distance, in standard deviations, below which a turn is one that a person writes: one of
three normal numbers is beyond in .3 % of all cases."""


@dataclass(frozen=True, eq=False)
class MappingSolution(Diagnosed):
    """A mapping, and how the data bear it out.

    Attributes:
        draft: The mapping, with keys still empty where no columns or no clock was found.
        diagnostics: What may be wrong with it.
        before: The plate by the columns' names alone, if there is one.
        after: The same by the mapping.
        refusal: What contradicts the mapping, as far as it was solved; None if nothing does.
        assessment: Of the recording that this very mapping makes; None where it was refined since.
    """

    draft: Draft
    diagnostics: tuple[Diagnostic, ...] = ()
    before: WrenchFit | None = None
    after: WrenchFit | None = None
    refusal: TestbedError | None = None
    assessment: Assessment | None = None


def solve_mapping(
    draft: Draft, out: Path, tree: Tree, progress: Progress | None = None
) -> MappingSolution:
    """A mapping without empty keys, as far as names and data determine it.

    Args:
        draft: By the columns' names.
        out: The mapping file; files are relative to its folder.
        tree: The robot, its masses right within a factor of a few.
        progress: Called with how much of a search is done.
    """
    open_keys = {
        (table, key)
        for table, keys in draft.tables.items()
        for key, value in keys.items()
        if [*empty_keys({key: value})]
    }
    draft = _assume(draft, tree)
    if missing(draft):
        return MappingSolution(draft)
    try:
        draft = _with_starts(draft, out)
        draft, source = _recording(draft, out, tree)
        first = assessment = assess(tree, source, progress)
        for _ in range(ROUNDS):
            better = _better(draft, assessment, tree)
            if better is draft:
                break
            draft, source = _recording(better, out, tree)
            assessment = assess(tree, source, progress)
        assessment.require()
        if assessment.best is None:
            said = (*encoder_steps(source), *assessment.likely)
            return MappingSolution(draft, said)
        draft = _by_the_data(draft, assessment, assessment.best, open_keys)
        in_time = _with_clocks(draft, source, tree)
        if in_time is not draft:
            draft, aligned = _recording(in_time, out, tree)
            assessment = assess(tree, aligned, progress)
    except (RecordingError, ExperimentError) as error:
        return MappingSolution(draft, refusal=error)
    solved = draft
    if assessment.best is not None:
        draft = _with_average(_with_plate(draft, assessment.best), source)
    last = assessment if draft is solved else None
    said = (*encoder_steps(source), *assessment.likely, *_too_short(assessment.best))
    if any(each.code in ("plate.foreign", "recording.short") for each in said):
        draft = _doubted(draft)
    before, after = first.wrench_fit, assessment.wrench_fit
    return MappingSolution(draft, said, before, after, assessment=last)


def missing(draft: Draft) -> list[str]:
    """Keys that a person must fill in.

    Args:
        draft: A mapping.
    """
    content = draft.content
    rates = {"rate": content["rate"]} | {
        f"sources.{name}.rate": each.get("rate", 1.0) for name, each in content["sources"].items()
    }
    none = [key for key in ("position",) if key not in content]
    rateless = (key for key, rate in rates.items() if not rate)
    return [*dict.fromkeys((*empty_keys(content), *rateless, *none))]


def table_of(draft: Draft) -> list[tuple[str, str, str]]:
    """What was assumed or solved: key, value, and what it is known by.

    Args:
        draft: Of a solution.
    """
    return [
        (f"{table}.{key}".removeprefix("."), in_toml(draft.tables[table][key]), note)
        for (table, key), note in draft.notes.items()
        if note.startswith(KNOWN) and key != "# place"
    ]


def _mapping(draft: Draft, out: Path) -> MappingFile:
    return checked(MappingFile, draft.content, str(out))


def _recording(draft: Draft, out: Path, tree: Tree) -> tuple[Draft, Source]:
    """Mapping corrected by derivatives, and the longest recording imported by it."""
    for _ in range(ROUNDS):
        try:
            recordings, _ = pieces(out, _mapping(draft, out))
        except DerivativeError as error:
            if not error.lines:
                raise
            for table, key, value in error.lines:
                draft = draft.saying(table, key, value, "solved: a signal and its derivative")
        else:
            break
    else:
        recordings, _ = pieces(out, _mapping(draft, out))
    return draft, on_its_base(max(recordings, key=lambda each: each.samples), tree)


def _assume(draft: Draft, tree: Tree) -> Draft:
    """What is open is what is usual."""
    turning = {joint.name: joint.revolute for joint in tree.joints}
    joints, tables = draft.tables[""]["joints"], draft.tables
    for kind, (turns, slides) in USUAL.items():
        if tables.get(kind, {}).get("unit") == "":
            units = [turns if turning.get(name, True) else slides for name in joints]
            draft = draft.saying(kind, "unit", units[0] if len({*units}) == 1 else units, ASSUMED)
    if tables.get("torque", {}).get("gain") == "":
        draft = draft.saying("torque", "gain", 1.0, f"{ASSUMED}: torque of one unit [N m]")
    for name in [each for each in tables if each == "wrench" or each.startswith("plates.")]:
        plate = tables[name]
        units = [each or usual for each, usual in zip(plate["units"], ("N", "N m"), strict=True)]
        if units != plate["units"]:
            draft = draft.saying(name, "units", units, ASSUMED)
        if not plate["sense"]:
            draft = draft.saying(name, "sense", "on_robot", ASSUMED)
    return draft


def _with_starts(draft: Draft, out: Path) -> Draft:
    """Clocks of several files that have little time in common begin together."""
    mapping = _mapping(draft, out)
    ranges = clock_ranges(mapping, out.parent)
    own = mapping.position.source
    begin, end = ranges[own]
    for name, (first, last) in ranges.items():
        common = min(last, end) - max(first, begin)
        if common < COMMON * min(last - first, end - begin):
            note = f"{ASSUMED}: it begins with {own} [s]"
            draft = draft.saying(f"sources.{name}", "offset", begin - first, note)
    return draft


def _better(draft: Draft, assessment: Assessment, tree: Tree) -> Draft:
    """What the assessment says instead; the same where it finds nothing wrong."""
    codes, best = {each.code for each in assessment.certain}, assessment.best
    foreign = bool(codes & {"plate.foreign", "plate.crosstalk"})
    zero_open = "wrench" in draft.tables and "tare" not in draft.tables["wrench"]
    if best is not None and codes == {"plate.weight"} and zero_open:
        return _with_zero(draft, best)  # the plate's zero is not the model's pedestal
    if best is not None and zero_open and "pedestal" not in draft.tables["wrench"]:
        weighed = weights(best)
        if weighed is not None and not foreign:
            draft = _with_pedestal(draft, weighed)
            rest = tuple(each for each in assessment.remedies if each.kind != "tare")
            return _with_remedies(draft, replace(assessment, remedies=rest))
    if assessment.remedies:
        return _with_remedies(draft, assessment)
    return _with_sizes(draft, assessment, tree)


def _with_sizes(draft: Draft, assessment: Assessment, tree: Tree) -> Draft:
    """Mapping with the unit or the gains of torques, by their size."""
    best, finite = assessment.best, assessment.sizes[np.isfinite(assessment.sizes)]
    odd = any(each.code == "torque.size" for each in assessment.certain)
    if odd and draft.notes.get(("torque", "unit")) == ASSUMED:
        if THOUSAND / 2 < np.median(finite) < 2 * THOUSAND:
            note = "solved: a thousand times what the model file's masses make"
            return draft.saying("torque", "unit", "N mm", note)
        if np.median(finite) > 1:
            return draft
        note = f"{ASSUMED}: currents, or torques on the motors' side of gears"
        return draft.saying("torque", "unit", "raw", note).saying("torque", "gain", 1.0, ASSUMED)
    if draft.tables.get("torque", {}).get("gain") == 1.0 and len(finite):
        plate = best is not None and best.has_plate
        return _with_gains(draft, assessment.sizes, tree, "plate" if plate else "model")
    return draft


def _with_gains(draft: Draft, sizes: Array, tree: Tree, origin: str) -> Draft:
    """Mapping with gains by a force plate or the model file's masses.

    Args:
        draft: The mapping.
        sizes: Times that the columns are what the joints' torques are, (n,); nan if not known.
        tree: The robot.
        origin: What the sizes are by: plate or model.
    """
    sizes = np.where(np.isfinite(sizes), sizes, np.nanmedian(sizes))
    joints = [tree.names.index(name) for name in draft.tables[""]["joints"]]
    gains = [round_significant(1 / sizes[k], 4) for k in joints]
    note = "solved: by the plate"
    if origin == "model":
        note = "solved: by the model file's masses, with which all parameters scale"
    draft = draft.saying("torque", "gain", gains, f"{note}; torque of one unit [N m]")
    return draft.saying("torque", "gain_from", origin)


def _with_pedestal(draft: Draft, weighed: tuple[float, float, float]) -> Draft:
    """Whether a plate's reading contains the pedestal, by the model file's masses."""
    included, without, file = weighed
    value = "removed" if removed(*weighed) else "included"
    note = f"{ASSUMED}: the robot weighs {included:.3g} kg if it is included, {without:.3g} kg if "
    return draft.saying("wrench", "pedestal", value, f"{note}not; the model file says {file:.3g}")


def _with_remedies(draft: Draft, assessment: Assessment) -> Draft:
    """What the assessment says, and what for."""
    others = assessment.alternatives
    for each in assessment.remedies:
        note = f"solved: {share(each.after)} of {each.channel} is unexplained"
        note += f", {share(each.before)} without" if each.before > each.after else ""
        if others.runner_up and others.times > CLEARLY:
            note += f"; the runner-up leaves {others.times:.3g} times more"
        note += f"; equally explained by {', '.join(others.equals)}" if others.equals else ""
        for table, key, value in each.lines:
            if (table, key) == ("wrench", "tare"):
                draft = _with_tare(draft, value, note)
                continue
            draft = draft.saying(table, key, value, note)
            if (table, key) == ("position", "unit"):
                draft = _with_rates(draft, value)
    return draft


def _with_rates(draft: Draft, unit: str | list[str]) -> Draft:
    """Units of derivatives that were assumed, in those of the positions."""
    for kind, ending in (("velocity", "/s"), ("acceleration", "/s^2")):
        if draft.notes.get((kind, "unit")) == ASSUMED:
            several = isinstance(unit, list)
            rates = [f"{each}{ending}" for each in unit] if several else f"{unit}{ending}"
            draft = draft.saying(kind, "unit", rates, ASSUMED)
    return draft


def _by_the_data(
    draft: Draft, assessment: Assessment, best: Explanation, keys: set[tuple[str, str]]
) -> Draft:
    """Keys that were assumed and that the data bear out."""
    if not best.has_plate or assessment.likely:
        return draft
    note = f"by the data: {share(best.plate.unexplained.max())} of the plate's channels is "
    note += "unexplained"
    for table, key in keys - {("torque", "gain")}:
        if draft.notes.get((table, key)) == ASSUMED:
            draft = draft.saying(table, key, draft.tables[table][key], note)
    return draft


def _with_clocks(draft: Draft, source: Source, tree: Tree) -> Draft:
    """Delays and drifts that are clear."""
    content = draft.content
    for each in (each for each in time_offsets(tree, source) if each.matters):
        for table, key, value in alignment(each, content, source.facts):
            if key == "delay":
                draft = _delayed(draft, table, value, each.sigma)
            else:
                note = f"solved: {1e6 * each.skew:.1f} +- {1e6 * each.skew_sigma:.1f} ppm"
                draft = draft.saying(table, key, value, note)
    return draft


def _delayed(draft: Draft, signal: str, delay: float, sigma: float) -> Draft:
    """A signal that is so late [s]; of a clock of its own as its offset."""
    source = draft.tables[signal]["source"]
    table, key, value = signal, "delay", round(delay, 7)
    if source != draft.tables["position"]["source"]:
        table, key = f"sources.{source}", "offset"
        value = round(draft.tables[table].get("offset", 0.0) - delay, 7)
        draft = draft.saying(signal, "delay", None)
    return draft.saying(table, key, value, f"solved: {1e3 * value:.3f} +- {1e3 * sigma:.3f} ms")


def _with_average(draft: Draft, source: Source) -> Draft:
    """Of what a plate's delay is half, where its spectra show a moving average of about that."""
    delay = draft.tables.get("wrench", {}).get("delay")
    if delay is None:
        return draft
    window = moving_average(source.part(0, source.samples).measured("wrench"), source.rate)
    if not 0.5 * delay < window / 2 < 1.5 * delay:
        return draft
    note = f"{draft.notes['wrench', 'delay']}; the recorder averages over about "
    note += f"{1e3 * window:.0f} ms (minima of all spectra at multiples of {1 / window:.3g} Hz)"
    return draft.saying("wrench", "delay", delay, note)


def _with_plate(draft: Draft, best: Explanation) -> Draft:
    """Frame, clock and zero of a plate as the data determine them."""
    table = draft.tables.get("wrench")
    if table is None or not best.has_plate:
        return draft
    frame = frame_of(draft.content)
    moves, covariance = best.fit.plate.correction(best.plate)
    sigma = np.sqrt(np.diagonal(covariance))
    loose = [k for k in SHIFT if sigma[k] > FAR]  # at zero, and the others as they are then
    gain = np.linalg.solve(covariance[np.ix_(loose, loose)], covariance[loose])
    moves = moves - (moves[loose] + frame.place[loose]) @ gain
    shift, spread = moves[list(SHIFT)], sigma[list(SHIFT)]
    moved = from_vector(moves[list(TURN)])
    turn, xyz = moved @ frame.turn, moved @ frame.place + shift
    rpy, plain = to_rpy(turn), _plain_angles(turn, covariance[np.ix_(TURN, TURN)])
    note = (
        f"{draft.notes.get(('wrench', 'place'), 'solved')}; "
        f"rpy {_list(np.rad2deg(rpy), 3)} +- {_list(np.rad2deg(sigma[list(TURN)]), 3)} deg; "
        f"xyz {_list(1e3 * xyz, 2)} +- {_list(1e3 * spread, 2)} mm"
    )
    axes = ", ".join(axis for axis, wide in zip("xyz", spread, strict=True) if wide > FAR)
    note += f"; {axes} not determined by these data" * bool(axes)
    precise = np.array(SHIFT)[spread <= FAR]
    widest = np.sqrt(np.linalg.eigvalsh(covariance[np.ix_(precise, precise)]).max(initial=0.0))
    if widest > LOOSE:
        note += f"; the place is determined to +- {1e3 * widest:.1f} mm only"
        note += "; a faster motion determines it better"
    value = {"xyz": np.round(xyz, 4).tolist(), "rpy": [round(a, 6) + 0.0 for a in plain or rpy]}
    draft = draft.saying("wrench", "# place", None).saying("wrench", "place", value, note)
    force, moment = frame.units
    ratio = FORCES[force] / MOMENTS[moment] / (1 + moves[RATIO])
    origin = draft.notes.get(("wrench", "units"), "by the file")
    note = f"{origin}; ratio {ratio:.6g} +- {ratio * sigma[RATIO]:.2g}"
    draft = draft.saying("wrench", "units", table["units"], note)
    own_clock = table["source"] != draft.tables["position"]["source"]
    late, late_sigma = float(moves[LATE]), float(sigma[LATE])
    if own_clock or "delay" in table or abs(late) > CLEAR * late_sigma:
        draft = _delayed(draft, "wrench", table.get("delay", 0.0) + late, late_sigma)
    placed = transform(from_rpy(plain or rpy), xyz) @ np.linalg.inv(
        transform(frame.turn, frame.place)
    )
    plate = replace(best.plate, map=placed @ best.plate.map)
    return _with_zero(draft, replace(best, plate=plate))


def _with_zero(draft: Draft, best: Explanation) -> Draft:
    """What the plate shows without the robot, where that is clear."""
    table = MappingFile.model_validate(draft.content).wrench
    zero = None if table is None else zero_hypothesis(best, table.static(None), least=0.0)
    if zero is None:
        return draft
    note = "solved: where it is clear; of Fz, Mx and My, what is of weight, by the file's masses"
    return _with_tare(draft, list(zero.values), note)


def _with_tare(draft: Draft, tare: list[float], note: str) -> Draft:
    """With all that a plate shows of others than the robot, its pedestal too."""
    included = draft.tables["wrench"].get("pedestal") == "included"
    draft = draft.saying("wrench", "pedestal", None) if included else draft
    return draft.saying("wrench", "tare", tare, note)


def _plain_angles(turn: Array, covariance: Array) -> tuple[float, float, float] | None:
    """Angles that a person writes, if one of them is as near as the data determine it."""
    for step in STEPS:
        roll, pitch, yaw = (round(angle / step) * step for angle in to_rpy(turn))
        apart = rotation_vector(from_rpy((roll, pitch, yaw)) @ turn.T)
        if apart @ np.linalg.solve(covariance, apart) < NEAR:
            return roll, pitch, yaw
    return None


def _list(values: Array, digits: int) -> str:
    return ", ".join(f"{value:.{digits}f}" for value in values)


def _too_short(best: Explanation | None) -> Iterator[Diagnostic]:
    """Whether another mapping may fit a recording as well."""
    if best is None:
        return
    instants, parameters = best.fit.instants, best.fit.prior.lift.shape[1]
    count, joints = instants.position.shape
    if count * (6 if best.has_plate else joints) <= SHORT * parameters:
        yield diagnose("recording.short", value=count * instants.spacing, parameters=parameters)


def _doubted(draft: Draft) -> Draft:
    """The same where what was solved is only assumed."""
    notes = {
        place: f"{ASSUMED} ({note})" if note.startswith(KNOWN[1:]) else note
        for place, note in draft.notes.items()
    }
    return replace(draft, notes=notes)
