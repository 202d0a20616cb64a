"""A mapping that nobody has to write: what the columns' names leave open, solved from the data.

What is open is assumed, the recording is made, and the assessment says what the mapping must say
instead, until it finds nothing wrong. Then the clocks are aligned (`time_offset`), and the plate's
frame is refined (`correction`). Beside each value stands what it is known by.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
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
from testbed.core.base.transform import Transform
from testbed.core.parameters.minimal_set import minimal_set
from testbed.core.recordings.source import Source
from testbed.core.recordings.views import on_its_base
from testbed.core.robot.rotations import from_rpy, from_vector, to_rpy
from testbed.core.robot.tree import Tree
from testbed.importing.check.assessment import Assessment, assess, zero_hypothesis
from testbed.importing.check.check import Prepared
from testbed.importing.check.draft_mapping import ASSUMED, KNOWN, missing
from testbed.importing.check.explanation import Explanation
from testbed.importing.check.plate import FAR, WrenchFit
from testbed.importing.check.plate_frame import frame_of, unit_ratio
from testbed.importing.check.plate_map import LATE, RATIO, SHIFT, TURN, rotation_vector
from testbed.importing.check.recording_diagnostics import (
    clocked,
    encoder_steps,
    removed,
    share,
    weights,
)
from testbed.importing.check.search import Progress
from testbed.importing.check.time_offset import TimeOffset, alignment, time_offsets
from testbed.importing.convert import clock_ranges, pieces
from testbed.importing.derivative import DerivativeError
from testbed.importing.foreign_table import TURNING
from testbed.importing.import_report import MappingDraft
from testbed.importing.mapping import Mapping as MappingFile
from testbed.importing.vocabulary import TABLES

SLIDING = ": lengths of joints that slide"

USUAL: Mapping[str, tuple[str, str]] = TABLES["usual"]
"""Units that are assumed, of joints that turn and of those that slide; of a base's place."""

ROUNDS = 4
"""Most times that a recording is made and assessed."""

SHORT = 10
"""Values at instants for each parameter below which data may fit another mapping as well."""

THOUSAND = 1000.0
"""Ratio of N m to N mm."""

COMMON = 0.9
"""Part of the shorter of two files that they must have in common by their clocks."""

STEPS = np.deg2rad([90, 45, 30, 15])
"""Of angles that a person writes [rad]."""

