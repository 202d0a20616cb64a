"""Columns of one kind as the joints': which belong together, and in which order."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import zip_longest

from testbed.recordings.importing.column_names import (
    HAND,
    MEASURED,
    RATES,
    TURNS,
    WORD,
    ColumnName,
    says_signal,
    words_of,
)


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
        """Those of the names, if that is all that tells them apart; else none."""
        found = [re.fullmatch(r"(\D*)(\d+)(\D*)", name) for name in self.names]
        around = {(m[1], m[3]) for m in found if m}
        return [int(m[2]) for m in found if m] if None not in found and len(around) == 1 else []

    def of(self, joints: Sequence[str]) -> Group:
        """With the model's names in place of numbers, if there are enough; more are left out.

        Args:
            joints: Names in the model, in its order.
        """
        n = len(joints)
        if self.matched or not n or len(self.numbers) < n:
            return self
        last = [([int(w) for w in words_of(name) if w.isdigit()] or [-1])[-1] for name in joints]
        numbers = self.numbers[:n]
        same = sorted(last) == sorted(numbers)
        places = [last.index(number) for number in numbers] if same else range(n)
        return Group(self.columns[:n], tuple(joints[k] for k in places), True).like(joints)

    def like(self, names: Sequence[str]) -> Group:
        """The columns in the order of other names for the same joints."""
        if set(names) != set(self.names):
            return self
        order = [self.names.index(name) for name in names]
        return Group(tuple(self.columns[k] for k in order), tuple(names), self.matched)


def grouped(columns: Sequence[ColumnName], joints: Sequence[str] = ()) -> Iterator[Group]:
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
    for pairs in by_model.values():
        if group := _group(pairs, matched=True):
            yield group.like([name for name in joints if name in group.names])
    for pairs in members.values():
        if group := _group(pairs):
            ordered = [name for _, name in sorted(zip(group.numbers, group.names, strict=False))]
            yield group.like(ordered)
        numbered: dict[str, list[tuple[ColumnName, str]]] = {}  # 1, 2 apart from Sm1, Sm2
        for pair in pairs:
            if found := re.fullmatch(r"(\D*)\d+", pair[1]):
                numbered.setdefault(found[1], []).append(pair)
        for alike in numbered.values():
            if 1 < len(alike) < len(pairs) and (group := _group(alike)):
                yield group


def _group(pairs: Sequence[tuple[ColumnName, str]], *, matched: bool = False) -> Group | None:
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
        By what tells the plates apart in their columns' names.
    """
    sets: dict[str, dict[tuple[int, int], ColumnName]] = {}
    for column in columns:
        if column.role is not None:
            sets.setdefault(_without_role(column), {}).setdefault(column.role, column)
    whole = {
        name: [each[role] for role in sorted(each)] for name, each in sets.items() if len(each) == 6
    }
    if whole:
        return whole
    six = (list(each.columns) for each in grouped(columns) if len(each.columns) == 6)
    return {"": next(six, list(columns))}


def base_columns(columns: Sequence[ColumnName]) -> tuple[list[str], list[str]]:
    """Columns of a base's place (x, y, z) and quaternion (w, x, y, z), empty where not named.

    Seven that are only numbered are in this order.

    Args:
        columns: Those that look like a base's.
    """
    own = [each for each in columns if not each.beside and RATES.isdisjoint(each.words)]
    turn = [each for each in own if not TURNS.isdisjoint(each.words)]
    if len(own) == 7 and all(each.words[-1].isdigit() for each in own):
        names = [each.name for each in own]
        return names[:3], names[3:]

    def along(of: Sequence[ColumnName], axes: str) -> list[str]:
        return [next((c.name for c in of if c.words[-1] in (a, f"q{a}")), "") for a in axes]

    return along([each for each in own if each not in turn], "xyz"), along(turn, "wxyz")


def at_the_hand(column: ColumnName) -> bool:
    """Whether a wrench is that of a tool, and not of the plate."""
    return not HAND.isdisjoint(column.words)


def _model_joint(column: ColumnName, joints: Sequence[str]) -> Iterator[tuple[str, str]]:
    """The rest of a name and the model's joint that is in it; the longest, if several are."""
    best: tuple[int, str, str] | None = None
    for joint in joints:
        whole = words_of(joint)
        for part in (whole, tuple(word for word in whole if word != "joint")):
            if all(word.isdigit() for word in part):
                continue  # a number alone is any column's
            for k in range(len(column.words) - len(part) + 1):
                same = column.words[k : k + len(part)] == part
                if same and (best is None or len(part) > best[0]):
                    rest = [*column.words[:k], "{}", *column.words[k + len(part) :]]
                    best = (len(part), " ".join(rest), joint)
    if best is not None:
        yield best[1:]


def _own_name(column: ColumnName, columns: Sequence[ColumnName]) -> Iterator[tuple[str, str]]:
    """The rest of a name and what in it is not about the signal and not in all names."""
    words = [(m[0], m.start(), m.end()) for m in re.finditer(WORD, column.bare)]
    runs: list[tuple[int, int]] = []
    said: list[str] = []
    end = -2
    for (text, start, stop), after in zip_longest(words, words[1:], fillvalue=("", -1, -1)):
        of_signal = after[1] == stop and text.isalpha() and says_signal(after[0])  # JointAngle
        if says_signal(text) or of_signal:
            said.append(text.lower())
        elif runs and said[-1] == "{}" and not column.bare[end:start].strip("_-"):
            runs[-1] = (runs[-1][0], stop)
        else:
            runs.append((start, stop))
            said.append("{}")
        end = stop
    for start, stop in reversed(runs):
        name = column.bare[start:stop]
        if len(columns) == 1 or not all(name in other.bare for other in columns):
            yield " ".join(said), name
            return


def _without_role(column: ColumnName) -> str:
    """A wrench column's name without what says force or moment and the axis."""
    about = [re.sub(r"^([fmt])?[xyz]$|^(force|torque|moment)s?$", "", w) for w in column.words]
    return " ".join(word for word in about if word)
