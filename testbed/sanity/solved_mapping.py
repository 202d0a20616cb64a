"""A mapping that nobody has to write: what the columns' names leave open, solved from the data.

What is open is assumed, the recording is made, and the search for mistakes says what the mapping
must say instead, until it finds none. Then the plate's clock is aligned (`clock_offset`), and its
frame refined (`plate_fit`). Beside each value stands what it is known by.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from testbed.arrays import Array
from testbed.errors import round_significant
from testbed.recordings.importing.convert import clock_ranges
from testbed.recordings.importing.draft import Draft, in_toml
from testbed.recordings.importing.foreign_units import FORCES, MOMENTS
from testbed.recordings.importing.import_report import ImportReport
from testbed.recordings.importing.mapping import Mapping as MappingFile
from testbed.recordings.importing.mapping import empty_keys
from testbed.recordings.importing.pieces import pieces
from testbed.recordings.measured_base import on_its_base
from testbed.recordings.source import Source
from testbed.robot.rotations import from_rpy, from_vector, to_rpy
from testbed.robot.tree import Tree
from testbed.sanity.alignment import aligned
from testbed.sanity.clock_offset import clock_offsets
from testbed.sanity.cure_words import CLEARLY, SIZE, named, share
from testbed.sanity.explained_wrench import ExplainedWrench, explained_wrench
from testbed.sanity.explanation import Explanation
from testbed.sanity.plate_findings import FOREIGN, WEIGHT, zero_mistake
from testbed.sanity.plate_fit import PlateFit, plate_fit
from testbed.sanity.sanity import Sanity, check_sanity
from testbed.sanity.search import Progress
from testbed.toml_text import checked

ASSUMED = "ASSUMED"
"""Mark of what neither names nor data tell."""

KNOWN = (ASSUMED, "solved", "by the data")
"""Beginnings of what is said beside a value that no name tells."""

ROUNDS = 4
"""Most times that a recording is made and searched."""

SHORT = 10
"""Values at instants for each parameter below which data may fit another mapping as well."""

COMMON = 0.9
"""Part of the shorter of two files that they must have in common by their clocks."""

STEPS = tuple(np.deg2rad(step) for step in (90, 45, 30, 15))
"""Of angles that a person writes [rad]."""

CLEAR = 4.0
"""Standard deviations from which a plate is late by a clock that it shares with the positions."""

FAR = 0.05
"""Standard deviation from which a place is not told [m]."""

NEAR = 14.2
"""Squared distance, in standard deviations, below which a turn is one that a person writes: one of
three normal numbers is beyond in .3 % of all cases."""


@dataclass(frozen=True, eq=False)
class Solved:
    """A mapping that was solved.

    Attributes:
        draft: The mapping, with keys still empty where no columns or no clock was found.
        warnings: What may be wrong with it.
        before: The plate by the columns' names alone, if there is one.
        after: The same by the mapping.
        shares: Explanations in words, the mapping's first, and the part of the plate's channels
            that each leaves, on average.
    """

    draft: Draft
    warnings: tuple[str, ...] = ()
    before: ExplainedWrench | None = None
    after: ExplainedWrench | None = None
    shares: tuple[tuple[str, float], ...] = ()


def solved(draft: Draft, out: Path, tree: Tree, progress: Progress | None = None) -> Solved:
    """A mapping without empty keys, as far as names and data tell.

    Args:
        draft: By the columns' names.
        out: The mapping file; files are relative to its folder.
        tree: The robot, its masses right within a factor of a few.
        progress: Told how much of a search is done.

    Raises:
        RecordingError: The data are not of this robot, or not in these columns.
    """
    open_keys = _open(draft)
    draft = _assumed(draft, tree)
    if missing(draft):
        return Solved(draft)
    draft = _with_starts(draft, out)
    source = _recording(draft, out, tree)
    first = found = check_sanity(tree, source, progress)
    for _ in range(ROUNDS):
        better = _better(draft, found, tree)
        if better is draft:
            break
        draft, source = better, _recording(better, out, tree)
        found = check_sanity(tree, source, progress)
    found.require()
    if found.best is None:
        return Solved(draft, tuple(each.text for each in found.likely))
    draft = _by_the_data(draft, found, open_keys)
    late = _with_clocks(draft, source, tree)
    if late is not draft:
        draft, found = late, check_sanity(tree, _recording(late, out, tree), progress)
    draft, warnings = _with_plate(draft, found), [each.text for each in found.likely]
    short = _too_short(found)
    if short or any(each.code == FOREIGN for each in found.likely):
        draft, warnings = _doubted(draft), [*warnings, *([short] if short else [])]
    before, after = (
        None if each is None else explained_wrench(each) for each in (first.given, found.given)
    )
    return Solved(draft, tuple(warnings), before, after, _shares(tree, first))


def _shares(tree: Tree, found: Sanity) -> tuple[tuple[str, float], ...]:
    """What explanations of a plate leave of its channels."""
    said: dict[str, float] = {}
    for each in found.explanations:
        if each.map is not None:
            words = " and ".join(named(tree, mistake) for mistake in each.mistakes)
            said.setdefault(words or "as assumed", float(each.left[-6:].mean()))
    return tuple(said.items())


def _too_short(found: Sanity) -> str:
    """What is wrong with a recording in which another mapping may fit as well; nothing else."""
    if found.best is None:
        return ""
    taken, parameters = found.best.reading.taken, found.best.reading.prior.told.shape[1]
    instants, joints = taken.position.shape
    if instants * (joints if found.best.map is None else 6) > SHORT * parameters:
        return ""
    return (
        f"{instants * taken.spacing:.2g} s of motion are few for {parameters} parameters: "
        "another mapping may fit as well; record more"
    )


def _doubted(draft: Draft) -> Draft:
    """The same where what was solved is only assumed."""
    notes = {
        place: f"{ASSUMED} ({note})" if note.startswith(KNOWN[1:]) else note
        for place, note in draft.notes.items()
    }
    return replace(draft, notes=notes)


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


def _better(draft: Draft, found: Sanity, tree: Tree) -> Draft:
    """What the search says instead; the same where it finds nothing wrong."""
    codes = {each.code for each in found.certain}
    wrench = draft.tables.get("wrench")
    zero_open = wrench is not None and "tare" not in wrench
    if codes == {WEIGHT} and found.best is not None and zero_open:
        return _with_zero(draft, found.best)  # the plate's zero is not the model's pedestal
    if found.cures:
        return _cured(draft, found)
    plate = found.best is not None and found.best.map is not None
    if SIZE in codes and plate and draft.notes.get(("torque", "unit")) == ASSUMED:
        note = f"{ASSUMED}: currents, or torques on the motors' side of gears"
        return draft.saying("torque", "unit", "raw", note).saying("torque", "gain", 1.0, ASSUMED)
    told = np.isfinite(found.sizes)
    if draft.tables.get("torque", {}).get("gain") == 1.0 and told.any():
        sizes = np.where(told, found.sizes, np.median(found.sizes[told]))
        joints = [tree.names.index(name) for name in draft.tables[""]["joints"]]
        gains = [round_significant(1 / sizes[k], 4) for k in joints]
        known = f"{ASSUMED}: by the model file's masses"
        if plate:
            known = "solved: by the plate"
        note = f"{known}; torque of one unit, joint by joint [N m]"
        return draft.saying("torque", "gain", gains, note)
    return draft


def table_of(draft: Draft) -> list[tuple[str, str, str]]:
    """What was assumed or solved: key, value, and what it is known by.

    Args:
        draft: That was solved.
    """
    return [
        (f"{table}.{key}".removeprefix("."), in_toml(draft.tables[table][key]), note)
        for (table, key), note in draft.notes.items()
        if note.startswith(KNOWN) and key != "# place"
    ]


def _open(draft: Draft) -> set[tuple[str, str]]:
    """Keys that no name tells, by table and key."""
    return {
        (table, key)
        for table, keys in draft.tables.items()
        for key, value in keys.items()
        if [*empty_keys({key: value})]
    }


def _assumed(draft: Draft, tree: Tree) -> Draft:
    """What is open is what is usual."""
    turning = {joint.name: joint.revolute for joint in tree.joints}
    joints = draft.tables[""]["joints"]
    tables = draft.tables
    for kind, (turns, slides) in USUAL.items():
        if tables.get(kind, {}).get("unit", None) == "":
            units = [turns if turning.get(name, True) else slides for name in joints]
            unit = units[0] if len(set(units)) == 1 else units
            draft = draft.saying(kind, "unit", unit, ASSUMED)
    if tables.get("torque", {}).get("gain", None) == "":
        draft = draft.saying("torque", "gain", 1.0, f"{ASSUMED}: torque of one unit [N m]")
    for name in [each for each in tables if each == "wrench" or each.startswith("plates.")]:
        plate = tables[name]
        units = [each or usual for each, usual in zip(plate["units"], ("N", "N m"), strict=True)]
        if units != plate["units"]:
            draft = draft.saying(name, "units", units, ASSUMED)
        if not plate["sense"]:
            draft = draft.saying(name, "sense", "on_robot", ASSUMED)
    return draft


USUAL = {
    "position": ("rad", "m"), "velocity": ("rad/s", "m/s"), "acceleration": ("rad/s^2", "m/s^2"),
    "torque": ("N m", "N"), "base": ("m", "m"),
}  # fmt: skip
"""Units that are assumed, of joints that turn and of those that slide; of a base's place."""


