"""Quantity, unit and joint of foreign columns, read from their names; groups of such columns."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from testbed.importing.foreign_table import (
    FORCE_UNITS,
    JOINT_QUANTITIES,
    KNOWN_UNITS,
    MOMENT_UNITS,
    RAW_UNITS,
    UNITS_BY_QUANTITY,
    canonical_unit,
)
from testbed.importing.vocabulary import WORD_TABLES, keys_by_word

KIND_FRAGMENTS = {kind: tuple(words) for kind, words in WORD_TABLES["parts"].items()}
"""Fragments of words by which a column's signal is recognised, in the order of precedence."""

KIND_OF_SYMBOL = keys_by_word("symbols")
"""Signal by whole word, as q; a symbol has precedence over fragments."""

KIND_OF_DERIVATIVE_WORD: dict[str, str] = WORD_TABLES["derivatives"]
"""Signal by a word that marks a derivative beside the word of a position, as theta_dot."""

(
    TEMPERATURE_WORDS,
    COMMAND_WORDS,
    MEASURED_WORDS,
    JOINT_WORDS,
    TOOL_WORDS,
    UNIT_WORDS,
) = (
    frozenset(WORD_TABLES["words"][key])
    for key in ("warmth", "commands", "measured", "joints", "hand", "units")
)
"""Words for drive temperatures, commands, measured values, joints, the tool (a wrench that is not
the plate's), and units that are recognised anywhere in a name."""

EXCLUDED_WORDS = COMMAND_WORDS | TEMPERATURE_WORDS | {*WORD_TABLES["words"]["beside"]}
"""Words of columns that are no signal of joints or plate, even beside a signal's word."""

SIGNAL_WORDS = {
    *KIND_OF_SYMBOL,
    *KIND_OF_DERIVATIVE_WORD,
    *MEASURED_WORDS,
    "motor",
    "log",
    "data",
}
"""Whole words that name a signal or go with a signal's name."""

LONG_JOINT_WORDS = tuple(word for word in JOINT_WORDS if len(word) > 2)
"""Words for joints with which longer words may begin, as Achsmoment."""

WORD_PATTERN = r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+"
"""Word of a name, or a number."""


@dataclass(frozen=True)
class ColumnName:
    """Column name split into words, unit, signal and wrench component.

    Attributes:
        name: Name as in the file.
        name_without_unit: Name without the unit.
        words: Lower-case words and numbers of the name without the unit.
        unit: Unit in the package's notation; None if the name has no unit.
        kind: Signal; None if the name states no signal.
        wrench_component: Component of a wrench: 0 for force or 1 for moment, and the axis (0 to 2);
            None if the name states no component.
    """

    name: str
    name_without_unit: str
    words: tuple[str, ...]
    unit: str | None
    kind: str | None
    wrench_component: tuple[int, int] | None

    @property
    def is_excluded(self) -> bool:
        """True if a word of the name is in `EXCLUDED_WORDS`: commands, temperatures, errors."""
        return not EXCLUDED_WORDS.isdisjoint(self.words)


def parse_column_name(name: str, stated_unit: str | None = None) -> ColumnName:
    """Parse a column name into words, unit, signal and wrench component.

    Args:
        name: Column name.
        stated_unit: Unit that the file states for the column; it replaces the unit in the name.
    """
    bare, unit = split_unit(name)
    if stated_unit and canonical_unit(stated_unit) in KNOWN_UNITS:
        unit = canonical_unit(stated_unit)
    words = lower_case_words(bare)
    role = _wrench_component(" ".join(words))
    kind = _signal_kind(words, unit, role)
    if kind in ("velocity", "acceleration") and unit in UNITS_BY_QUANTITY["position"]:
        unit = f"{unit}/s" + "^2" * (kind == "acceleration")
    return ColumnName(name, bare, words, unit, kind, role)


def lower_case_words(text: str) -> tuple[str, ...]:
    """Lower-case words and numbers of a text, for example actual, pos, j, 1 for ActualPosJ1."""
    return tuple(word.lower() for word in re.findall(WORD_PATTERN, text))


def is_signal_word(word: str) -> bool:
    """Test whether a word names a measured quantity rather than a joint."""
    lower = word.lower()
    if lower in JOINT_WORDS:
        return False
    return lower in SIGNAL_WORDS or any(
        _has_fragment(lower, fragments) for fragments in KIND_FRAGMENTS.values()
    )


