"""The pictures of the documentation show what the commands draw today: by digests of the data, not by pixels."""

from __future__ import annotations

from pathlib import Path

import pytest

from candaemon.can_io.logs.write import open_log_writer
from candaemon.files.outputs import OutputFile
from candaemon.playback.replay import ReplayRequest, replay
from candaemon.playback.summary import summarise
from tests.pictures.drawn import CONFIG, REPORT, SCENE, digest, kept, pictures, report, scene, simulated
from tests.project.pages import PAGES
from tests.support.bound import binding

ANEW = "the pictures are of other data; make them anew: python -m tests.pictures"


def test_the_scene_shows_what_is_tracked() -> None:
    assert kept()[SCENE] == digest(scene()), ANEW


@pytest.mark.slow
def test_the_report_shows_todays_figures(tmp_path: Path) -> None:
    channels = [bus.settings.log_channel or bus.settings.channel for bus in binding(CONFIG).buses]
    log = tmp_path / "drive.log"
    with OutputFile(log) as file, open_log_writer(file, channels) as writer:
        writer.write(list(simulated().frames()))
    figures = summarise(replay(binding(CONFIG), ReplayRequest(log)))
    assert kept()[REPORT] == digest(report(figures)), ANEW


def test_every_picture_is_there_and_shown() -> None:
    pages = "".join(page.text for page in PAGES.values())
    for path in pictures():
        assert path.stat().st_size > 10_000
        assert f"images/{path.name})" in pages
    assert kept().keys() == {path.name for path in pictures()}


def test_a_digest_changes_with_what_is_shown() -> None:
    shown = scene()
    moved = [(identity, state, x + 0.5, y) for identity, state, x, y in shown]
    assert shown
    assert digest(moved) != digest(shown)