def _with_starts(draft: Draft, out: Path) -> Draft:
    """Clocks of several files that have little time in common begin together."""
    mapping = checked(MappingFile, draft.content, str(out))
    ranges = clock_ranges(mapping, out.parent)
    own = mapping.position.source
    begin, end = ranges[own]
    for name, (first, last) in ranges.items():
        common = min(last, end) - max(first, begin)
        if common < COMMON * min(last - first, end - begin):
            draft = draft.saying(
                f"sources.{name}", "offset", begin - first,
                f"{ASSUMED}: it begins with {own} [s]",
            )  # fmt: skip
    return draft


def _recording(draft: Draft, out: Path, tree: Tree) -> Source:
    """The recording that a mapping makes; the longest, if it is cut where a source was silent."""
    made, _ = pieces(out, checked(MappingFile, draft.content, str(out)))
    return on_its_base(max(made, key=lambda each: each.samples), tree)


def _cured(draft: Draft, found: Sanity) -> Draft:
    """What the search says, and what for."""
    for each in found.cures:
        known = f"solved: {share(each.after)} of {each.channel} is unexplained"
        known += f", {share(each.before)} without" if each.before > each.after else ""
        if found.runner_up and found.times > CLEARLY:
            known += f"; the runner-up leaves {found.times:.3g} times more"
        known += f"; not told apart from {', '.join(found.equals)}" if found.equals else ""
        for table, key, value in each.lines:
            draft = draft.saying(table, key, value, known)
            if (table, key) == ("position", "unit"):
                draft = _with_rates(draft, value)
    return draft