CLEAR = 4.0
"""Standard deviations from which a plate is late by a clock that it shares with the positions."""

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
        prepared: Recordings that this very mapping makes; None where it was refined since.
    """

    draft: MappingDraft
    diagnostics: tuple[Diagnostic, ...] = ()
    before: WrenchFit | None = None
    after: WrenchFit | None = None
    refusal: TestbedError | None = None
    prepared: Prepared | None = None


def solve_mapping(
    draft: MappingDraft, out: Path, tree: Tree, progress: Progress | None = None
) -> MappingSolution:
    """A mapping without empty keys, as far as names and data determine it.

    Args:
        draft: By the columns' names.
        out: The mapping file; files are relative to its folder.
        tree: The robot, its masses right within a factor of a few.
        progress: Called with how much of a search is done.
    """
    draft = _assume(draft, tree)
    if missing(draft):
        return MappingSolution(draft)
    try:
        draft = _with_starts(draft, out)
        draft, prepared, assessment = _assessed(draft, out, tree, progress)
        first = assessment
        for _ in range(ROUNDS):
            better = _better(draft, assessment, tree)
            if better is draft:
                break
            draft, prepared, assessment = _assessed(better, out, tree, progress)
        assessment.require()
        source = on_its_base(prepared.longest, tree)
        said = (*encoder_steps(source), *assessment.likely)
        if assessment.best is not None:
            draft = _by_the_data(draft, assessment.best, said)
        if assessment.judged:
            offsets = time_offsets(tree, source, clocked(source, assessment.faults))
            in_time = _with_clocks(draft, source, offsets)
            prepared = replace(prepared, offsets=offsets)
            if in_time is not draft:
                draft, prepared, assessment = _assessed(in_time, out, tree, progress)
    except (RecordingError, ExperimentError) as error:
        return MappingSolution(draft, refusal=error)
    best = assessment.best
    said = (*encoder_steps(source), *assessment.likely, *_too_short(tree, assessment))
    refined = draft if best is None else _with_plate(draft, best)
    last = prepared if refined is draft else None
    if any(each.code in ("plate.foreign", "recording.short") for each in said):
        refined = _doubted(refined)
    return MappingSolution(
        refined,
        said,
        first.wrench_fit,
        assessment.wrench_fit,
        prepared=last,
    )


def _mapping(draft: MappingDraft, out: Path) -> MappingFile:
    return checked(MappingFile, draft.content, str(out))


def _assessed(
    draft: MappingDraft, out: Path, tree: Tree, progress: Progress | None
) -> tuple[MappingDraft, Prepared, Assessment]:
    """Mapping corrected by derivatives, its recordings, and the longest of them assessed."""
    try:
        prepared = Prepared(*pieces(out, _mapping(draft, out)))
    except DerivativeError as error:
        better = draft
        for line in error.lines:
            better = better.saying(*line, "solved: a signal and its derivative")
        if better == draft:
            raise
        return _assessed(better, out, tree, progress)
    assessment = assess(tree, on_its_base(prepared.longest, tree), progress)
    return draft, replace(prepared, assessment=assessment), assessment


def _assume(draft: MappingDraft, tree: Tree) -> MappingDraft:
    """What is open is what is usual."""
    sliding = {joint.name for joint in tree.joints if not joint.revolute}
    joints = draft.tables[""]["joints"]
    for kind, (turns, slides) in USUAL.items():
        unit = draft.tables.get(kind, {}).get("unit")
        if unit == "" or (
            unit in [*TURNING.get(kind, ())] and sliding.intersection(joints)
        ):
            length = f"m{slides}" if str(unit).startswith("deg") else slides
            units = [length if name in sliding else unit or turns for name in joints]
            note = ASSUMED + SLIDING * bool(unit)
            draft = draft.saying(
                kind, "unit", units if len({*units}) > 1 else units[0], note
            )
    if draft.tables.get("torque", {}).get("gain") == "":
        draft = draft.saying(
            "torque", "gain", 1.0, f"{ASSUMED}: torque of one unit [N m]"
        )
    for name, plate in draft.tables.items():
        if not name.startswith(("wrench", "plates.")):
            continue
        units = [
            each or usual
            for each, usual in zip(plate["units"], ("N", "N m"), strict=True)
        ]
        if units != plate["units"]:
            draft = draft.saying(name, "units", units, ASSUMED)
        if not plate["sense"]:
            draft = draft.saying(name, "sense", "on_robot", ASSUMED)
    return draft


def _with_starts(draft: MappingDraft, out: Path) -> MappingDraft:
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


def _better(draft: MappingDraft, assessment: Assessment, tree: Tree) -> MappingDraft:
    """What the assessment says instead; the same where it finds nothing wrong."""
    codes, best = {each.code for each in assessment.certain}, assessment.best
    plate = draft.tables.get("wrench", {"tare": None})
    if best is not None and "tare" not in plate:
        if codes == {"plate.weight"}:
            # the plate's zero is not the model's pedestal
            return _with_zero(draft, best)
        weighed = None if "pedestal" in plate else weights(best)
        if weighed is not None and not codes & {"plate.foreign", "plate.crosstalk"}:
            draft = _with_pedestal(draft, weighed)
            rest = tuple(each for each in assessment.remedies if each.kind != "tare")
            return _with_remedies(draft, replace(assessment, remedies=rest))
    changed = _with_remedies(draft, assessment)
    return _with_sizes(draft, assessment, tree) if changed is draft else changed


def _with_sizes(
    draft: MappingDraft, assessment: Assessment, tree: Tree
) -> MappingDraft:
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
        return draft.saying("torque", "unit", "raw", note).saying(
            "torque", "gain", 1.0, ASSUMED
        )
    if draft.tables.get("torque", {}).get("gain") == 1.0 and len(finite):
        return _with_gains(draft, assessment.sizes, tree, "plate" if best else "model")
    return draft


def _with_gains(
    draft: MappingDraft, sizes: Array, tree: Tree, origin: str
) -> MappingDraft:
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


def _with_pedestal(
    draft: MappingDraft, weighed: tuple[float, float, float]
) -> MappingDraft:
    """Whether a plate's reading contains the pedestal, by the model file's masses."""
    included, without, file = weighed
    value = "removed" if removed(*weighed) else "included"
    note = f"{ASSUMED}: the robot weighs {included:.3g} kg if it is included, {without:.3g} kg if "
    return draft.saying(
        "wrench", "pedestal", value, f"{note}not; the model file says {file:.3g}"
    )


def _with_remedies(draft: MappingDraft, assessment: Assessment) -> MappingDraft:
    """What the assessment says, and what for."""
    for each in assessment.remedies:
        if each.kind == "torque_size":  # by all sizes together
            continue
        note = f"solved: {share(each.after)} of {each.channel} is unexplained"
        note += f", {share(each.before)} without" * (each.before > each.after)
        if assessment.equals:
            note += f"; equally explained by {', '.join(assessment.equals)}"
        for table, key, value in each.lines:
            if key == "tare":
                draft = _with_tare(draft, value, note)
                continue
            draft = draft.saying(table, key, value, note)
            if (table, key) == ("position", "unit"):
                draft = _with_rates(draft, value)
    return draft


def _with_rates(draft: MappingDraft, unit: str | list[str]) -> MappingDraft:
    """Units of derivatives that were assumed, in those of the positions."""
    for kind, ending in (("velocity", "/s"), ("acceleration", "/s^2")):
        if draft.notes.get((kind, "unit")) == ASSUMED:
            several = isinstance(unit, list)
            rates = (
                [f"{each}{ending}" for each in unit] if several else f"{unit}{ending}"
            )
            draft = draft.saying(kind, "unit", rates, ASSUMED)
    return draft


def _by_the_data(
    draft: MappingDraft, best: Explanation, doubts: Sequence[Diagnostic]
) -> MappingDraft:
    """Mapping with notes on keys that were assumed and that a plate's data bear out."""
    if any(each.level == "warning" for each in doubts):
        return draft
    unexplained = share(best.plate.unexplained.max())
    note = f"by the data: {unexplained} of the plate's channels is unexplained"
    notes = {
        place: note if said == ASSUMED and place != ("torque", "gain") else said
        for place, said in draft.notes.items()
    }
    return replace(draft, notes=notes)


