"""Solution of a mapping file: values missing in column names are solved from data.

These open values are set to usual values, the recording is made, and the mapping is corrected until
the assessment finds no error. Then the clocks are aligned (`time_offset`), and the plate's frame is
refined (`draft_corrections`). A comment on each value states its origin.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from testbed.core.base.arrays import Array
from testbed.core.base.diagnostics import Diagnosed, Diagnostic, make_diagnostic
from testbed.core.base.errors import (
    ExperimentError,
    RecordingError,
    TestbedError,
    round_significant,
)
from testbed.core.base.toml_text import validate_tables
from testbed.core.parameters.minimal_set import minimal_set
from testbed.core.recordings.views import adapt_to_robot
from testbed.core.robot.tree import Tree
from testbed.importing.check.assessment import Assessment, assess_recording
from testbed.importing.check.check import PreparedRecordings
from testbed.importing.check.draft_corrections import (
    with_clocks,
    with_plate_correction,
    with_plate_zero,
    with_tare,
)
from testbed.importing.check.draft_mapping import (
    ASSUMED_NOTE,
    NOTE_PREFIXES,
    missing_keys,
)
from testbed.importing.check.explanation import Explanation
from testbed.importing.check.plate import WrenchFit
from testbed.importing.check.recording_diagnostics import (
    encoder_step_diagnostics,
    is_pedestal_removed,
    percentage,
    robot_masses,
    signals_to_align,
)
from testbed.importing.check.search import Progress
from testbed.importing.check.time_offset import time_offsets
from testbed.importing.convert import import_recordings, source_time_ranges
from testbed.importing.derivative import DerivativeError
from testbed.importing.foreign_table import REVOLUTE_UNITS
from testbed.importing.import_report import MappingDraft
from testbed.importing.mapping import Mapping as MappingFile
from testbed.importing.vocabulary import WORD_TABLES

SLIDING_NOTE = ": lengths of joints that slide"
"""Addition to a note on units."""

USUAL_UNITS: Mapping[str, tuple[str, str]] = WORD_TABLES["usual"]
"""Assumed units of revolute and of prismatic joints, by signal; of a base's position."""

MAX_ITERATIONS = 4
"""Largest number of times that a recording is made and assessed."""

MIN_VALUES_PER_PARAMETER = 10
"""Values per parameter below which data may fit other mappings as well."""

NMM_PER_NM = 1000.0
"""Ratio of N m to N mm."""

MIN_OVERLAP = 0.9
"""Least common duration of two files by their clocks, relative to the shorter file."""


@dataclass(frozen=True, eq=False)
class MappingSolution(Diagnosed):
    """Solved mapping, with diagnostics and fits of the force plate.

    Attributes:
        draft: Mapping; keys remain empty where no columns or no clock were found.
        diagnostics: Possible errors of the mapping.
        initial_fit: Fit of the plate with the mapping from column names alone; None without a
            plate.
        final_fit: Fit of the plate with the solved mapping; None without a plate.
        error: Error that contradicts the mapping solved so far; None without an error.
        prepared: Recordings made with this mapping; None if it was refined afterwards.
    """

    draft: MappingDraft
    diagnostics: tuple[Diagnostic, ...] = ()
    initial_fit: WrenchFit | None = None
    final_fit: WrenchFit | None = None
    error: TestbedError | None = None
    prepared: PreparedRecordings | None = None


