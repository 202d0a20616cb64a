"""Equations in every language and form, of an arm and of one that slides, as approved.

Short kinds whole; of all kinds together the operations and lines, which common factors decide.
"""

from __future__ import annotations

import numpy as np
import pytest

import testbed as tb
from testbed.symbolic.equations import FORMS, Form, equations
from testbed.symbolic.kinds import KINDS
from testbed.symbolic.languages import Language, write_equations
from tests.helpers.approved import hold, timeless
from tests.helpers.robots import random_robot
from tests.helpers.runs import robot

LANGUAGES: tuple[Language, ...] = ("paper", "latex", "python", "c")
SHORT = ("mass-matrix", "gravity-forces")


@pytest.mark.parametrize("language", LANGUAGES)
@pytest.mark.parametrize("form", FORMS)
def test_a_listing_is_as_approved(form: Form, language: Language) -> None:
    listing = equations(robot("puma"), SHORT, form, zeros=True)
    text = write_equations(listing, language, "models/puma562.xml")
    hold(f"listing_{form}.{language}.txt", timeless(text))


@pytest.mark.parametrize("language", LANGUAGES)
def test_numbers_and_slides_are_written_as_approved(language: Language) -> None:
    tree = random_robot(np.random.default_rng(8), 3).tree()
    listing = equations(tree, ("joint-forces",), "recursive", gravity=[0.1, 0, -9.8], numbers=True)
    hold(f"listing_tree.{language}.txt", timeless(write_equations(listing, language, "tree")))


@pytest.mark.slow
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", ["puma", "gantry"])
def test_all_kinds_are_as_long_as_approved(name: str, form: Form) -> None:
    tree: tb.Tree = robot(name)
    lines = []
    for kind in KINDS:
        if name == "gantry" and form == "full":
            continue  # nobody reads these
        text = write_equations(equations(tree, kind, form), "paper", name)
        signs = " ".join(f"{sign} {text.count(sign)}" for sign in "+-*/()=")
        lines.append(f"{kind}: {len(text.splitlines())} lines, {len(text)} characters, {signs}")
    hold(f"listing_sizes_{name}_{form}.txt", "\n".join(lines) + "\n")
