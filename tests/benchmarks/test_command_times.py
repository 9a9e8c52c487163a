"""The table of the commands."""

from __future__ import annotations

from pathlib import Path

import pytest

from .command_times import COMMANDS, START, cpu_seconds, ready_seconds, served_config, table


def test_the_table_divides_by_what_is_compared() -> None:
    times = {each.name: 100.0 * (k + 1) for k, each in enumerate(COMMANDS)}
    lines = list(table(times))
    assert [line.split("µs/cycle")[0].split()[-1] for line in lines] == [f"{time:g}" for time in times.values()]
    assert lines[2].endswith("0.3 x naive chain, CS-KF")
    assert lines[5].endswith("0.8 x replay -o, all defaults")


@pytest.mark.benchmark
def test_a_command_has_its_cpu_time_counted() -> None:
    assert 0.05 < cpu_seconds(START) < 60.0


@pytest.mark.benchmark
def test_a_service_says_when_it_is_ready(tmp_path: Path) -> None:
    cpu, waited = ready_seconds(served_config(tmp_path), tmp_path)
    assert 0.05 < cpu < 60.0
    assert waited > 0.05
