"""What the names of foreign columns say: quantity, unit, joint; and which belong together."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from testbed.importing.foreign_table import (
    FORCES,
    KINDS,
    KNOWN,
    MOMENTS,
    RAW,
    UNITS,
    plain,
)
from testbed.importing.vocabulary import TABLES, by_word

PARTS = {kind: tuple(words) for kind, words in TABLES["parts"].items()}
"""Beginnings or ends of words by which columns are distinguished, in the order of precedence."""

SYMBOLS = by_word("symbols")
"""Words of names, whole, that say more than their parts."""

DERIVATIVES: dict[str, str] = TABLES["derivatives"]
"""Words beside that of a position by which it is a derivative, as theta_dot."""

WARMTH, COMMANDS, MEASURED, JOINT_WORDS, HAND, UNIT_WORDS = (
    frozenset(TABLES["words"][key])
    for key in ("warmth", "commands", "measured", "joints", "hand", "units")
)
"""Words of drives' temperatures, of what was wanted, of what was measured, of joints, of a wrench
that is not the plate's, and of units wherever they stand in a name."""

BESIDE = COMMANDS | WARMTH | {*TABLES["words"]["beside"]}
"""Words of columns that are no signal of the joints or of the plate, whatever else they say."""

SAYING = {*SYMBOLS, *DERIVATIVES, *MEASURED, "motor", "log", "data"}
"""Words of signals, whole."""

LONG_JOINT_WORDS = tuple(word for word in JOINT_WORDS if len(word) > 2)
"""Those with which words of joints may begin, as in Achsmoment."""

WORD = r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+"
"""A word of a name, or a number."""


@dataclass(frozen=True)
class ColumnName:
    """A name, taken apart.

    Attributes:
        name: As the file has it.
        bare: Without the unit.
        words: Of the bare name, in small letters: letters and numbers apart.
        unit: As it is written here; None if the name has none.
        kind: A signal, or None where the name says none.
        role: Of a wrench's column: 0 for force or 1 for moment, and the axis; None if not said.
    """

    name: str
    bare: str
    words: tuple[str, ...]
    unit: str | None
    kind: str | None
    role: tuple[int, int] | None

    @property
    def beside(self) -> bool:
        """Whether it is a command, or none of the signals that a recording takes."""
        return not BESIDE.isdisjoint(self.words)


def read_name(name: str, said: str | None = None) -> ColumnName:
    """Take a name apart.

    Args:
        name: Of a column.
        said: What the file says of its unit beside the name.
    """
    bare, unit = without_unit(name)
    if said and plain(said) in KNOWN:
        unit = plain(said)
    words = words_of(bare)
    role = _role(" ".join(words))
    kind = _kind(words, unit, role)
    if kind in ("velocity", "acceleration") and unit in UNITS["position"]:
        unit = f"{unit}/s" + "^2" * (kind == "acceleration")
    return ColumnName(name, bare, words, unit, kind, role)


def words_of(text: str) -> tuple[str, ...]:
    """Words in small letters and numbers: ActualPosJ1 is actual, pos, j, 1."""
    return tuple(word.lower() for word in re.findall(WORD, text))


def says_signal(word: str) -> bool:
    """Whether a word says what is measured, of whatever joint."""
    small = word.lower()
    if small in JOINT_WORDS:
        return False
    return small in SAYING or any(_has_part(small, each) for each in PARTS.values())


def without_unit(name: str) -> tuple[str, str | None]:
    """A name without its unit, as Fx (lbf), q_deg_1, vel_rad_s; and the unit."""
    for found in re.finditer(r"\s*[(\[{<]([^()\[\]{}<>]+)[)\]}>]", name):
        for unit in (plain(found[1]), plain(found[1].replace("_", "/"))):
            if unit in KNOWN:
                return name[: found.start()] + name[found.end() :], unit
    last = re.fullmatch(
        r"(\w*[a-z]\w*)[_ ](N|s)|(i_\w+|\w*(?i:cur|strom)\w*)[_ ](A)", name
    )
    if last:
        return last[1] or last[3], last[2] or last[4]
    words = list(re.finditer(r"(?<![A-Za-z])[A-Za-z]+\d?(?![A-Za-z])", name))
    for first, found in enumerate(words):
        if found[0] not in UNIT_WORDS or len(words) == 1:
            continue
        last, unit = found, plain(found[0])
        if first + 1 < len(words) and words[first + 1][0] in ("s", "s2"):
            last = words[first + 1]
            unit = plain(f"{found[0]}/{last[0]}")
        if unit in KNOWN:
            return name[: found.start()].rstrip("_- ") + name[last.end() :], unit
    return name, None


