"""A report one can send: one HTML file with everything in it, and its numbers as JSON."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup, escape

from testbed.experiment.run import Run
from testbed.experiment.run_folder import read_run
from testbed.files import replacing
from testbed.recordings.recording import Recording
from testbed.reporting.bodies_section import Drawing
from testbed.reporting.contents import contents
from testbed.reporting.figures import Panel

_SIGNS = {"+-": "±", "^2": "²", " %": "\u00a0%"}

_HEAD = re.compile(r'<h2 id="([^"]+)">(.*?)</h2>')

_WHOLE = re.compile(r"[-+]?\d[\d.]*e-\d+|--[a-z][a-z-]*")
"""A number, an option: a browser would break them at a sign."""


def write_report(run: Run, path: Path) -> Path:
    """Write a report, and its numbers beside it.

    Args:
        run: What it is about.
        path: The HTML file.

    Returns:
        The JSON file: of the same name, ending in .json.
    """
    content = contents(run)
    text = rendered("report.html", content)
    beside = path.with_suffix(".json")
    with replacing(path) as fresh, replacing(beside) as numbers:
        fresh.write_text(text, encoding="utf-8")
        numbers.write_text(
            json.dumps(_without_drawings(content), indent=1, sort_keys=True) + "\n", "utf-8"
        )
    return beside


def report(run: Run | str | Path, path: str | Path, unseen: Recording | None = None) -> Path:
    """Write a report: one HTML file that needs nothing else, and its numbers as JSON beside it.

    Args:
        run: A run, or the folder of one.
        path: The HTML file.
        unseen: Another recording of the robot, on which predictions are shown; default that of the
            run's validation, else the run's own.

    Returns:
        The HTML file.

    Raises:
        ExperimentError: The folder holds no run.
        OSError: The file cannot be written there.
    """
    page = Path(path)
    what = run if isinstance(run, Run) else read_run(Path(run))
    write_report(what if unseen is None else replace(what, unseen=unseen), page)
    return page


def rendered(template: str, content: dict[str, Any]) -> str:
    """A page.

    Args:
        template: One of those in page/.
        content: What it shows.
    """
    pages = files("testbed.reporting") / "page"
    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(lambda name: (pages / name).read_text("utf-8")),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"typeset": typeset, "breakable": breakable, "drawing": Markup}
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


def _without_drawings(content: Any) -> Any:
    """The page's data alone."""
    if isinstance(content, dict):
        return {key: _without_drawings(value) for key, value in content.items() if key != "svg"}
    if isinstance(content, Panel | Drawing):
        return {"title": content.title}
    if isinstance(content, list | tuple):
        return [_without_drawings(value) for value in content]
    return content
