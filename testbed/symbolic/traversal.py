"""Factors in the order in which they can be computed: each after those it needs."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from testbed.symbolic.expression import ZERO, Expression, Factor, Nature


def in_order(values: Iterable[Expression]) -> list[Factor]:
    """The auxiliary variables and brackets that values refer to, each after those it needs."""
    first = [factor for value in values for factor in _names(value)]
    return depth_first(first, lambda factor: _names(factor.content or ZERO))


def depth_first(first: Iterable[Factor], needs: Callable[[Factor], list[Factor]]) -> list[Factor]:
    """Factors and all that they need, each after what it needs; as deep as may be.

    Args:
        first: Where to start.
        needs: What one of them refers to.
    """
    found: list[Factor] = []
    seen: set[Factor] = set()
    todo = [(factor, False) for factor in first][::-1]
    while todo:
        factor, ready = todo.pop()
        if ready:
            found.append(factor)
        elif factor not in seen:
            seen.add(factor)
            todo.append((factor, True))
            todo += [(each, False) for each in reversed(needs(factor)) if each not in seen]
    return found


def _names(value: Expression) -> list[Factor]:
    return [f for factors, _ in value.terms for f in factors if f.nature >= Nature.AUXILIARY]
