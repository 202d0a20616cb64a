"""What commands write to the terminal: progress, lines, tables, JSON, warnings. Quick to import."""

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
from testbed.core.base.diagnostics import Diagnostic, ordered, paragraphs
from testbed.core.base.errors import plural, printable, visible
from testbed.core.base.stages import stage, stages
from testbed.core.base.whole_files import write_whole

if TYPE_CHECKING:
    from testbed.view.section import Table

_SIGNS = {"+-": "±", "^2": "²", " %": "\u00a0%"}

_HEAD = re.compile(r'<h2 id="([^"]+)">(.*?)</h2>')

_WHOLE = re.compile(r"[-+]?\d[\d.]*e-\d+|--[a-z][a-z-]*")
"""A number, an option: a browser would break them at a sign."""


def write_page(path: Path, template: str, content: dict[str, Any]) -> None:
    """Write a page.

    Args:
        path: The HTML file; what stands there is replaced.
        template: One of those in page/.
        content: What it shows.
    """
    text = rendered(template, content)
    write_whole(path, text)


def rendered(template: str, content: dict[str, Any]) -> str:
    """A page.

    Args:
        template: One of those in page/.
        content: What it shows.
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
    heads = _HEAD.findall(text)
    links = " ".join(f'<a href="#{place}">{title}</a>' for place, title in heads)
    return text.replace("<nav></nav>", f'<nav aria-label="Contents">{links}</nav>')


def typeset(text: str) -> Markup:
    """What a terminal writes as +- and m^2 as people write it; numbers, options unbroken."""
    for plain, sign in _SIGNS.items():
        text = text.replace(plain, sign)
    return Markup(_WHOLE.sub(r'<span class="number">\g<0></span>', str(escape(text))))


def breakable(name: str) -> Markup:
    """A name that goes on in the next line, where it must, after an underscore or a slash."""
    return Markup(re.sub("([_/])", r"\1<wbr>", str(escape(name))))


BETWEEN = 10.0
"""Seconds at least between two lines where no bar can be shown."""

NAME = 12
"""Columns that are left to a row's name, at least, when it gives way."""


class Progress:
    """Progress on standard error: a bar on a terminal, else a line now and then.

    Of blocks in one another the inner one is shown.
    """

    _shown: ClassVar[list[Progress]] = []

    def __init__(self, label: str) -> None:
        """Nothing is done yet.

        Args:
            label: What is going on.
        """
        self._bar = Bar(  # what goes to standard output stays there
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            TimeRemainingColumn(),
            console=Console(stderr=True),
            transient=True,
            redirect_stdout=False,
            redirect_stderr=False,
            disable=not sys.stderr.isatty(),
        )
        self._task = self._bar.add_task(printable(label), total=None)
        self._label, self._written = label, time.monotonic()
        self.line = f"{label} ..."

    def __enter__(self) -> Self:
        if self._shown:
            self._shown[-1]._bar.stop()
        self._shown.append(self)
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()
        self._shown.remove(self)
        if self._shown:
            self._shown[-1]._bar.start()

    def __call__(self, done: int, total: int) -> None:
        """Show how much is done."""
        self.say(done, total, self._label)

    def say(self, done: int, total: int, label: str) -> None:
        """Show how much is done, and in other words what is going on."""
        much = f"{done / total:.0%}" if total else str(done or "")
        self._label = label
        self.line = f"{label}, {much} ..." if much else f"{label} ..."
        self._bar.update(
            self._task,
            completed=done,
            total=total or None,
            description=printable(label),
        )
        if self._bar.disable and time.monotonic() > self._written + BETWEEN:
            self._written = time.monotonic()
            with suppress(OSError, ValueError):  # nobody reads any more
                print(printable(self.line), file=sys.stderr, flush=True)


class PlainConsole(Console):
    """Console whose text, names out of files above all, no terminal obeys."""

    def print(self, *objects: Any, **options: Any) -> None:
        """Print as Rich does, control characters of texts spelled out."""
        texts = all(isinstance(each, str) for each in objects)
        shown = (visible(each) if isinstance(each, str) else each for each in objects)
        super().print(*shown, **{"soft_wrap": texts, **options})


