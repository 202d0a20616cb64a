"""What is said and drawn of campaigns of made-up outcomes, failures among them, as approved."""

from __future__ import annotations

from pathlib import Path

import pytest

from testbed.campaign import run_identity
from testbed.campaign.bundle import Bundle, Outcome
from testbed.campaign.campaign import Campaign
from testbed.campaign.campaign_folder import CampaignFolder
from testbed.campaign.campaign_summary import read_campaign, summarise
from testbed.campaign.conduct import conduct
from testbed.campaign.summary_files import changes, write_summary
from testbed.reporting.campaign_lines import (
    print_changes,
    print_conducted,
    print_plan,
    print_summary,
)
from testbed.reporting.campaign_page import write_campaign_page
from testbed.reporting.output import console
from tests.helpers.approved import hold, tags, timeless
from tests.helpers.campaigns import NOISES, Odd, campaign_file, made_up
from tests.helpers.paths import ROOT

pytestmark = pytest.mark.slow

FACTORS = {
    "one": NOISES,
    "grid": NOISES
    + '[[factor]]\nname = "encoder"\nset = ["measurement.encoder_noise=$"]\n'
    + "values = [1e-5, 1e-4]\n",
    "named": NOISES
    + '[[factor]]\nname = "cutoff"\nset = ["identification.cutoff=$"]\nvalues = ["fit", 8.0]\n',
    "many": '[[factor]]\nname = "force noise"\nset = ["measurement.force_noise=$"]\n'
    f"values = {[k / 10 for k in range(1, 25)]}\n",
}


def with_failures(bundle: Bundle) -> tuple[list[Outcome], float]:
    """Every run whose hash ends in a zero fails."""
    outcomes, seconds = made_up(bundle)
    return [
        Outcome(each.run, "failed", "it cannot be done") if each.run.endswith("0") else each
        for each in outcomes
    ], seconds


def told(text: str, place: Path) -> str:
    return timeless(text.replace(str(place), "").replace(str(ROOT), ""))


@pytest.mark.parametrize("name", FACTORS)
def test_a_campaign_is_told_and_drawn_as_approved(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setattr(run_identity, "code_version", lambda: "of no matter here")
    campaign = Campaign.load(campaign_file(tmp_path, 12, FACTORS[name]))
    folder: CampaignFolder = conduct(campaign, tmp_path / "r", Odd(with_failures))
    summary = summarise(read_campaign(tmp_path / "r"))
    out = console()
    print_plan(out, campaign, tmp_path / "r", 7)
    failed = print_conducted(out, folder)
    print_summary(out, summary, write_summary(summary, tmp_path / "r"))
    print_changes(out, list(changes(summary, summary)))
    print_changes(out, [])
    text = "\n".join(capsys.readouterr())
    hold(f"campaign_{name}.txt", f"{told(text, tmp_path)}{failed} failed\n")
    write_campaign_page(tmp_path / "page.html", summary)
    page = tags((tmp_path / "page.html").read_text())
    hold(f"campaign_{name}.html.txt", told(page, tmp_path))