def solve_mapping(
    draft: MappingDraft, out: Path, tree: Tree, progress: Progress | None = None
) -> MappingSolution:
    """Solve the open values of a mapping from column names and data.

    Values that column names do not state are set to usual values. The recording is made and
    assessed, and the mapping corrected, up to four times. Then clocks are aligned and the plate's
    frame is refined. Errors are returned in the solution. A draft with missing keys is returned
    with usual values only.

    Args:
        draft: Draft of the mapping from column names.
        out: Path of the mapping file; its file names are relative to the folder of this path.
        tree: Robot, with masses that are right within a factor of a few.
        progress: Callback with the number of fitted hypotheses.
    """
    draft = _with_usual_values(draft, tree)
    if missing_keys(draft):
        return MappingSolution(draft)
    try:
        draft = _with_common_start(draft, out)
        draft, prepared, assessment = _assess_draft(draft, out, tree, progress)
        first = assessment
        for _ in range(MAX_ITERATIONS):
            improved = _improved_draft(draft, assessment, tree)
            if improved is draft:
                break
            draft, prepared, assessment = _assess_draft(improved, out, tree, progress)
        assessment.raise_errors()
        source = adapt_to_robot(prepared.longest, tree)
        diagnostics = (*encoder_step_diagnostics(source), *assessment.warnings)
        if assessment.best_explanation is not None:
            draft = _with_data_notes(draft, assessment.best_explanation, diagnostics)
        if assessment.has_evidence:
            offsets = time_offsets(
                tree, source, signals_to_align(source, assessment.channel_faults)
            )
            aligned = with_clocks(draft, source, offsets)
            prepared = replace(prepared, time_offsets=offsets)
            if aligned is not draft:
                draft, prepared, assessment = _assess_draft(
                    aligned, out, tree, progress
                )
    except (RecordingError, ExperimentError) as error:
        return MappingSolution(draft, error=error)
    best = assessment.best_explanation
    diagnostics = (
        *encoder_step_diagnostics(source),
        *assessment.warnings,
        *_length_diagnostics(tree, assessment),
    )
    refined = draft if best is None else with_plate_correction(draft, best)
    current = prepared if refined is draft else None
    if any(each.code in ("plate.foreign", "recording.short") for each in diagnostics):
        refined = _with_notes_as_assumed(refined)
    return MappingSolution(
        refined,
        diagnostics,
        first.wrench_fit,
        assessment.wrench_fit,
        prepared=current,
    )


def _checked_mapping(draft: MappingDraft, out: Path) -> MappingFile:
    """Validated mapping file from a draft."""
    return validate_tables(MappingFile, draft.content, str(out))


def _assess_draft(
    draft: MappingDraft, out: Path, tree: Tree, progress: Progress | None
) -> tuple[MappingDraft, PreparedRecordings, Assessment]:
    """Correct a draft from derivatives, make its recordings, and assess the longest one.

    If positions contradict measured velocities or accelerations, units, signs and orders are
    corrected.

    Raises:
        DerivativeError: The contradiction has no correction.
    """
    try:
        prepared = PreparedRecordings(
            *import_recordings(out, _checked_mapping(draft, out))
        )
    except DerivativeError as error:
        improved = draft
        for line in error.lines:
            improved = improved.with_key(*line, "solved: a signal and its derivative")
        if improved == draft:
            raise
        return _assess_draft(improved, out, tree, progress)
    assessment = assess_recording(
        tree, adapt_to_robot(prepared.longest, tree), progress
    )
    return draft, replace(prepared, assessment=assessment), assessment


def _with_usual_values(draft: MappingDraft, tree: Tree) -> MappingDraft:
    """Draft with usual units, gains and senses for all open values, commented as "ASSUMED".

    Units are `USUAL_UNITS` according to the type of joint; torque gains are 1 N m; wrenches are in
    N and N m, acting on the robot.
    """
    sliding = {joint.name for joint in tree.joints if not joint.revolute}
    joints = draft.tables[""]["joints"]
    for kind, (turns, slides) in USUAL_UNITS.items():
        unit = draft.tables.get(kind, {}).get("unit")
        if unit == "" or (
            unit in [*REVOLUTE_UNITS.get(kind, ())] and sliding.intersection(joints)
        ):
            length = f"m{slides}" if str(unit).startswith("deg") else slides
            units = [length if name in sliding else unit or turns for name in joints]
            note = ASSUMED_NOTE + SLIDING_NOTE * bool(unit)
            draft = draft.with_key(
                kind, "unit", units if len({*units}) > 1 else units[0], note
            )
    if draft.tables.get("torque", {}).get("gain") == "":
        draft = draft.with_key(
            "torque", "gain", 1.0, f"{ASSUMED_NOTE}: torque of one unit [N m]"
        )
    for name, plate in draft.tables.items():
        if not name.startswith(("wrench", "plates.")):
            continue
        units = [
            each or usual
            for each, usual in zip(plate["units"], ("N", "N m"), strict=True)
        ]
        if units != plate["units"]:
            draft = draft.with_key(name, "units", units, ASSUMED_NOTE)
        if not plate["sense"]:
            draft = draft.with_key(name, "sense", "on_robot", ASSUMED_NOTE)
    return draft


