"""What the terminal shows at any width, and what programs are given in its place."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable
from functools import partial
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import testbed as tb
from testbed.campaigns.campaign_section import cells_figure, print_campaign
from testbed.campaigns.summary import summarise
from testbed.core.parameters.identifiability import identifiability
from testbed.core.parameters.joint_terms import with_joint_terms
from testbed.view import output
from testbed.view.figures import Panel
from testbed.view.minimal_sets import (  # fmt: skip
    IdentifiabilityReport,
    minimal_sets_document,
    print_latex,
    print_sets,
)
from testbed.view.motion import print_excitation
from testbed.view.section import Table
from testbed.view.terminal import print_estimates, print_run
from tests.helpers.pages import campaign, excitation, run_named
from tests.helpers.paths import GOLDEN
from tests.helpers.strategies import few, trees

WIDTHS = st.integers(60, 140)


def findings(tree: tb.Tree) -> IdentifiabilityReport:
    dynamic, reaction = (tb.minimal_set(tree, model) for model in ("torque", "wrench"))
    drives = with_joint_terms(tree, dynamic, ("rotor",))
    return IdentifiabilityReport(tree, dynamic, reaction, drives, identifiability(tree))


def printed(width: int, print_it: Callable[..., object], *words: Any) -> str:
    """The text that something prints on a terminal of some width."""
    console = output.PlainConsole(markup=False, width=width, record=True, file=StringIO())
    print_it(console, *words)
    return console.export_text()


def dense(text: str) -> str:
    return re.sub(r"[\s│┃]", "", text)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ur5", "gantry"])
def test_no_number_of_a_run_is_cut_and_the_first_screen_holds_it(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """40 rows of 100 columns: verdict, one cause, ten parameters; all of it where it is asked."""
    run = run_named(name)
    estimates = list(run.estimates.values())
    names = {parameter for each in estimates for parameter in each.names}
    for columns in (60, 80, 100, 140):
        monkeypatch.setenv("COLUMNS", str(columns))
        shows: tuple[Callable[..., None], ...] = (
            partial(print_run, run, Path("folder")),
            partial(print_estimates, estimates, run.diagnostics),
        )
        for show in shows:
            show(everything=False)
            short = capsys.readouterr().out
            show(everything=True)
            whole = capsys.readouterr().out
            assert "…" not in whole
            table = [line for line in whole.splitlines() if re.match(r"│|  \S", line)]
            assert max(map(len, table)) <= columns
            assert {n for n in names if f" {n} " in whole} == names
            assert sum(f" {n} " in short for n in names) >= min(10, len(names))
            lines = sum(-(-len(line) // columns) for line in short.splitlines())
            assert lines <= 40 or columns < 100
            assert short.count("warning: ") <= 1


@given(WIDTHS)
def test_a_table_that_is_split_keeps_its_columns_in_order(width: int) -> None:
    """Those of one name, too, as the errors of two methods have."""
    cells = [f"{k}.2345678" for k in range(8)]
    table = Table(["row", *["max z"] * 8], [["one", *cells]], parts=(range(1, 5), range(5, 9)))
    text = printed(width, output.print_tables, [table])
    assert re.findall(r"\d\.2345678", text) == cells
    assert max(map(len, text.splitlines())) <= width


@given(st.integers(80, 140), st.integers(1, 30), st.integers(1, 30))
def test_words_give_way_before_the_names_of_rows(width: int, value: int, known: int) -> None:
    """Keys of a mapping are copied: none is broken, however long its value and its reason."""
    keys = ["position.columns", "sources.robot.delay", "torque.unit"]
    rows = [[key, "0.125, " * value, "solved by " * known] for key in keys]
    table = Table(["key", "value", "known by"], rows, left=["value", "known by"])
    lines = printed(width, output.print_tables, [table]).splitlines()
    assert [word for line in lines for word in line[:22].split() if "." in word] == keys
    assert max(map(len, lines)) <= width


@pytest.mark.slow
@given(WIDTHS)
@few(4)
def test_a_motions_promises_and_limits_are_told_the_worst_first(width: int) -> None:
    found = excitation()
    text = printed(width, lambda out: print_excitation(out, found, Path("m"), everything=True))
    lines = [set(line.split()) for line in text.splitlines()]
    names, relative = found.predicted.names, found.predicted.relative
    for name, sigma, share in zip(names, found.predicted.sigma, relative, strict=True):
        assert any({name, f"{sigma:.2g}", f"{share:.3%}"} <= line for line in lines)
    assert "…" not in text
    short = printed(width, print_excitation, found, Path("m"))
    first = [line.split()[0] for line in short.splitlines() if line.strip()]
    assert [n for n in first if n in names] == [names[k] for k in np.argsort(-relative)[:10]]


@pytest.mark.slow
@given(trees((2, 6)), WIDTHS)
@few(6)
def test_no_term_of_a_minimal_set_is_lost(tree: tb.Tree, width: int) -> None:
    """On the terminal, in LaTeX, and in the document for programs."""
    found = findings(tree)
    text, whole = (printed(columns, print_sets, found, "symbols") for columns in (width, 500))
    assert Counter(dense(text)) == Counter(dense(whole))  # whatever is broken where
    document = json.loads(json.dumps(minimal_sets_document(found)))
    assert "…" not in text
    latex = printed(80, print_latex, found, "symbols").splitlines()
    assert [line for line in latex if not line.startswith("% ") and " &= " not in line] == []
    np.testing.assert_array_equal(document["S"], tb.selection(found.dynamic, found.reaction))
    for each in (found.dynamic, found.reaction):
        written = document[each.model]
        np.testing.assert_array_equal(written["matrix"], each.matrix)
        np.testing.assert_array_equal(written["standard_matrix"], each.standard_matrix)
        assert written["names"] == list(each.names)
        for formula in each.formulas:
            assert f" {formula.left.text} " in whole
            assert formula.is_trivial or formula.right_text in whole


def test_the_pumas_set_is_written_as_the_paper_writes_it(puma: tb.Tree) -> None:
    dynamic, reaction = (tb.minimal_set(puma, model, zeros=True) for model in ("torque", "wrench"))
    golden = (GOLDEN / "puma562.tex").read_text(encoding="utf-8")
    assert (
        printed(80, print_latex, IdentifiabilityReport(puma, dynamic, reaction, None), "symbols")
        == golden
    )


@pytest.mark.slow
def test_a_campaign_is_a_row_of_a_table_and_of_a_figure_for_each_cell() -> None:
    """With coverage and its interval; failures with the commands that make them again."""
    results = campaign()
    cells = summarise(results.rows)
    text = printed(200, print_campaign, results)
    assert text.count(results.failures[0]["error"]) == 1
    for each in cells:
        inside, low, high = (f"{100 * share:.1f}" for share in (each.coverage, *each.bounds))
        assert f"encoder = {each.levels['encoder']:g} " in text
        assert f" {100 * each.error:.3g} " in text
        assert f"{inside} {low} to {high}" in re.sub(" +", " ", text)
    figure = cells_figure(cells)
    assert len(figure.table.rows) == len(cells) == 4
    errors, coverage = figure.panels
    for panel, name in ((errors, "error"), (coverage, "coverage")):
        assert isinstance(panel, Panel)
        drawn, _ = panel.curves["wrench"]
        np.testing.assert_allclose(drawn, [100 * getattr(each, name) for each in cells])
