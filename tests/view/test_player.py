"""Playing: pause, speed, seek, the newest, and what a slow browser misses."""

from __future__ import annotations

import numpy as np
import pytest

from candaemon.view.picture_store import PictureStore
from candaemon.view.player import FASTEST_PLAY, HISTORY_S, MOST_HISTORY, MOST_PICTURES, SLOWEST_PLAY, Due, Player

RATE = 20


def drive(seconds: float = 60.0, *, complete: bool = True, rate: int = RATE) -> PictureStore:
    """Return a drive whose pictures are their numbers."""
    store = PictureStore()
    for k in range(round(seconds * rate)):
        store.append(k / rate, str(k).encode())
    if complete:
        store.complete()
    return store


def numbers(due: Due | None) -> list[int]:
    assert due is not None
    return [int(each) for each in due.pictures]


def test_it_plays_as_time_passes() -> None:
    player = Player(drive(), follows=False)
    assert numbers(player.due(100.0)) == [0]
    assert numbers(player.due(101.0)) == list(range(1, 21))
    assert player.due(101.0) is None
    player.set_speed(0.5)
    assert numbers(player.due(103.0)) == list(range(21, 41))


def test_a_pause_stops_time_and_a_step_moves_it() -> None:
    player = Player(drive(), follows=False)
    player.due(0.0)
    player.due(1.0)
    player.pause()
    assert player.due(50.0) is None
    player.step(1)
    due = player.due(50.0)
    assert due is not None
    assert numbers(due)[-1] == 21
    player.step(-2)
    assert numbers(player.due(50.0))[-1] == 19
    player.play()
    assert numbers(player.due(51.0)) == list(range(20, 40))


def test_a_step_goes_through_pictures_of_one_time() -> None:
    store = PictureStore()
    for number, time_s in enumerate((1.0, 2.0, 1.9, 3.0)):  # a scan measured earlier than the one before
        store.append(time_s, str(number).encode())
    store.complete()
    player = Player(store, follows=False)
    player.seek(3.0)
    seen = [numbers(player.due(0.0))[-1]]
    for pictures in (-1, -1, -1, -1, 1, 1, 1, 1):
        player.step(pictures)
        seen.append(numbers(player.due(0.0))[-1])
    assert seen == [3, 2, 1, 0, 0, 1, 2, 3, 3]


def test_a_gap_shows_what_was_last_and_is_passed_over() -> None:
    store = PictureStore()
    for number, time_s in enumerate((1.0, 2.0, 3602.0, 3602.5)):
        store.append(time_s, str(number).encode())
    store.complete()
    player = Player(store, follows=False)
    player.pause()
    player.seek(1800.0)
    due = player.due(0.0)
    assert (numbers(due), due and due.at_s) == ([1], 1800.0)
    player.play()
    due = player.due(0.1)
    assert due is not None
    assert (numbers(due), due.at_s, due.afresh) == ([2], 3602.0, True)
    assert numbers(player.due(0.6)) == [3]


def test_a_seek_brings_what_led_there() -> None:
    player = Player(drive(), follows=False)
    player.due(0.0)
    player.seek(40.0)
    due = player.due(0.0)
    assert due is not None
    assert due.afresh
    assert due.at_s == 40.0
    assert numbers(due)[-1] == 40 * RATE
    assert numbers(due)[0] == round((40 - HISTORY_S) * RATE) + 1
    player.seek(1e9)
    assert numbers(player.due(0.0))[-1] == 60 * RATE - 1
    player.seek(-5.0)
    assert numbers(player.due(0.0)) == [0]


def test_it_ends_and_begins_again() -> None:
    player = Player(drive(1.0), follows=False)
    player.due(0.0)
    player.due(5.0)
    assert not player.playing
    player.play()
    due = player.due(5.0)
    assert due is not None
    assert due.afresh
    assert numbers(due) == [0]


def test_it_waits_for_what_is_not_there_yet() -> None:
    store = drive(1.0, complete=False)
    player = Player(store, follows=False)
    player.due(0.0)
    player.due(30.0)
    assert player.playing
    store.append(1.0, b"20")
    assert numbers(player.due(30.1)) == [20]


def test_the_newest_is_followed_until_a_pause() -> None:
    store = drive(1.0, complete=False)
    player = Player(store, follows=True)
    assert numbers(player.due(0.0))[-1] == 19
    store.append(1.0, b"20")
    assert numbers(player.due(0.0)) == [20]
    player.pause()
    store.append(1.05, b"21")
    assert player.due(1.0) is None
    player.follow()
    assert numbers(player.due(1.0))[-1] == 21


def test_what_a_slow_browser_misses_is_counted() -> None:
    player = Player(drive(), follows=False)
    player.due(0.0)
    exact = player.due(MOST_PICTURES / RATE)
    assert exact is not None
    assert (len(exact.pictures), exact.dropped) == (MOST_PICTURES, 0)
    over = player.due((2 * MOST_PICTURES + 1) / RATE)
    assert over is not None
    assert (len(over.pictures), over.dropped, player.dropped) == (MOST_PICTURES, 1, 1)
    assert numbers(over)[-1] == 2 * MOST_PICTURES + 1


def test_a_seek_brings_so_many_pictures_and_no_more() -> None:
    rate = round(MOST_HISTORY / HISTORY_S) * 2
    player = Player(drive(HISTORY_S + 1, rate=rate), follows=False)
    player.seek(HISTORY_S)
    due = player.due(0.0)
    assert due is not None
    assert len(due.pictures) == MOST_HISTORY
    found, half = numbers(due), MOST_HISTORY // 2
    assert found[0] == 1  # the plots reach back as far, whatever the rate
    assert 3 <= np.diff(found[: half + 1]).min() <= np.diff(found[: half + 1]).max() <= 4
    assert found[half:] == list(range(found[-1] - half + 1, found[-1] + 1))
    player = Player(drive(MOST_HISTORY / rate, rate=rate), follows=False)
    player.seek(HISTORY_S)
    due = player.due(0.0)
    assert due is not None
    assert len(due.pictures) == MOST_HISTORY


@pytest.mark.parametrize(
    ("asked", "given"), [(1e9, FASTEST_PLAY), (0.0, SLOWEST_PLAY), (-1.0, SLOWEST_PLAY), (2.0, 2.0)]
)
def test_speed_has_limits(asked: float, given: float) -> None:
    player = Player(drive(1.0), follows=False)
    player.set_speed(asked)
    assert player.speed == given


def test_what_was_forgotten_meanwhile_is_not_played() -> None:
    store = PictureStore(8 * 40, forgets=True)
    for k in range(8):
        store.append(float(k), f"{k:010d}".encode())
    player = Player(store, follows=True)
    player.due(0.0)
    player.pause()
    player.seek(0.0)
    for k in range(8, 60):
        store.append(float(k), f"{k:010d}".encode())
    due = player.due(0.0)
    assert due is not None
    assert due.at_s == store.extent().first_s