def _role(text: str) -> tuple[int, int] | None:
    """Force (0) or moment (1) and axis (0 to 2) of a column of a wrench, by its words."""
    if found := re.search(r"\b([fmt])([xyz])\b", text):
        return int(found[1] != "f"), "xyz".index(found[2])
    axes = re.findall(r"\b[xyz]\b", text)
    moment = re.search(r"\b(torque|moment)", text) is not None
    if len(axes) != 1 or not (moment or re.search(r"\bforce", text)):
        return None
    return int(moment), "xyz".index(axes[0])


def _has_part(word: str, parts: tuple[str, ...]) -> bool:
    """Whether a word begins or ends with a part, or contains a long one."""
    inside = any(part in word for part in parts if len(part) > 4)
    return inside or word.startswith(parts) or word.endswith(parts)


def _kind(
    words: tuple[str, ...], unit: str | None, role: tuple[int, int] | None
) -> str | None:
    """The signal, by words; by the unit where they say another one, or nothing."""
    if role is not None:
        return "wrench"
    named = [SYMBOLS[word] for word in words if word in SYMBOLS]
    parts = [
        kind
        for kind, each in PARTS.items()
        if any(_has_part(word, each) for word in words)
    ]
    if "torque" in parts[:1] and len(parts) > 1 and "current" in words:
        parts = parts[1:]  # the current position is no current
    found = "base" if "base" in named else next(iter([*named[-1:], *parts]), None)
    if found == "wrench" and any(word.startswith(LONG_JOINT_WORDS) for word in words):
        found = "torque"  # force or moment of a joint
    if found == "position":
        found = next(
            (DERIVATIVES[word] for word in words if word in DERIVATIVES), found
        )
    if unit is None or found in ("wrench", "base"):
        return found
    if unit in RAW:
        return "torque"
    fitting = [kind for kind in KINDS if unit in UNITS[kind]]
    if found in fitting or unit in FORCES:
        return found
    return next(iter(fitting), None if unit in MOMENTS else found)


@dataclass(frozen=True)
class Group:
    """Columns whose names differ by the joint only.

    Attributes:
        columns: In the order of `names`, if these are known.
        names: What in them stands for the joint, as joint_1 or 1.
        matched: Whether these are the model's.
    """

    columns: tuple[ColumnName, ...]
    names: tuple[str, ...]
    matched: bool = False

    @property
    def numbers(self) -> list[int]:
        """Those of the names, if that is all that distinguishes them; else none."""
        after = r"\D*" if len(self.names) > 1 else ""
        found = [re.fullmatch(rf"(.*?)(\d+)({after})", name) for name in self.names]
        around = {(m[1], m[3]) for m in found if m}
        return (
            [int(m[2]) for m in found if m]
            if None not in found and len(around) == 1
            else []
        )

    def of(self, joints: Sequence[str]) -> Group:
        """With the model's names in place of numbers, if there are enough; more are left out.

        Args:
            joints: Names in the model, in its order.
        """
        n = len(joints)
        if self.matched or not n or len(self.numbers) < n:
            return self
        own = [
            [int(w) for w in words_of(name) if w.isdigit()] or [-1] for name in joints
        ]
        numbers = self.numbers[:n]
        # joint_12.0 is the twelfth
        several = ([each[at] for each in own] for at in (-1, 0))
        fits = [each for each in several if sorted(each) == sorted(numbers)]
        places = [fits[0].index(number) for number in numbers] if fits else range(n)
        return Group(self.columns[:n], tuple(joints[k] for k in places), True).like(
            joints
        )

    def like(self, names: Sequence[str]) -> Group:
        """The columns in the order of other names for the same joints."""
        if set(names) != set(self.names):
            return self
        order = [self.names.index(name) for name in names]
        return Group(tuple(self.columns[k] for k in order), tuple(names), self.matched)


def grouped(
    columns: Sequence[ColumnName], joints: Sequence[str] = ()
) -> Iterator[Group]:
    """Columns of one kind, those together whose names differ by the joint only.

    Args:
        columns: Of one kind.
        joints: Names in the model, if it is known.
    """
    members: dict[str, list[tuple[ColumnName, str]]] = {}
    by_model: dict[str, list[tuple[ColumnName, str]]] = {}
    for column in columns:
        for rest, joint in _model_joint(column, joints):
            by_model.setdefault(rest, []).append((column, joint))
        for rest, name in _own_name(column, columns):
            members.setdefault(rest, []).append((column, name))
    # rail_force beside j1_torque
    every = [pair for pairs in by_model.values() for pair in pairs]
    for pairs in (*by_model.values(), every):
        if pairs and (group := _group(pairs, matched=True)):
            yield group.like([name for name in joints if name in group.names])
    # nothing needs distinguishing
    if len(joints) == len(columns) == 1 and not by_model:
        yield Group(tuple(columns), tuple(joints), True)
    for pairs in members.values():
        if group := _group(pairs):
            ordered = [
                name
                for _, name in sorted(zip(group.numbers, group.names, strict=False))
            ]
            yield group.like(ordered)
        numbered: dict[
            str, list[tuple[ColumnName, str]]
        ] = {}  # 1, 2 apart from Sm1, Sm2
        for pair in pairs:
            if found := re.fullmatch(r"(\D*)\d+", pair[1]):
                numbered.setdefault(found[1], []).append(pair)
        for alike in numbered.values():
            if 1 < len(alike) < len(pairs) and (group := _group(alike)):
                yield group


