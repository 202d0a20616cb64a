"""A campaign as Rerun's viewer takes it: scores, sigma predicted and obtained, what it says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rerun as rr

from testbed.campaign.summary import Summary
from testbed.files import replacing
from testbed.reporting.section import Table

BINS = np.linspace(-4.0, 4.0, 33)
"""Of errors in sigmas; what is beyond counts in the outermost ones."""

COLOURS = {"external": (0, 114, 178), "internal": (199, 80, 0)}


def write_campaign_rrd(summary: Summary, path: Path) -> None:
    """Write a campaign as a Rerun recording.

    Args:
        summary: What it says.
        path: The .rrd file; appears whole or not at all.
    """
    with replacing(path) as fresh:
        stream = rr.RecordingStream("testbed", recording_id=path.stem, send_properties=False)
        stream.save(fresh)
        for method, scores in summary.z.items():
            for name, values in scores.items():
                counts = np.histogram(np.clip(values, BINS[0], BINS[-1]), BINS)[0]
                middle = (BINS[1:] + BINS[:-1]) / 2
                bars = rr.BarChart(counts, color=COLOURS[method], abscissa=middle)
                place = rr.escape_entity_path_part(name)
                stream.log(f"scores/{method}/{place}", bars, static=True)
        _log_sigma(stream, summary)
        notes = rr.TextDocument(_notes(summary), media_type=rr.MediaType.MARKDOWN)
        stream.log("notes", notes, static=True)
        stream.flush()
        stream.disconnect()


def _log_sigma(stream: rr.RecordingStream, summary: Summary) -> None:
    """A point a parameter and cell: powers of ten of the predicted and the obtained sigma."""
    for method, colour in COLOURS.items():
        own = [p for p in summary.parameters if p.method == method and p.spread > 0 and p.sigma > 0]
        if own:
            points = np.log10([[p.sigma, p.spread] for p in own])
            points[:, 1] *= -1  # the viewer's second axis points down
            labels = [f"{p.parameter}, cell {p.cell}" for p in own]
            shown = rr.Points2D(points, colors=colour, radii=0.03, labels=labels, show_labels=False)
            stream.log(f"sigma/{method}", shown, static=True)


def _notes(summary: Summary) -> str:
    """Means of all figures, cell by cell, as a table."""
    rows = [
        [*map(str, summary.cells[f.cell]), f.metric, str(f.runs), f"{f.mean:.3g}"]
        for f in summary.figures
    ]
    table = Table([*summary.factors, "figure", "runs", "mean"], rows)
    about = summary.about
    return f"# {about.get('name', 'campaign')}\n{about.get('claim', '')}\n\n{table.markdown}"