def split_unit(name: str) -> tuple[str, str | None]:
    """Split a column name into the name without the unit, and the unit.

    Units are recognised as in Fx (lbf), q_deg_1 or vel_rad_s; the unit is None if the name has no
    unit.
    """
    for match in re.finditer(r"\s*[(\[{<]([^()\[\]{}<>]+)[)\]}>]", name):
        for unit in (
            canonical_unit(match[1]),
            canonical_unit(match[1].replace("_", "/")),
        ):
            if unit in KNOWN_UNITS:
                return name[: match.start()] + name[match.end() :], unit
    last = re.fullmatch(
        r"(\w*[a-z]\w*)[_ ](N|s)|(i_\w+|\w*(?i:cur|strom)\w*)[_ ](A)", name
    )
    if last:
        return last[1] or last[3], last[2] or last[4]
    words = list(re.finditer(r"(?<![A-Za-z])[A-Za-z]+\d?(?![A-Za-z])", name))
    for first, match in enumerate(words):
        if match[0] not in UNIT_WORDS or len(words) == 1:
            continue
        last, unit = match, canonical_unit(match[0])
        if first + 1 < len(words) and words[first + 1][0] in ("s", "s2"):
            last = words[first + 1]
            unit = canonical_unit(f"{match[0]}/{last[0]}")
        if unit in KNOWN_UNITS:
            return name[: match.start()].rstrip("_- ") + name[last.end() :], unit
    return name, None


def _wrench_component(text: str) -> tuple[int, int] | None:
    """Force (0) or moment (1) and axis (0 to 2) stated in a wrench column's name.

    The result is None if the words state no component.
    """
    if match := re.search(r"\b([fmt])([xyz])\b", text):
        return int(match[1] != "f"), "xyz".index(match[2])
    axes = re.findall(r"\b[xyz]\b", text)
    moment = re.search(r"\b(torque|moment)", text) is not None
    if len(axes) != 1 or not (moment or re.search(r"\bforce", text)):
        return None
    return int(moment), "xyz".index(axes[0])


def _has_fragment(word: str, fragments: tuple[str, ...]) -> bool:
    """Test whether a word begins or ends with a fragment.

    Fragments of five letters or more may be anywhere in the word.
    """
    contained = any(fragment in word for fragment in fragments if len(fragment) > 4)
    return contained or word.startswith(fragments) or word.endswith(fragments)


def _signal_kind(
    words: tuple[str, ...], unit: str | None, role: tuple[int, int] | None
) -> str | None:
    """Signal of a column from its words and unit; None if neither states a signal.

    A wrench component takes precedence over symbols such as q, and symbols take precedence over
    fragments such as vel. If the unit contradicts the words, the unit decides.
    """
    if role is not None:
        return "wrench"
    by_symbol = [KIND_OF_SYMBOL[word] for word in words if word in KIND_OF_SYMBOL]
    by_fragment = [
        kind
        for kind, fragments in KIND_FRAGMENTS.items()
        if any(_has_fragment(word, fragments) for word in words)
    ]
    if "torque" in by_fragment[:1] and len(by_fragment) > 1 and "current" in words:
        by_fragment = by_fragment[1:]  # "current position" is not an electric current
    signal = (
        "base"
        if "base" in by_symbol
        else next(iter([*by_symbol[-1:], *by_fragment]), None)
    )
    if signal == "wrench" and any(word.startswith(LONG_JOINT_WORDS) for word in words):
        signal = "torque"  # force or moment of a joint
    if signal == "position":
        signal = next(
            (
                KIND_OF_DERIVATIVE_WORD[word]
                for word in words
                if word in KIND_OF_DERIVATIVE_WORD
            ),
            signal,
        )
    if unit is None or signal in ("wrench", "base"):
        return signal
    if unit in RAW_UNITS:
        return "torque"
    kinds_of_unit = [
        kind for kind in JOINT_QUANTITIES if unit in UNITS_BY_QUANTITY[kind]
    ]
    if signal in kinds_of_unit or unit in FORCE_UNITS:
        return signal
    return next(iter(kinds_of_unit), None if unit in MOMENT_UNITS else signal)


