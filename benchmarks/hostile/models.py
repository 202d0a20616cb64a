"""Hostile models: URDF and MJCF with wrong numbers, names, structures and sizes."""

from __future__ import annotations

import random
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from functools import cache
from xml.sax.saxutils import quoteattr

import numpy as np

from benchmarks.hostile.bombs import bomb
from benchmarks.hostile.case import Case, Change, chance, changed
from benchmarks.hostile.words import NAMES, NUMBERS, SPOILED
from tests.helpers.paths import GOLDEN, ROOT
from tests.helpers.robots import random_robot

_NUMBER = re.compile(r"(?<=[\s\"])-?\d[\d.eE+-]*(?=[\s\"])")
_ATTRIBUTE = re.compile(r'(\s[\w:]+)="([^"]*)"')

COMMANDS = (
    ("minimal",), ("minimal", "--zeros", "--map"), ("minimal", "--json"), ("minimal", "--latex"),
    ("minimal", "--weld-root", "--lock-mimic"), ("minimal", "--verify"),
    ("equations", "--form", "recursive"), ("equations", "--zeros", "--form", "reduced"),
    ("equations", "--language", "c", "--form", "recursive", "--what", "all"),
    ("equations", "--language", "python", "--numbers", "--right-angles"),
    ("equations", "--json", "--form", "recursive", "--what", "base-wrench"),
)  # fmt: skip


@cache
def sources() -> list[tuple[str, str]]:
    """Models to begin with: file name and text."""
    small = ("pendulum", "gantry_ppp_rrr", "two_trunks", "ur5", "random_tree_00", "t4_rr_inclined")
    found = [("model.urdf", (GOLDEN / f"robots/{name}.urdf").read_text()) for name in small]
    found += [(f"model{p.suffix}", p.read_text()) for p in sorted((ROOT / "models").glob("puma*"))]
    for seed in range(4):
        robot = random_robot(np.random.default_rng(seed), 3 + seed)
        found += [("model.urdf", robot.urdf()), ("model.xml", robot.mjcf())]
    return found


def numbers(rng: random.Random, text: str) -> str:
    """Some numbers, or all of one attribute's, replaced."""
    places = list(_NUMBER.finditer(text))
    for place in sorted(rng.sample(places, min(len(places), rng.randint(1, 3))), key=_end):
        text = text[: place.start()] + rng.choice(NUMBERS) + text[place.end() :]
    return text


def _end(place: re.Match[str]) -> int:
    return -place.end()


def attributes(rng: random.Random, text: str) -> str:
    """One attribute lost, doubled, renamed or with another value."""
    places = list(_ATTRIBUTE.finditer(text))
    if not places:
        return text
    place = rng.choice(places)
    name, value = place.groups()
    made = rng.choice(
        (
            "",
            place[0] * 2,
            f'{name}x="{value}"',
            f"{name}={quoteattr(rng.choice(NAMES))}",
            f'{name}="{rng.choice(NUMBERS)}"',
            f'{name}="{rng.choice(places)[2]}"',
            f'{name}="{value} {value}"',
            f'{name}="&#{rng.choice((0, 27, 155, 8238, 55296, 1114112))};"',
        )
    )
    return text[: place.start()] + made + text[place.end() :]


def structure(rng: random.Random, text: str) -> str:
    """Elements lost, doubled, renamed or put elsewhere."""
    try:
        root = ET.fromstring(text)
    except (ET.ParseError, ValueError):
        return text
    parents = [element for element in root.iter() if len(element)]
    if not parents:
        return text
    parent = rng.choice(parents)
    child = rng.choice(list(parent))
    what = rng.randrange(5)
    if what < 2:
        parent.remove(child)
    if what == 1:
        rng.choice(list(root.iter())).append(child)
    if what == 2:
        parent.append(child)
    if what == 3:
        child.tag = rng.choice([e.tag for e in root.iter()] + ["x", "include", "attach", "plugin"])
    if what == 4:
        child.attrib = dict(rng.choice(list(root.iter())).attrib)
    try:
        return ET.tostring(root, encoding="unicode")
    except (ValueError, RecursionError, TypeError):  # an element within itself
        return text


def prologue(rng: random.Random, text: str) -> str:
    """What XML may begin with: encodings, entities, doctypes, instructions."""
    return (
        rng.choice(
            (
                '<?xml version="1.0" encoding="utf-16"?>',
                '<?xml version="1.0" encoding="nothing"?>',
                '<?xml version="9.9"?>',
                '<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/passwd">]>',
                '<!DOCTYPE r [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;">]>',
                "<?php system('id'); ?>",
                "<!-- " + "-" * 100,
                "\ufeff\ufeff",
                "\x00",
                "<?xml-stylesheet href='http://127.0.0.1/'?>",
            )
        )
        + text
    )


def nested(rng: random.Random, text: str) -> str:
    """Elements within elements, thousands deep, or thousands beside each other."""
    places = [m.start() for m in re.finditer("<", text)]
    place = rng.choice(places) if places else 0
    count = rng.choice((100, 5_000, 100_000))
    tag = rng.choice(("body", "link", "joint", "x", "default", "frame"))
    more = rng.choice((f"<{tag}>" * count + f"</{tag}>" * count, f"<{tag}/>" * count))
    return text[:place] + more + text[place:]


CHANGES: tuple[tuple[str, Change], ...] = (
    *(("numbers", numbers),) * 5,
    *(("attributes", attributes),) * 6,
    *(("structure", structure),) * 5,
    ("prologue", prologue),
    ("nesting", nested),
    *SPOILED,
)


def cases(count: int, seed: int) -> Iterator[Case]:
    """Hostile models.

    Args:
        count: How many.
        seed: Of all choices.
    """
    for number in range(count):
        rng = chance(seed, "model", number)
        files: dict[str, bytes] = {}
        if number % 40 == 39:
            how, name, files = bomb(rng, number // 40)
        else:
            name, text = rng.choice(sources())
            how, files[name] = changed(rng, text, CHANGES)
        command, *options = rng.choice(COMMANDS)
        yield Case(f"model-{number:04d}", how, (command, name, *options), files)