def _with_common_start(draft: MappingDraft, out: Path) -> MappingDraft:
    """Draft in which clocks of files with little overlap start together with the positions.

    The overlap is little if the common duration with the positions is below 90 % of the duration of
    the shorter file.
    """
    mapping = _checked_mapping(draft, out)
    ranges = source_time_ranges(mapping, out.parent)
    position_source = mapping.position.source
    begin, end = ranges[position_source]
    for name, (first, last) in ranges.items():
        common = min(last, end) - max(first, begin)
        if common < MIN_OVERLAP * min(last - first, end - begin):
            note = f"{ASSUMED_NOTE}: it begins with {position_source} [s]"
            draft = draft.with_key(f"sources.{name}", "offset", begin - first, note)
    return draft


def _improved_draft(
    draft: MappingDraft, assessment: Assessment, tree: Tree
) -> MappingDraft:
    """Draft corrected by the assessment; the same object if no correction is needed.

    If no `tare` is stated, the plate's zero is corrected alone, or the pedestal is determined
    first. Then the remedies are applied; without remedies, the unit or gains of torques are
    determined.
    """
    codes, best = {each.code for each in assessment.errors}, assessment.best_explanation
    plate = draft.tables.get("wrench", {"tare": None})
    if best is not None and "tare" not in plate:
        if codes == {"plate.weight"}:
            # the plate's zero is not the model's pedestal
            return with_plate_zero(draft, best)
        masses = None if "pedestal" in plate else robot_masses(best)
        if masses is not None and not codes & {"plate.foreign", "plate.crosstalk"}:
            draft = _with_pedestal(draft, masses)
            others = tuple(each for each in assessment.remedies if each.kind != "tare")
            return _with_remedies(draft, replace(assessment, remedies=others))
    remedied = _with_remedies(draft, assessment)
    return (
        _with_torque_scale(draft, assessment, tree) if remedied is draft else remedied
    )


def _with_torque_scale(
    draft: MappingDraft, assessment: Assessment, tree: Tree
) -> MappingDraft:
    """Draft with the unit or the gains of torques deduced from the torques' size.

    The size is the median ratio to the torques predicted from the model file's masses. If an error
    is diagnosed, an assumed unit becomes N mm for ratios of 500 to 2000, and raw (currents) for
    ratios below 1. Gains equal to 1 are replaced by the inverse ratios.
    """
    best, finite = (
        assessment.best_explanation,
        assessment.torque_scales[np.isfinite(assessment.torque_scales)],
    )
    unusual = any(each.code == "torque.size" for each in assessment.errors)
    if unusual and draft.key_comments.get(("torque", "unit")) == ASSUMED_NOTE:
        if NMM_PER_NM / 2 < np.median(finite) < 2 * NMM_PER_NM:
            note = "solved: a thousand times what the model file's masses make"
            return draft.with_key("torque", "unit", "N mm", note)
        if np.median(finite) > 1:
            return draft
        note = f"{ASSUMED_NOTE}: currents, or torques on the motors' side of gears"
        return draft.with_key("torque", "unit", "raw", note).with_key(
            "torque", "gain", 1.0, ASSUMED_NOTE
        )
    if draft.tables.get("torque", {}).get("gain") == 1.0 and len(finite):
        return _with_gains(
            draft, assessment.torque_scales, tree, "plate" if best else "model"
        )
    return draft


def _with_gains(
    draft: MappingDraft, sizes: Array, tree: Tree, origin: str
) -> MappingDraft:
    """Draft with torque gains determined from a force plate or the model file's masses.

    Args:
        draft: Draft of the mapping.
        sizes: Ratios of the columns to the joint torques, (n,); nan, replaced by the median, if
            unknown.
        tree: Robot.
        origin: Origin of the sizes: "plate" or "model".
    """
    sizes = np.where(np.isfinite(sizes), sizes, np.nanmedian(sizes))
    joints = [tree.names.index(name) for name in draft.tables[""]["joints"]]
    gains = [round_significant(1 / sizes[k], 4) for k in joints]
    note = "solved: by the plate"
    if origin == "model":
        note = "solved: by the model file's masses, with which all parameters scale"
    draft = draft.with_key("torque", "gain", gains, f"{note}; torque of one unit [N m]")
    return draft.with_key("torque", "gain_from", origin)