def _with_rates(draft: Draft, unit: str | list[str]) -> Draft:
    """Units of derivatives that were assumed, in those of the positions."""
    for kind, ending in (("velocity", "/s"), ("acceleration", "/s^2")):
        if draft.notes.get((kind, "unit")) == ASSUMED:
            rates = (
                [f"{each}{ending}" for each in unit] if isinstance(unit, list) else unit + ending
            )
            draft = draft.saying(kind, "unit", rates, ASSUMED)
    return draft


def _by_the_data(draft: Draft, found: Sanity, keys: set[tuple[str, str]]) -> Draft:
    """Keys that were assumed and that the data bear out."""
    best = found.best
    if best is None or best.map is None or found.likely:
        return draft
    left = share(float(best.left[-6:].max()))
    for table, key in keys:
        if draft.notes.get((table, key)) == ASSUMED and not (table == "torque" and key == "gain"):
            value = draft.tables[table][key]
            said = f"by the data: {left} of the plate's channels is unexplained"
            draft = draft.saying(table, key, value, said)
    return draft


def _with_clocks(draft: Draft, source: Source, tree: Tree) -> Draft:
    """Delays and drifts that are clear."""
    found = [each for each in clock_offsets(tree, source) if each.late or each.drifts]
    if not found:
        return draft
    mapping = checked(MappingFile, draft.content, "the mapping")
    new = aligned(mapping, ImportReport.from_dict(source.facts["import"]), found)
    for each in found:
        table = getattr(new, each.signal)
        skew = new.sources[table.source].skew
        if skew:
            said = f"solved: {1e6 * each.skew:.1f} +- {1e6 * each.skew_sigma:.1f} ppm"
            draft = draft.saying(f"sources.{table.source}", "skew", skew, said)
        late = table.delay - getattr(mapping, each.signal).delay
        draft = _delayed(draft, each.signal, late, each.sigma)
    return draft