@dataclass(frozen=True)
class ColumnGroup:
    """Columns whose names differ only in the part that identifies the joint.

    Attributes:
        columns: Columns, in the order of `names`.
        names: Part of each column name that identifies the joint, for example joint_1 or 1, or the
            model's joint name.
        matched: True if `names` are joints of the model.
    """

    columns: tuple[ColumnName, ...]
    names: tuple[str, ...]
    matched: bool = False

    @property
    def joint_numbers(self) -> list[int]:
        """Joint numbers in the names; empty if the names differ in more than a number."""
        suffix = r"\D*" if len(self.names) > 1 else ""
        matches = [re.fullmatch(rf"(.*?)(\d+)({suffix})", name) for name in self.names]
        contexts = {(m[1], m[3]) for m in matches if m}
        return (
            [int(m[2]) for m in matches if m]
            if None not in matches and len(contexts) == 1
            else []
        )

    def with_model_joints(self, joints: Sequence[str]) -> ColumnGroup:
        """Group with the model's joint names in place of the numbers.

        Columns and joints with equal numbers are paired; if the joint names contain other numbers,
        columns and joints are paired in order. Excess columns are omitted; a group with too few
        numbers is returned unchanged.

        Args:
            joints: Joint names of the model, in its order.
        """
        n = len(joints)
        if self.matched or not n or len(self.joint_numbers) < n:
            return self
        numbers_in_names = [
            [int(w) for w in lower_case_words(name) if w.isdigit()] or [-1]
            for name in joints
        ]
        numbers = self.joint_numbers[:n]
        # last number, or the first one as in joint_12.0
        first_and_last = (
            [candidate[at] for candidate in numbers_in_names] for at in (-1, 0)
        )
        matching = [
            candidate
            for candidate in first_and_last
            if sorted(candidate) == sorted(numbers)
        ]
        indices = (
            [matching[0].index(number) for number in numbers] if matching else range(n)
        )
        return ColumnGroup(
            self.columns[:n], tuple(joints[k] for k in indices), True
        ).reordered_as(joints)

    def reordered_as(self, names: Sequence[str]) -> ColumnGroup:
        """Group with columns in the order of a permutation of its names.

        Args:
            names: Names in the new order; the group is unchanged if they are not the group's names.
        """
        if set(names) != set(self.names):
            return self
        order = [self.names.index(name) for name in names]
        return ColumnGroup(
            tuple(self.columns[k] for k in order), tuple(names), self.matched
        )


def column_groups(
    columns: Sequence[ColumnName], joints: Sequence[str] = ()
) -> Iterator[ColumnGroup]:
    """Yield groups of columns whose names differ only in the joint.

    Groups with joint names of the model come first. A column may be in several groups.

    Args:
        columns: Columns of one signal.
        joints: Joint names of the model; empty if the model is unknown.
    """
    by_template: dict[str, list[tuple[ColumnName, str]]] = {}
    by_model: dict[str, list[tuple[ColumnName, str]]] = {}
    for column in columns:
        for template, joint in _model_joint_template(column, joints):
            by_model.setdefault(template, []).append((column, joint))
        for template, label in _label_template(column, columns):
            by_template.setdefault(template, []).append((column, label))
    # joints whose columns differ in other words too: rail_force, j1_torque
    all_pairs = [pair for pairs in by_model.values() for pair in pairs]
    for pairs in (*by_model.values(), all_pairs):
        if pairs and (group := _group_of_distinct_joints(pairs, matched=True)):
            yield group.reordered_as(
                [label for label in joints if label in group.names]
            )
    # single column and joint
    if len(joints) == len(columns) == 1 and not by_model:
        yield ColumnGroup(tuple(columns), tuple(joints), True)
    for pairs in by_template.values():
        if group := _group_of_distinct_joints(pairs):
            ordered = [
                label
                for _, label in sorted(
                    zip(group.joint_numbers, group.names, strict=False)
                )
            ]
            yield group.reordered_as(ordered)
        by_prefix: dict[
            str, list[tuple[ColumnName, str]]
        ] = {}  # 1, 2 and Sm1, Sm2 are two groups
        for pair in pairs:
            if match := re.fullmatch(r"(\D*)\d+", pair[1]):
                by_prefix.setdefault(match[1], []).append(pair)
        for same_prefix in by_prefix.values():
            if 1 < len(same_prefix) < len(pairs) and (
                group := _group_of_distinct_joints(same_prefix)
            ):
                yield group


def as_joint_torque(column: ColumnName, joints: Sequence[str]) -> ColumnName:
    """Column as a joint torque, if its name has a force (without axis) and a joint.

    Other columns are returned unchanged.

    Args:
        column: Column with the signal that its name states.
        joints: Joint names of the model.
    """
    is_load = column.kind == "wrench" and column.wrench_component is None
    return (
        replace(column, kind="torque")
        if is_load and _model_joint_template(column, joints)
        else column
    )


def _group_of_distinct_joints(
    pairs: Sequence[tuple[ColumnName, str]], *, matched: bool = False
) -> ColumnGroup | None:
    """Group of columns and joint names; None if a joint occurs twice."""
    columns, names = zip(*pairs, strict=True)
    return (
        ColumnGroup(columns, names, matched) if len(set(names)) == len(names) else None
    )


