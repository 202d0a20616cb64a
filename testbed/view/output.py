"""Terminal output and HTML pages: progress, tables, sentences, diagnostics, JSON, templates.

Slow modules are imported in functions: every command imports this module.
"""

from __future__ import annotations

import os
import re
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

import jinja2
from markupsafe import Markup, escape
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar
from rich.table import Table as RichTable

from testbed.core.base.codec import json_text
from testbed.core.base.diagnostics import (
    Diagnostic,
    diagnostic_paragraphs,
    ordered_diagnostics,
)
from testbed.core.base.errors import (
    count_with_noun,
    escape_control_characters,
    printable_line,
)
from testbed.core.base.stages import measure_stages, timed_stage
from testbed.core.base.whole_files import write_atomically

if TYPE_CHECKING:
    from testbed.view.section import Table

_TYPOGRAPHIC_SIGNS = {"+-": "±", "^2": "²", " %": "\u00a0%"}

_HEADING_PATTERN = re.compile(r'<h2 id="([^"]+)">(.*?)</h2>')

_UNBREAKABLE_PATTERN = re.compile(r"[-+]?\d[\d.]*e-\d+|--[a-z][a-z-]*")
"""Numbers with exponents, and options: browsers would break them at a hyphen."""


def write_page(path: Path, template: str, content: dict[str, Any]) -> None:
    """Write an HTML page from a template.

    Args:
        path: The HTML file; it is replaced if it exists, and unchanged after an error.
        template: Name of a template in the folder page/.
        content: Variables of the template.
    """
    text = render_page(template, content)
    write_atomically(path, text)


def render_page(template: str, content: dict[str, Any]) -> str:
    """Render the text of an HTML page from a template.

    The style sheet, and links to all headings that have an anchor, are inserted. A variable that is
    missing in `content` is an error.

    Args:
        template: Name of a template in the folder page/.
        content: Variables of the template.
    """
    from testbed.view.drawing import svg

    pages = files("testbed.view") / "page"
    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(lambda name: (pages / name).read_text("utf-8")),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "typeset": typeset,
        "breakable": breakable,
        "svg": lambda panel: Markup(svg(panel)),
    }
    style = (pages / "style.css").read_text("utf-8")
    text = environment.get_template(template).render(content, style=style)
    heads = _HEADING_PATTERN.findall(text)
    links = " ".join(f'<a href="#{place}">{title}</a>' for place, title in heads)
    return text.replace("<nav></nav>", f'<nav aria-label="Contents">{links}</nav>')


def typeset(text: str) -> Markup:
    """HTML text with ± for +-, ² for ^2, and escaped special characters.

    Line breaks are prevented before % signs, in numbers with exponents, and in command-line
    options.
    """
    for plain, sign in _TYPOGRAPHIC_SIGNS.items():
        text = text.replace(plain, sign)
    return Markup(
        _UNBREAKABLE_PATTERN.sub(
            r'<span class="number">\g<0></span>', str(escape(text))
        )
    )


def breakable(name: str) -> Markup:
    """HTML text of a name that can be broken after underscores and slashes."""
    return Markup(re.sub("([_/])", r"\1<wbr>", str(escape(name))))


MIN_LINE_INTERVAL = 10.0
"""Shortest time between two progress lines without a terminal [s]."""

MIN_NAME_WIDTH = 12
"""Smallest width of row names in a folded table [characters]."""


class Progress:
    """Progress display on standard error: a bar on a terminal, otherwise lines of text.

    Lines are printed at intervals of at least `MIN_LINE_INTERVAL` (10 s). In nested `with` blocks,
    only the innermost bar is displayed.
    """

    _open_bars: ClassVar[list[Progress]] = []

    def __init__(self, label: str) -> None:
        """Create a progress bar at zero.

        Args:
            label: Label of the current step.
        """
        self._bar = Bar(  # standard output is not redirected
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            TimeRemainingColumn(),
            console=Console(stderr=True),
            transient=True,
            redirect_stdout=False,
            redirect_stderr=False,
            disable=not sys.stderr.isatty(),
        )
        self._task = self._bar.add_task(printable_line(label), total=None)
        self._label, self._line_time = label, time.monotonic()
        self.line = f"{label} ..."

    def __enter__(self) -> Self:
        if self._open_bars:
            self._open_bars[-1]._bar.stop()
        self._open_bars.append(self)
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()
        self._open_bars.remove(self)
        if self._open_bars:
            self._open_bars[-1]._bar.start()

    def __call__(self, done: int, total: int) -> None:
        """Update the amount of completed work.

        Args:
            done: Completed amount.
            total: Total amount; 0 if unknown.
        """
        self.update_step(done, total, self._label)

    def update_step(self, done: int, total: int, label: str) -> None:
        """Update the amount of completed work and the label.

        Args:
            done: Completed amount.
            total: Total amount; 0 if unknown.
            label: Label of the current step.
        """
        amount = f"{done / total:.0%}" if total else str(done or "")
        self._label = label
        self.line = f"{label}, {amount} ..." if amount else f"{label} ..."
        self._bar.update(
            self._task,
            completed=done,
            total=total or None,
            description=printable_line(label),
        )
        if self._bar.disable and time.monotonic() > self._line_time + MIN_LINE_INTERVAL:
            self._line_time = time.monotonic()
            with suppress(OSError, ValueError):  # standard error is closed
                print(printable_line(self.line), file=sys.stderr, flush=True)


