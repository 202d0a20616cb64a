"""What the documents say is so: links, keys, names of files; figures are checked nightly."""

from __future__ import annotations

import re
import tomllib
from itertools import chain

from testbed.lab.experiment.experiment_tables import METRICS
from tests.helpers.blocks import PAGES, TEMPLATES
from tests.helpers.paths import ROOT

PHRASES = re.compile(
    "what is left of|(?:is|are) silent|taken back|mere noise|by itself alone|friction law"
    "|laws? of friction|holds? the truth|sigmas? (?:that )?holds?|not notice|can exist"
    "|bodies that cannot be"
)
"""Of no textbook, and made of words that codespell lets pass; docs/words.txt has the others."""


def said(name: str) -> str:
    return (ROOT / name).read_text()


def test_links_and_references_lead_somewhere() -> None:
    """README's on GitHub, too, where nothing is that is written with the site."""
    known = set(re.findall(r"@\w+\{(\w+),", said("REFERENCES.bib")))
    for page in PAGES:
        text, written = page.read_text(), {each.name for each in TEMPLATES.glob("*.md")}
        place = ROOT / "docs" if page.parent == TEMPLATES else page.parent
        for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", text):
            later = page.parent == TEMPLATES and target in written
            assert target.startswith("http") or later or (place / target).exists(), (page, target)
            assert later or (place / target).resolve().name not in written, (page, target)
        assert set(re.findall(r"\[([A-Z][A-Za-z]{1,4}\d{2})\]", text)) <= known, page


def test_whatever_a_file_may_say_is_documented() -> None:
    """Metrics, experiments, dependencies; the page of all keys is made from the code."""
    project = tomllib.loads(said("pyproject.toml"))["project"]
    needed = [*project["dependencies"], *chain(*project["optional-dependencies"].values())]
    packages = [re.split(r"[<>=\[ ]", requirement)[0] for requirement in needed]
    files = [path.name for path in (ROOT / "experiments").glob("*.toml")]
    for page, names in (("docs/experiments.md", METRICS), ("docs/dependencies.md", packages)):
        assert [name for name in names if f"`{name}`" not in said(page)] == [], page
    assert [name for name in files if name not in said("experiments/README.md")] == []


def test_documents_speak_as_textbooks_do() -> None:
    found = {page: PHRASES.findall(page.read_text().lower()) for page in PAGES}
    assert {page: phrases for page, phrases in found.items() if phrases} == {}


def test_a_claim_names_a_file_that_checks_it() -> None:
    rows = re.findall(r"^\| .*`.*\|$", said("docs/claims.md").partition("## What")[0], re.MULTILINE)
    assert len(rows) > 20
    for row in rows:
        command = row.rstrip("| ").split("|")[-1]
        files = re.findall(r"(?:tests|experiments|docs)/[\w./-]+", command)
        files += [f"benchmarks/{name}.py" for name in re.findall(r"-m benchmarks (\w+)", command)]
        assert files or "the same" in command, row
        assert [name for name in files if not (ROOT / name).exists()] == [], row
