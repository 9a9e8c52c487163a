"""Predictions are placed as each cycle finds the ego motion, whenever they are written and scored."""

from __future__ import annotations

from pathlib import Path

from candaemon.playback.replay import ReplayRequest, replay
from tests.benchmarks.chains import full_binding, simulated_log

SILENT = range(2, 5)
"""s of the drive without an INS: longer than predictions wait for it."""


def test_a_paced_replay_over_a_gap_of_ego_motion_gives_the_same(tmp_path: Path) -> None:
    whole = simulated_log(tmp_path / "whole.log", 8.0).read_text().splitlines(keepends=True)
    first = float(whole[0][1:].split(")")[0])
    log = tmp_path / "gap.log"
    log.write_text(
        "".join(
            line for line in whole if " can2 " not in line or int(float(line[1:].split(")")[0]) - first) not in SILENT
        )
    )
    tables, scores = [], []
    for speed in (None, 1000.0):
        table = tmp_path / f"{speed}.csv"
        replayed = replay(full_binding(), ReplayRequest(log, predictions=table, speed=speed))
        tables.append(table.read_bytes())
        scores.append(replayed.score.predictions.result())
    assert tables[0] == tables[1]
    assert scores[0] == scores[1]
    assert scores[0][0].samples > 1000
