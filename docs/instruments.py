"""Tables of instruments.md made anew, from the faults themselves: `python -m docs.instruments`."""

from __future__ import annotations

from pathlib import Path

from testbed.instruments.catalogue import as_markdown

DOCUMENT = Path(__file__).with_suffix(".md")
BEGIN = "<!-- written by python -m docs.instruments -->\n"
END = "<!-- end of what is written -->\n"


def main() -> None:
    """Replace what stands between the marks."""
    text = DOCUMENT.read_text()
    before, _, rest = text.partition(BEGIN)
    DOCUMENT.write_text(before + BEGIN + as_markdown() + END + rest.partition(END)[2])


if __name__ == "__main__":
    main()
