"""The documentation as a site that opens from disk: `python -m docs.site [FOLDER]`.

Pages are plain Markdown and their links lead to files of the project, so that they read as
well where they lie. The reference of commands, keys, diagnostics and Python is written
from the code first. Then all are gathered: those of docs/, the README as the first page, and
whatever else of the project they refer to; Zensical builds them, strictly, as zensical.toml states.
The site is in FOLDER/build/site, by default of the project's own folder.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

from docs import api, commands, keys, messages
from docs.machines import write_for_programs
from docs.marks import write

ROOT = Path(__file__).parent.parent
HOME = ROOT / "README.md"
PAGES = Path("build/pages")
SITE = Path("build/site")
REFERENCE = (api, commands, keys, messages)
"""Pages that are written from the code and not committed."""
ASSETS = ("style.css", "iframe-worker.js", "keyboard.js")

LINK = re.compile(r'(\]\(|(?:src|href|srcset)=")([^)"#\s]+)(#[^)"\s]*)?')
"""How a page refers to another file: `](target#part`, `src="target`."""
FENCED = re.compile(r"(^```.*?^```$)", re.MULTILINE | re.DOTALL)


def main(folder: Path = ROOT) -> Path:
    """Gather the pages and build them.

    Args:
        folder: Where `build/` is made.

    Returns:
        The site's first page.
    """
    for page in REFERENCE:
        write(page.DOCUMENT, page.MODULE, page.as_markdown, page.TEMPLATE)
    gather(folder / PAGES)
    config = folder / "zensical.toml"
    if folder != ROOT:
        shutil.copyfile(ROOT / "zensical.toml", config)
    command = [sys.executable, "-m", "zensical", "build", "--clean", "--strict", "-f", str(config)]
    paths = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    subprocess.run(command, cwd=folder, env=os.environ | {"PYTHONPATH": paths}, check=True)
    write_for_programs(folder / PAGES, folder / SITE, config)
    return folder / SITE / "index.html"


def gather(pages: Path) -> None:
    """Copy all pages and what they refer to, links set right.

    Args:
        pages: Folder that is made anew.
    """
    shutil.rmtree(pages, ignore_errors=True)
    waiting = [HOME, *sorted((ROOT / "docs").glob("*.md"))]
    waiting += [ROOT / "docs/assets" / name for name in ASSETS]
    for path in waiting:  # grows
        place = pages / place_of(path)
        place.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix != ".md":
            shutil.copyfile(path, place)
            continue
        text = path.read_text()
        place.write_text(relinked(text, path))
        waiting += [found for found in files_of(text, path) if found not in waiting]


def files_of(text: str, page: Path) -> list[Path]:
    """Files of the project that a page refers to.

    Args:
        text: The page's.
        page: Where it lies.
    """
    prose = FENCED.sub("", text)
    targets = [page.parent / m[2] for m in LINK.finditer(prose) if "://" not in m[2]]
    return list(dict.fromkeys(p.resolve() for p in targets if p.is_file()))


def place_of(path: Path) -> Path:
    """Where a file of the project lies among the pages.

    Args:
        path: Of the project.
    """
    if path == HOME:
        return Path("index.md")
    inside = path.relative_to(ROOT)
    if inside.parts[0] == "docs":
        return inside.relative_to("docs")
    if path.suffix == ".md":
        return Path("-".join(inside.parts).lower())
    return Path("files") / inside


def relinked(text: str, page: Path) -> str:
    """A page whose links lead to where files lie among the pages.

    Args:
        text: The page's.
        page: Where it lies in the project.
    """
    here = place_of(page).parent

    def led(match: re.Match[str]) -> str:
        target = (page.parent / match[2]).resolve()
        if "://" in match[2] or not target.is_file():
            return match[0]
        return match[1] + os.path.relpath(place_of(target), here) + (match[3] or "")

    parts = FENCED.split(text)
    parts[::2] = [LINK.sub(led, unlinked_folders(part, page)) for part in parts[::2]]
    return "".join(parts)


def unlinked_folders(text: str, page: Path) -> str:
    """Links to folders of the project, which a site has not, as words.

    Args:
        text: The page's.
        page: Where it lies.
    """

    def words(match: re.Match[str]) -> str:
        return match[1] if (page.parent / match[2]).is_dir() else match[0]

    return re.sub(r"(?<!!)\[([^\]]+)\]\(([^)#\s]+)\)", words, text)


if __name__ == "__main__":
    where = Path(sys.argv[1]).resolve() if len(sys.argv) > 1 else ROOT
    print(main(where))
