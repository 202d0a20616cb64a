"""What programs read of the site: `llms.txt`, a list of all pages, and schemas of results."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any


def write_for_programs(pages: Path, site: Path, config: Path) -> None:
    """Write `llms.txt` and `schemas/` beside the pages.

    Args:
        pages: Folder of their Markdown.
        site: Folder of the site.
        config: Of Zensical.
    """
    project = tomllib.loads(config.read_text())["project"]
    lines = [f"# {project['site_name']}", "", f"> {project['site_description']}"]
    for tab in project["nav"]:
        for title, entries in tab.items():
            lines += ["", f"## {title}", "", *_entries(entries, pages)]
    (site / "llms.txt").write_text("\n".join([*lines, ""]))
    folder = site / "schemas"
    folder.mkdir(exist_ok=True)
    for name, schema in schemas():
        (folder / f"{name}.json").write_text(json.dumps(schema, indent=1) + "\n")


def _entries(entries: list[str | dict[str, str]], pages: Path) -> Iterator[str]:
    """A line each: the page's title, its Markdown and its first sentence."""
    for entry in entries:
        file = entry if isinstance(entry, str) else next(iter(entry.values()))
        text = re.sub(r"<!--.*?-->\n?", "", (pages / file).read_text(), flags=re.DOTALL)
        head, _, rest = text.partition("\n\n")
        sentence = re.split(r"(?<=\.)\s", " ".join(rest.split()), maxsplit=1)[0]
        yield f"- [{head.lstrip('# ')}]({Path(file).with_suffix('.html')}): {sentence}"


def schemas() -> Iterator[tuple[str, Any]]:
    """JSON schemas of what commands print with `--json`, by the command's name."""
    from testbed.applications.calibration import Calibration
    from testbed.applications.drives.identify_drives import DriveIdentification
    from testbed.applications.payload.payload import PayloadEstimate
    from testbed.applications.validate import Validation
    from testbed.core.base.codec import type_adapter
    from testbed.lab.experiment.results import Result

    results: dict[str, type] = {
        "run": Result,
        "identify": Result,
        "calibrate": Calibration,
        "drives": DriveIdentification,
        "payload": PayloadEstimate,
        "validate": dict[str, Validation],
    }
    for name, result in results.items():
        schema = type_adapter(result).json_schema()
        if estimate := schema.get("$defs", {}).get("Estimate"):  # sums of products are not printed
            del estimate["properties"]["normal_equations"]
            estimate["required"].remove("normal_equations")
        yield name, schema
