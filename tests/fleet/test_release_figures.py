"""The project's own gate: the recorded drive and scenarios are not worse than at the last release."""

from __future__ import annotations

from pathlib import Path

import pytest

from candaemon.fleet.fleet_figures import load_figures
from tests.release_figures import FIGURES, RECORDED, SCENARIOS, compared


def test_the_last_release_has_figures_of_all_drives() -> None:
    drives = load_figures(str(FIGURES)).drives
    assert set(drives) == {*SCENARIOS, *(name.partition(".")[0] for name in RECORDED)}
    assert all(any(key.startswith("predictions.") for key in each.values) for each in drives.values())


@pytest.mark.slow
def test_no_drive_is_worse_than_at_the_last_release(tmp_path: Path) -> None:
    found = compared(tmp_path)
    assert len(found.figures) > 5
    assert not found.worse_drives, "python -m tests.release_figures says how; --renew takes it as the new level"
    assert not found.missing