def _with_clocks(
    draft: MappingDraft, source: Source, offsets: Sequence[TimeOffset]
) -> MappingDraft:
    """Delays and drifts that are clear."""
    content = draft.content
    for each in offsets:
        for table, key, value in alignment(each, content, source.metadata.report):
            if key == "delay":
                draft = _delayed(draft, table, value, each.sigma)
            else:
                note = (
                    f"solved: {1e6 * each.skew:.1f} +- {1e6 * each.skew_sigma:.1f} ppm"
                )
                draft = draft.saying(table, key, value, note)
    return draft


def _delayed(
    draft: MappingDraft, signal: str, delay: float, sigma: float
) -> MappingDraft:
    """A signal that is so late [s]; of a clock of its own as its offset."""
    source = draft.tables[signal]["source"]
    table, key, value = signal, "delay", round(delay, 7)
    if source != draft.tables["position"]["source"]:
        table, key = f"sources.{source}", "offset"
        value = round(draft.tables[table].get("offset", 0.0) - delay, 7)
        draft = draft.saying(signal, "delay", None)
    return draft.saying(
        table, key, value, f"solved: {1e3 * value:.3f} +- {1e3 * sigma:.3f} ms"
    )


def _with_plate(draft: MappingDraft, best: Explanation) -> MappingDraft:
    """Frame, clock and zero of a plate as the data determine them."""
    table = draft.tables.get("wrench")
    if table is None:
        return draft
    frame = frame_of(draft.content)
    moves, covariance = best.fit.plate.correction(best.plate)
    sigma = np.sqrt(np.diagonal(covariance))
    moved = from_vector(moves[TURN])
    turn, xyz = moved @ frame.turn, moved @ frame.place + moves[SHIFT]
    rpy = _plain_angles(turn, covariance[np.ix_(TURN, TURN)])
    draft = _with_place(draft, turn, xyz, rpy, sigma)
    ratio = 1 / unit_ratio(frame.units) / (1 + moves[RATIO])
    note = draft.notes.get(("wrench", "units"), "by the file")
    note += f"; ratio {ratio:.6g} +- {ratio * sigma[RATIO]:.2g}"
    draft = draft.saying("wrench", "units", table["units"], note)
    late = float(moves[LATE])
    shared = (
        table["source"] == draft.tables["position"]["source"] and "delay" not in table
    )
    if not shared or abs(late) > CLEAR * sigma[LATE]:
        draft = _delayed(
            draft, "wrench", table.get("delay", 0.0) + late, float(sigma[LATE])
        )
    placed = (
        Transform(from_rpy(rpy), xyz).wrench_matrix @ frame.map_inverse @ best.plate.map
    )
    return _with_zero(draft, replace(best, plate=replace(best.plate, map=placed)))


