"""Tables of instruments.md made anew, from the faults themselves: `python -m docs.instruments`."""

from __future__ import annotations

from pathlib import Path

from testbed.instruments.faults import as_markdown

DOCUMENT = Path(__file__).with_suffix(".md")
BEGIN = "<!-- written by python -m docs.instruments -->\n"
END = "<!-- end of what is written -->\n"


def between_marks(document: Path, begin: str, written: str) -> None:
    """Replace what stands between the marks of a document.

    Args:
        document: The file.
        begin: The mark before.
        written: What is to stand there.
    """
    text = document.read_text()
    before, _, rest = text.partition(begin)
    document.write_text(before + begin + written + END + rest.partition(END)[2])


if __name__ == "__main__":
    between_marks(DOCUMENT, BEGIN, as_markdown())