def likeliest_group(
    groups: Sequence[ColumnGroup], count: int | None
) -> ColumnGroup | None:
    """Group that most likely belongs to the robot's joints; None if there are no groups.

    The criteria, in order of precedence, are: as many columns as joints; more columns than joints;
    joint names of the model and words for measured values; number of columns.

    Args:
        groups: Groups of one signal.
        count: Number of the robot's joints; None if unknown.
    """
    expected = count or max((len(each.names) for each in groups), default=0)

    def preference(group: ColumnGroup) -> tuple[bool, bool, int, int]:
        words = {word for column in group.columns for word in column.words}
        score = (
            group.matched + (not MEASURED_WORDS.isdisjoint(words)) - ("motor" in words)
        )
        size = len(group.names)
        return size == expected, size > expected, score, size

    return max(groups, key=preference, default=None)


def plate_columns(columns: Sequence[ColumnName]) -> dict[str, list[ColumnName]]:
    """Six columns of each plate keyed by its label, forces first.

    If no plate has six recognised components, the first group of six columns is taken, or all
    columns if there is no such group.

    Args:
        columns: Columns that may belong to a wrench.

    Returns:
        Columns keyed by the words of the names that distinguish the plates.
    """
    sets: dict[str, dict[tuple[int, int], ColumnName]] = {}
    for column in columns:
        if column.wrench_component is not None:
            sets.setdefault(_plate_label(column), {}).setdefault(
                column.wrench_component, column
            )
    complete = {
        name: [each[role] for role in sorted(each)]
        for name, each in sets.items()
        if len(each) == 6
    }
    if complete:
        return complete
    groups_of_six = (
        list(each.columns) for each in column_groups(columns) if len(each.columns) == 6
    )
    return {"": next(groups_of_six, list(columns))}


def is_tool_wrench(column: ColumnName) -> bool:
    """Test whether a wrench column belongs to a sensor at the tool."""
    return not TOOL_WORDS.isdisjoint(column.words)


def _model_joint_template(
    column: ColumnName, joints: Sequence[str]
) -> list[tuple[str, str]]:
    """Column name with a placeholder for the model's joint in it, and the joint.

    The longest joint name that occurs in the column name is taken; the list is empty if no joint
    name occurs. Joint names that consist of numbers only are ignored.
    """
    name, longest = f" {' '.join(column.words)} ", 0
    matches: list[tuple[str, str]] = []
    for joint in joints:
        words = lower_case_words(joint)
        for part in (words, tuple(word for word in words if word != "joint")):
            text = f" {' '.join(part)} "
            if text in name and len(part) > longest and not "".join(part).isdigit():
                longest, matches = len(part), [(name.replace(text, " {} ", 1), joint)]
    return matches


def _label_template(
    column: ColumnName, columns: Sequence[ColumnName]
) -> Iterator[tuple[str, str]]:
    """Yield the template of a column's name, and the label that identifies its joint.

    Words that name a signal stay in the template; placeholders replace the others. The label is the
    last replaced word that some other column lacks; nothing is yielded if there is no such word.
    """
    marked = re.sub(WORD_PATTERN, _mark_signal_word, column.name_without_unit)
    parts = re.findall(r"\0\w+\0|[A-Za-z\d]+(?:[_-]*[A-Za-z\d]+)*", marked, re.ASCII)
    template = " ".join(part if "\0" in part else "{}" for part in parts)
    for name in reversed([part for part in parts if "\0" not in part]):
        if len(columns) == 1 or not all(
            name in other.name_without_unit for other in columns
        ):
            yield template, name
            return


def _mark_signal_word(word: re.Match[str]) -> str:
    """Put a word between null characters if it names a signal.

    A word before a signal word is marked too: both words of JointAngle, for example.

    Args:
        word: Match of the word in the whole name.
    """
    next_word = (
        re.match(WORD_PATTERN, word.string[word.end() :]) if word[0].isalpha() else None
    )
    is_signal = is_signal_word(word[0]) or (next_word and is_signal_word(next_word[0]))
    return f"\0{word[0].lower()}\0" if is_signal else word[0]


def _plate_label(column: ColumnName) -> str:
    """Words of a wrench column's name without the words for force, moment and axis."""
    words = [
        re.sub(r"^([fmt])?[xyz]$|^(force|torque|moment)s?$", "", w)
        for w in column.words
    ]
    return " ".join(word for word in words if word)