def _with_place(
    draft: MappingDraft, turn: Array, xyz: Array, rpy: Sequence[float], sigma: Array
) -> MappingDraft:
    """Mapping with a plate's place, its rounded angles `rpy`, and how well it is known."""
    angles, wide = np.rad2deg(to_rpy(turn)), np.rad2deg(sigma[TURN])
    spread = sigma[SHIFT]
    origin = draft.notes.get(("wrench", "place"), "solved")
    note = f"{origin}; rpy {_list(angles, 3)} +- {_list(wide, 3)} deg"
    note += f"; xyz {_list(1e3 * xyz, 2)} +- {_list(1e3 * spread, 2)} mm"
    axes = [axis for axis, each in zip("xyz", spread, strict=True) if each > FAR]
    note += f"; {', '.join(axes)} not determined by these data" * bool(axes)
    value = {"xyz": np.round(xyz, 4).tolist(), "rpy": [round(a, 6) + 0.0 for a in rpy]}
    return draft.saying("wrench", "# place", None).saying(
        "wrench", "place", value, note
    )


def _with_zero(draft: MappingDraft, best: Explanation) -> MappingDraft:
    """What the plate shows without the robot, where that is clear."""
    table = MappingFile.model_validate(draft.content).wrench
    zero = (
        None if table is None else zero_hypothesis(best, table.static(None), least=0.0)
    )
    if zero is None:
        return draft
    note = "solved: where it is clear; of Fz, Mx and My, what is of weight, by the file's masses"
    return _with_tare(draft, list(zero.values), note)


def _with_tare(draft: MappingDraft, tare: list[float], note: str) -> MappingDraft:
    """With all that a plate shows of others than the robot, its pedestal too."""
    included = draft.tables["wrench"].get("pedestal") == "included"
    draft = draft.saying("wrench", "pedestal", None) if included else draft
    return draft.saying("wrench", "tare", tare, note)


def _plain_angles(turn: Array, covariance: Array) -> Sequence[float]:
    """Angles that a person writes, if they are as near as the data determine it; else its own."""
    rpy = to_rpy(turn)
    for step in STEPS:
        plain = [round(angle / step) * step for angle in rpy]
        apart = rotation_vector(from_rpy(plain) @ turn.T)
        if apart @ np.linalg.solve(covariance, apart) < NEAR:
            return plain
    return rpy


def _list(values: Array, digits: int) -> str:
    return ", ".join(f"{value:.{digits}f}" for value in values)


def _too_short(tree: Tree, assessment: Assessment) -> Iterator[Diagnostic]:
    """Yield the diagnostic of a recording too short for its parameters."""
    parameters = minimal_set(tree, "reaction").count
    if assessment.best is not None:
        instants = assessment.best.fit.instants
        count, seconds = (
            6 * len(instants.motion.q),
            len(instants.motion.q) * instants.spacing,
        )
    elif assessment.verdict is not None:
        signals = assessment.verdict.case.signals
        count, seconds = signals.q.size, np.ptp(signals.at) / signals.rate
    else:
        return
    if count <= SHORT * parameters:
        yield diagnose("recording.short", value=float(seconds), parameters=parameters)


def _doubted(draft: MappingDraft) -> MappingDraft:
    """The same where what was solved is only assumed."""
    notes = {
        place: f"{ASSUMED} ({note})" if note.startswith(KNOWN[1:]) else note
        for place, note in draft.notes.items()
    }
    return replace(draft, notes=notes)
