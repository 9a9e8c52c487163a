"""What `check` says of a tracker's life cycle."""

from __future__ import annotations

from pathlib import Path

import pytest

from candaemon.binding.bind import bind
from candaemon.cli.check import check_report
from candaemon.config.load import load_config
from tests.support.paths import ROOT

EXISTENCE = ("by existence above 0.95, 3 detections in succession at least", "1 s in sight, 4 s hidden")


@pytest.mark.parametrize(
    ("tracker", "confirmed", "coasts"),
    [
        ("", *EXISTENCE),
        ("tracker: {lifecycle: {confirm: 4}}", EXISTENCE[0].replace("3", "4"), EXISTENCE[1]),
        ("tracker: {lifecycle: {by: hits}}", "by 5 of 8 scans", "1 s"),
        ("tracker: {estimator: {kind: cs}}", "by 5 of 8 scans", "1 s"),
    ],
    ids=["existence", "four detections", "hits", "points"],
)
def test_a_tracker_is_told_by_the_rule_that_holds(tracker: str, confirmed: str, coasts: str, tmp_path: Path) -> None:
    text = (ROOT / "config" / "esr_ins.yaml").read_text(encoding="utf-8").replace("../dbc", str(ROOT / "dbc"))
    assert "\ntracker:" not in text
    config = tmp_path / "radar.yaml"
    config.write_text(f"{text}\n{tracker}\n", encoding="utf-8")
    sheet = next(sheet for sheet in check_report(bind(load_config(config))) if sheet.title == "tracker")
    told = {row[0]: row[1] for row in sheet.rows}
    assert told["confirmed"] == confirmed
    assert told["coasts"].startswith(coasts)
    assert ("existence" in told["coasts"]) == ("existence" in confirmed)