def console() -> Console:
    """Standard output; 120 columns where it is no terminal and nobody says otherwise."""
    plain = PlainConsole(markup=False, highlight=False)
    if plain.is_terminal or "COLUMNS" in os.environ:
        return plain
    return PlainConsole(markup=False, highlight=False, width=120)


@contextmanager
def printed_stages() -> Iterator[None]:
    """The block's seconds by stage, and those in which the program started, on standard error."""
    started = time.process_time()
    with stages() as seconds, stage("anything else"):
        yield
    for name, spent in {"start of the program": started, **seconds}.items():
        print(f"{spent:8.3f} s  {name}", file=sys.stderr)


def print_json(value: dict[str, Any]) -> None:
    """Print for programs."""
    sys.stdout.write(json_text(value).decode() + "\n")


def print_result(
    tables: Iterable[Table] = (),
    lines: Iterable[str] = (),
    diagnostics: Iterable[Diagnostic] = (),
) -> None:
    """Print tables, then sentences, then what a careful reader should know.

    Args:
        tables: One after the other.
        lines: One each.
        diagnostics: In any order.
    """
    out = console()
    for table in tables:
        print_tables(out, [table])
    print_text(out, lines)
    print_diagnostics(out, diagnostics)


def print_text(out: Console, lines: Iterable[str]) -> None:
    """Print lines that a terminal wraps.

    Args:
        out: Where to.
        lines: One each.
    """
    for line in lines:
        out.print(line)


def print_diagnostics(
    out: Console, diagnostics: Iterable[Diagnostic], most: int | None = None
) -> None:
    """Print diagnostics in order: what was found, below it causes and remedy.

    Args:
        out: Where to.
        diagnostics: What a careful reader should know.
        most: How many are printed; more are counted. Default all.
    """
    every = ordered(diagnostics)
    said = [
        ("warning", each) for each in paragraphs(d for d in every if d.level != "info")
    ]
    said += [
        ("note", each) for each in paragraphs(d for d in every if d.level == "info")
    ]
    for kind, (text, *more) in said[:most]:
        style = "yellow" if kind == "warning" else None
        out.print(f"{kind}: {printable(text)}", style=style)
        for line in more:
            out.print(f"    {printable(line)}", style=style)
    if most is not None and len(said) > most:
        out.print(f"(--all prints {plural(len(said) - most, 'more warning')})")


def print_tables(out: Console, *layouts: Sequence[Table]) -> None:
    """Print the first of some layouts whose tables all fit; no number is ever cut off.

    Where none does, tables are split into their parts, and then names are folded, too.

    Args:
        out: Where to.
        layouts: From wide to narrow.
    """
    split = [part for table in layouts[-1] for part in table.split]
    free = out.options.update(max_width=10_000)
    for tables in (*layouts, split):
        made = [_drawn(table) for table in tables]
        if all(out.measure(each, options=free).maximum <= out.width for each in made):
            break
    else:
        made = [_drawn(table, out.width) for table in split]
    for each in made:
        out.print(each)


def _drawn(table: Table, width: int | None = None) -> RichTable:
    """Table wrapped to a width: first cells, then row names."""
    columns = list(
        zip(*([printable(cell) for cell in row] for row in table.rows), strict=True)
    )

    def least(head: str, cells: Sequence[str]) -> int:
        at = None if head in table.left else "\n"
        return max(
            (len(x) for cell in (head, *cells) for x in cell.split(at)), default=0
        )

    names, *taken = map(least, table.heads, columns) if columns else (0,)
    room = None if width is None else max(NAME, width - sum(taken) - 3 * len(taken) - 4)
    folded = room is not None and room < names
    grid = RichTable(
        title=printable(table.title) or None,
        title_justify="left",
        header_style="bold",
        box=SIMPLE_HEAD,
    )
    for k, head in enumerate(table.heads):
        words = k == 0 or head in table.left
        grid.add_column(
            visible(head),
            justify="left" if words else "right",
            style="dim" if head == "unit" else "",
            overflow="fold",
            no_wrap=not words or (k == 0 and not folded),
            max_width=room if k == 0 and folded else None,
        )
    for row in table.rows:
        grid.add_row(*map(printable, row))
    return grid