def _delayed(draft: Draft, signal: str, late: float, sigma: float) -> Draft:
    """A signal that is later by so much [s]; of a clock of its own as its offset."""
    source, delay = draft.tables[signal]["source"], draft.tables[signal].get("delay", 0.0) + late
    table, key, value = signal, "delay", round(delay, 7)
    if source != draft.tables["position"]["source"]:
        table, key = f"sources.{source}", "offset"
        value = round(draft.tables[table].get("offset", 0.0) - delay, 7)
        draft = draft.saying(signal, "delay", None)
    return draft.saying(table, key, value, f"solved: {1e3 * value:.3f} +- {1e3 * sigma:.3f} ms")


def _with_plate(draft: Draft, found: Sanity) -> Draft:
    """Frame, clock and zero of a plate as the data tell them."""
    table = draft.tables.get("wrench")
    if table is None or found.best is None or found.best.map is None:
        return draft
    place = table.get("place") or {"xyz": [0.0] * 3, "rpy": [0.0] * 3}
    fit = plate_fit(found.best, np.array(place["xyz"], float))
    moved = from_vector(fit.turn)
    turn = moved @ from_rpy(place["rpy"])
    xyz = moved @ place["xyz"] + fit.shift
    rpy, written = to_rpy(turn), _written(turn, fit)
    known = draft.notes.get(("wrench", "place"), "solved")
    said = (
        f"{known}; rpy {_list(np.rad2deg(rpy), 3)} +- {_list(np.rad2deg(fit.turn_sigma), 3)} deg; "
        f"xyz {_list(1e3 * xyz, 2)} +- {_list(1e3 * fit.shift_sigma, 2)} mm"
    )
    axes = ", ".join(
        axis for axis, sigma in zip("xyz", fit.shift_sigma, strict=True) if sigma > FAR
    )
    said += f"; {axes} cannot be told from these data" * bool(axes)
    value = {"xyz": np.round(xyz, 4).tolist(), "rpy": [round(a, 6) + 0.0 for a in written or rpy]}
    draft = draft.saying("wrench", "# place", None).saying("wrench", "place", value, said)
    ratio = FORCES[table["units"][0]] / MOMENTS[table["units"][1]] / (1 + fit.ratio)
    known = draft.notes.get(("wrench", "units"), "by the file")
    said = f"{known}; ratio {ratio:.6g} +- {ratio * fit.ratio_sigma:.2g}"
    draft = draft.saying("wrench", "units", table["units"], said)
    own_clock = table["source"] != draft.tables["position"]["source"]
    if own_clock or "delay" in table or abs(fit.late) > CLEAR * fit.late_sigma:
        draft = _delayed(draft, "wrench", fit.late, fit.late_sigma)
    return _with_zero(draft, found.best)


def _with_zero(draft: Draft, best: Explanation) -> Draft:
    """What the plate shows without the robot, where that is clear."""
    given = draft.tables["wrench"].get("tare")
    zero = zero_mistake(best, None if given is None else np.array(given), least=0.0)
    if zero is None:
        return draft
    said = "solved: Fz, Mx and My, as far as they are of weight, by the model file's masses"
    return draft.saying("wrench", "tare", list(zero.values), said)


def _written(turn: Array, fit: PlateFit) -> tuple[float, float, float] | None:
    """Angles that a person writes, if one of them is as near as the data tell."""
    for step in STEPS:
        angles = [round(angle / step) * step for angle in to_rpy(turn)]
        apart = from_rpy(angles) @ turn.T
        vector = np.array([apart[2, 1], apart[0, 2], apart[1, 0]]) - np.array(
            [apart[1, 2], apart[2, 0], apart[0, 1]]
        )
        vector = vector / 2
        if np.trace(apart) > 2 and vector @ np.linalg.solve(fit.covariance, vector) < NEAR:
            return angles[0], angles[1], angles[2]
    return None


def _list(values: Array, digits: int) -> str:
    return ", ".join(f"{value:.{digits}f}" for value in values)
