"""What the wizard looks at ends somewhere, whatever it is given."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from candaemon.dbc.types import MessageSpec, SignalSpec
from candaemon.errors import ConfigError
from candaemon.wizard.draft_text import LONGEST_WHY, Lines
from candaemon.wizard.families import LONGEST_READ, MOST_NUMBERS, MOST_SLOTS, find_families
from candaemon.wizard.layouts import MOST_LAYOUTS, MOST_LISTED, MOST_TRIED, find_layouts
from candaemon.wizard.linking import MOST_LINKED_SCANS, linked
from candaemon.wizard.proposal import MOST_FILES, propose
from candaemon.wizard.traffic import read_traffic

PLACE = (SignalSpec("RANGE", 0, 14), SignalSpec("AZIMUTH", 14, 12))


def family(count: int, name: str = "OBJ_", first: int = 0, shift: int = 0) -> list[MessageSpec]:
    """Return messages with a position that are laid out alike."""
    signals = tuple(replace(each, start=each.start + shift) for each in PLACE)
    return [MessageSpec(f"{name}{k}", 0x1000 * shift + first + k, 8, signals) for k in range(count)]


def test_so_many_files_are_read_together(tmp_path: Path) -> None:
    paths = [tmp_path / f"{k}.dbc" for k in range(MOST_FILES + 1)]
    for path in paths:
        path.write_text('VERSION ""\nBU_:\nBO_ 1 DOOR: 8 X\n SG_ OPEN : 0|1@1+ (1,0) [0|1] "" X\n', encoding="utf-8")
    with pytest.raises(ConfigError, match="no radar found"):
        propose(paths[:-1], None)
    with pytest.raises(ConfigError, match=f"found {MOST_FILES + 1} DBC files"):
        propose(paths, None)


def test_so_many_frames_of_a_log_are_looked_at(tmp_path: Path) -> None:
    log = tmp_path / "long.log"
    lines = [f"({k * 1e-4:.6f}) can0 123#00\n" for k in range(70_000)]
    log.write_text("".join(lines), encoding="utf-8")
    whole, cut = read_traffic([log]), read_traffic([log], most=10)
    assert len(whole.streams[0, 0x123].time) == len(lines)
    assert 10 <= len(cut.streams[0, 0x123].time) < len(lines)  # the block that reaches the limit is its last


def test_a_family_has_so_many_messages() -> None:
    (found,) = find_families(family(MOST_SLOTS))
    assert found.slots == MOST_SLOTS
    assert max(each.slots for each in find_families(family(MOST_SLOTS + 1))) < MOST_SLOTS


def test_numbers_are_looked_for_so_far_into_a_name() -> None:
    assert len(find_families(family(9, "x" * (LONGEST_READ - 1)))) == 1
    assert find_families(family(9, "x" * LONGEST_READ)) == []


def test_so_many_numbers_of_a_name_may_be_the_slots() -> None:
    assert len(find_families(family(9, "1_" * (MOST_NUMBERS - 1)))) == 1
    assert find_families(family(9, "1_" * MOST_NUMBERS)) == []


def test_so_many_families_and_layouts_are_looked_at() -> None:
    messages = [each for k in range(MOST_TRIED + 1) for each in family(3, f"FAMILY{chr(65 + k)}_", shift=k)]
    assert len(find_families(messages)) == MOST_TRIED + 1
    assert len(find_layouts(messages[: 3 * MOST_LAYOUTS])) == MOST_LAYOUTS
    assert len(find_layouts(messages)) == MOST_LAYOUTS


def test_so_many_messages_are_looked_at_as_lists() -> None:
    plain = [MessageSpec(f"M{chr(97 + k % 26)}{chr(97 + k // 26)}", k, 8, ()) for k in range(MOST_LISTED)]
    of_list = MessageSpec("LIST", 5000, 8, (*PLACE, SignalSpec("OBJ_ID", 40, 6)))
    assert len(find_layouts([*plain[:-1], of_list])) == 1
    assert find_layouts([*plain, of_list]) == []


def test_evidence_is_cut() -> None:
    lines = Lines()
    lines.add(0, "a: 1", "x" * LONGEST_WHY)
    lines.add(0, "b: 2", "x" * (LONGEST_WHY + 1))
    whole, cut = lines.text().splitlines()
    assert whole.count("x") == LONGEST_WHY
    assert whole.endswith("x")
    assert cut.count("x") == LONGEST_WHY
    assert not cut.endswith("x")


def test_so_many_scans_are_linked() -> None:
    def scans(count: int) -> int:
        time = np.linspace(0.0, 0.05 * (count - 1), count)
        still = np.full(count, 20.0)
        found = linked(np.arange(count), time, still, still * 0 + np.linspace(0, 1, count), still * 0, 0.05)
        assert found is not None
        return len(found.rows)

    assert scans(MOST_LINKED_SCANS) == MOST_LINKED_SCANS
    assert scans(MOST_LINKED_SCANS + 1) == MOST_LINKED_SCANS


def test_a_channel_is_of_can_fd_where_such_a_frame_came_and_no_other(tmp_path: Path) -> None:
    log = tmp_path / "drive.log"
    log.write_text("(1.0) can0 100##0112233\n(1.1) can0 101#00\n(1.2) can1 100#112233\n(1.3) can0 100#00\n")
    streams = read_traffic([log]).streams
    assert {at: stream.fd for at, stream in streams.items()} == {(0, 0x100): True, (0, 0x101): False, (1, 0x100): False}