class PlainConsole(Console):
    """Rich console that prints control characters in texts as escape sequences."""

    def print(self, *objects: Any, **options: Any) -> None:
        """Print with Rich; control characters in texts become escape sequences.

        If all objects are strings, lines are not wrapped, unless `soft_wrap` is given.
        """
        only_texts = all(isinstance(each, str) for each in objects)
        escaped = (
            escape_control_characters(each) if isinstance(each, str) else each
            for each in objects
        )
        super().print(*escaped, **{"soft_wrap": only_texts, **options})


def console() -> Console:
    """Console for standard output.

    If standard output is not a terminal, the console is 120 columns wide, or as wide as the
    environment variable COLUMNS specifies.
    """
    default_console = PlainConsole(markup=False, highlight=False)
    if default_console.is_terminal or "COLUMNS" in os.environ:
        return default_console
    return PlainConsole(markup=False, highlight=False, width=120)


@contextmanager
def print_stage_times() -> Iterator[None]:
    """Context manager that prints the processor time of each stage on standard error.

    The first line is the time from the start of the program to the entry of the block.
    """
    start_time = time.process_time()
    with measure_stages() as seconds, timed_stage("anything else"):
        yield
    for name, duration in {"start of the program": start_time, **seconds}.items():
        print(f"{duration:8.3f} s  {name}", file=sys.stderr)


def print_json(value: dict[str, Any]) -> None:
    """Print a value as JSON on standard output."""
    sys.stdout.write(json_text(value).decode() + "\n")


def print_result(
    tables: Iterable[Table] = (),
    lines: Iterable[str] = (),
    diagnostics: Iterable[Diagnostic] = (),
) -> None:
    """Print tables, then lines, then diagnostics on standard output.

    Args:
        tables: Tables in the order of printing.
        lines: Lines in the order of printing.
        diagnostics: Diagnostics in any order.
    """
    out = console()
    for table in tables:
        print_tables(out, [table])
    print_lines(out, lines)
    print_diagnostics(out, diagnostics)


def print_lines(out: Console, lines: Iterable[str]) -> None:
    """Print lines without line breaks at the console's width.

    Args:
        out: Console of the output.
        lines: Lines in the order of printing.
    """
    for line in lines:
        out.print(line)


def print_diagnostics(
    out: Console, diagnostics: Iterable[Diagnostic], max_count: int | None = None
) -> None:
    """Print diagnostics, each with causes and remedy; warnings come before notes.

    Notes are diagnostics of level "info". With `max_count`, a last line has the number of omitted
    diagnostics.

    Args:
        out: Console of the output.
        diagnostics: Diagnostics in any order.
        max_count: Largest number of printed diagnostics; default all.
    """
    ordered = ordered_diagnostics(diagnostics)
    paragraphs = [
        ("warning", each)
        for each in diagnostic_paragraphs(d for d in ordered if d.level != "info")
    ]
    paragraphs += [
        ("note", each)
        for each in diagnostic_paragraphs(d for d in ordered if d.level == "info")
    ]
    for kind, (text, *details) in paragraphs[:max_count]:
        style = "yellow" if kind == "warning" else None
        out.print(f"{kind}: {printable_line(text)}", style=style)
        for line in details:
            out.print(f"    {printable_line(line)}", style=style)
    if max_count is not None and len(paragraphs) > max_count:
        out.print(
            f"(--all prints {count_with_noun(len(paragraphs) - max_count, 'more warning')})"
        )


def print_tables(out: Console, *layouts: Sequence[Table]) -> None:
    """Print the first layout in which all tables fit the width of the console.

    If no layout fits, the tables of the last layout are split into their groups of columns. If
    these do not fit either, row names are folded. Numbers are never truncated.

    Args:
        out: Console of the output.
        *layouts: Layouts of the same content, from wide to narrow.
    """
    split = [part for table in layouts[-1] for part in table.split]
    unlimited_width = out.options.update(max_width=10_000)
    for tables in (*layouts, split):
        grids = [_rich_table(table) for table in tables]
        if all(
            out.measure(grid, options=unlimited_width).maximum <= out.width
            for grid in grids
        ):
            break
    else:
        grids = [_rich_table(table, out.width) for table in split]
    for grid in grids:
        out.print(grid)


def _rich_table(table: Table, width: int | None = None) -> RichTable:
    """Convert a table to a table of the library Rich.

    Row names are folded to fit the given width. Columns of numbers keep their width; row names are
    given the remaining width, at least `MIN_NAME_WIDTH`.

    Args:
        table: The table.
        width: Desired width [characters]; None for unlimited width.
    """
    columns = list(
        zip(
            *([printable_line(cell) for cell in row] for row in table.rows), strict=True
        )
    )

    def min_width(head: str, cells: Sequence[str]) -> int:
        separator = None if head in table.left else "\n"
        return max(
            (len(x) for cell in (head, *cells) for x in cell.split(separator)),
            default=0,
        )

    names, *widths = map(min_width, table.heads, columns) if columns else (0,)
    name_width = (
        None
        if width is None
        else max(MIN_NAME_WIDTH, width - sum(widths) - 3 * len(widths) - 4)
    )
    is_folded = name_width is not None and name_width < names
    grid = RichTable(
        title=printable_line(table.title) or None,
        title_justify="left",
        header_style="bold",
        box=SIMPLE_HEAD,
    )
    for k, head in enumerate(table.heads):
        is_text = k == 0 or head in table.left
        grid.add_column(
            escape_control_characters(head),
            justify="left" if is_text else "right",
            style="dim" if head == "unit" else "",
            overflow="fold",
            no_wrap=not is_text or (k == 0 and not is_folded),
            max_width=name_width if k == 0 and is_folded else None,
        )
    for row in table.rows:
        grid.add_row(*map(printable_line, row))
    return grid