def _with_pedestal(
    draft: MappingDraft, masses: tuple[float, float, float]
) -> MappingDraft:
    """Draft that states, based on masses, whether a plate's wrench includes the pedestal.

    Args:
        draft: Draft of the mapping.
        masses: Mass of the robot if the wrench includes the pedestal, mass if it does not, and mass
            in the model file [kg].
    """
    included, without, file = masses
    value = "removed" if is_pedestal_removed(*masses) else "included"
    note = (
        f"{ASSUMED_NOTE}: the robot weighs {included:.3g} kg if it is included, "
        f"{without:.3g} kg if "
    )
    return draft.with_key(
        "wrench", "pedestal", value, f"{note}not; the model file states {file:.3g}"
    )


def _with_remedies(draft: MappingDraft, assessment: Assessment) -> MappingDraft:
    """Draft with the remedies of an assessment, and comments on their effect."""
    for each in assessment.remedies:
        if each.kind == "torque_size":  # corrected by `_with_torque_scale`
            continue
        note = f"solved: {percentage(each.after)} of {each.channel} is unexplained"
        note += f", {percentage(each.before)} otherwise" * (each.before > each.after)
        if assessment.equivalent_explanations:
            note += f"; equally explained by {', '.join(assessment.equivalent_explanations)}"
        for table, key, value in each.lines:
            if key == "tare":
                draft = with_tare(draft, value, note)
                continue
            draft = draft.with_key(table, key, value, note)
            if (table, key) == ("position", "unit"):
                draft = _with_rate_units(draft, value)
    return draft


def _with_rate_units(draft: MappingDraft, unit: str | list[str]) -> MappingDraft:
    """Draft in which assumed units of derivatives match the unit of the positions."""
    for kind, ending in (("velocity", "/s"), ("acceleration", "/s^2")):
        if draft.key_comments.get((kind, "unit")) == ASSUMED_NOTE:
            is_list = isinstance(unit, list)
            rates = (
                [f"{each}{ending}" for each in unit] if is_list else f"{unit}{ending}"
            )
            draft = draft.with_key(kind, "unit", rates, ASSUMED_NOTE)
    return draft


def _with_data_notes(
    draft: MappingDraft, best: Explanation, doubts: Sequence[Diagnostic]
) -> MappingDraft:
    """Draft with comments on assumed values that a plate's data confirm.

    The draft is unchanged if a diagnostic is a warning; a plate does not confirm the gain of
    torques.
    """
    if any(each.level == "warning" for each in doubts):
        return draft
    unexplained = percentage(best.plate.unexplained.max())
    note = f"by the data: {unexplained} of the plate's channels is unexplained"
    notes = {
        place: note
        if old_note == ASSUMED_NOTE and place != ("torque", "gain")
        else old_note
        for place, old_note in draft.key_comments.items()
    }
    return replace(draft, key_comments=notes)


def _length_diagnostics(tree: Tree, assessment: Assessment) -> Iterator[Diagnostic]:
    """Yield a diagnostic for a recording too short for its number of parameters.

    It is too short if it has at most 10 values (channels times instants) per minimal parameter of
    the wrench.
    """
    parameters = minimal_set(tree, "wrench").count
    if assessment.best_explanation is not None:
        instants = assessment.best_explanation.fit.instants
        count, seconds = (
            6 * len(instants.motion.q),
            len(instants.motion.q) * instants.spacing,
        )
    elif assessment.verdict is not None:
        signals = assessment.verdict.case.signals
        count, seconds = signals.q.size, np.ptp(signals.sample_indices) / signals.rate
    else:
        return
    if count <= MIN_VALUES_PER_PARAMETER * parameters:
        yield make_diagnostic(
            "recording.short", value=float(seconds), parameters=parameters
        )


def _with_notes_as_assumed(draft: MappingDraft) -> MappingDraft:
    """Draft in which solved values are marked as assumed in their comments."""
    notes = {
        place: f"{ASSUMED_NOTE} ({note})"
        if note.startswith(NOTE_PREFIXES[1:])
        else note
        for place, note in draft.key_comments.items()
    }
    return replace(draft, key_comments=notes)