def as_torques(column: ColumnName, joints: Sequence[str]) -> ColumnName:
    """Column as a joint torque, if its name states a force and a joint.

    Args:
        column: As its name states it.
        joints: Names in the model.
    """
    load = column.kind == "wrench" and column.role is None
    return (
        replace(column, kind="torque")
        if load and _model_joint(column, joints)
        else column
    )


def _group(
    pairs: Sequence[tuple[ColumnName, str]], *, matched: bool = False
) -> Group | None:
    """A group, if each joint is there once."""
    columns, names = zip(*pairs, strict=True)
    return Group(columns, names, matched) if len(set(names)) == len(names) else None


def best_group(groups: Sequence[Group], count: int | None) -> Group | None:
    """The group that is most likely the joints' own.

    Args:
        groups: Of one kind.
        count: Joints of the robot; None if that is not known.
    """
    wanted = count or max((len(each.names) for each in groups), default=0)

    def likely(group: Group) -> tuple[bool, bool, int, int]:
        words = {word for column in group.columns for word in column.words}
        favour = group.matched + (not MEASURED.isdisjoint(words)) - ("motor" in words)
        size = len(group.names)
        return size == wanted, size > wanted, favour, size

    return max(groups, key=likely, default=None)


def plate_columns(columns: Sequence[ColumnName]) -> dict[str, list[ColumnName]]:
    """The six columns of each plate, forces first; fewer, as they are, where none has all.

    Args:
        columns: Those that look like a wrench's.

    Returns:
        By what distinguishes the plates in their columns' names.
    """
    sets: dict[str, dict[tuple[int, int], ColumnName]] = {}
    for column in columns:
        if column.role is not None:
            sets.setdefault(_without_role(column), {}).setdefault(column.role, column)
    whole = {
        name: [each[role] for role in sorted(each)]
        for name, each in sets.items()
        if len(each) == 6
    }
    if whole:
        return whole
    six = (list(each.columns) for each in grouped(columns) if len(each.columns) == 6)
    return {"": next(six, list(columns))}


def at_the_hand(column: ColumnName) -> bool:
    """Whether a wrench is that of a tool, and not of the plate."""
    return not HAND.isdisjoint(column.words)


def _model_joint(column: ColumnName, joints: Sequence[str]) -> list[tuple[str, str]]:
    """The rest of a name and the model's joint that is in it; the longest, if several are.

    A number alone is any column's.
    """
    name, longest = f" {' '.join(column.words)} ", 0
    found: list[tuple[str, str]] = []
    for joint in joints:
        whole = words_of(joint)
        for part in (whole, tuple(word for word in whole if word != "joint")):
            said = f" {' '.join(part)} "
            if said in name and len(part) > longest and not "".join(part).isdigit():
                longest, found = len(part), [(name.replace(said, " {} ", 1), joint)]
    return found


def _own_name(
    column: ColumnName, columns: Sequence[ColumnName]
) -> Iterator[tuple[str, str]]:
    """The rest of a name and what in it is not about the signal and not in all names."""
    said = re.sub(WORD, _marked, column.bare)
    parts = re.findall(r"\0\w+\0|[A-Za-z\d]+(?:[_-]*[A-Za-z\d]+)*", said, re.ASCII)
    rest = " ".join(part if "\0" in part else "{}" for part in parts)
    for name in reversed([part for part in parts if "\0" not in part]):
        if len(columns) == 1 or not all(name in other.bare for other in columns):
            yield rest, name
            return


def _marked(word: re.Match[str]) -> str:
    """A word between marks if it is about the signal, as both of JointAngle."""
    after = re.match(WORD, word.string[word.end() :]) if word[0].isalpha() else None
    about = says_signal(word[0]) or (after and says_signal(after[0]))
    return f"\0{word[0].lower()}\0" if about else word[0]


def _without_role(column: ColumnName) -> str:
    """A wrench column's name without what says force or moment and the axis."""
    about = [
        re.sub(r"^([fmt])?[xyz]$|^(force|torque|moment)s?$", "", w)
        for w in column.words
    ]
    return " ".join(word for word in about if word)
