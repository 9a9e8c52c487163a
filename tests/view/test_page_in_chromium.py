"""The page in a real Chromium: what it draws lies where the table says, and it does what it is told."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import takewhile
from typing import Any

import numpy as np
import pytest

from candaemon.binding.bind import bind
from candaemon.config.load import load_config
from candaemon.view import viewer
from candaemon.view.drive_pictures import pictures_of_log
from candaemon.view.painter import stage_of
from candaemon.view.picture import Picture
from candaemon.view.viewer import Show
from tests.support.chromium import Tab, chromium, tab
from tests.support.paths import DATA, ROOT
from tests.support.viewing import crowd, demo_binding, demo_pictures, served_page, show_of

pytestmark = pytest.mark.slow

STATES = ("tentative", "confirmed", "coasting")
INSTANTS = 10
DRIVEN_S = 12.0
MINUTES = float(os.environ.get("CANDAEMON_VIEW_MINUTES", "0"))
"""How long memory is watched at 20 Hz in real time; 0: for 120 s of a drive at 8 times."""


@dataclass(frozen=True)
class Drive:
    """A drive and how it is shown."""

    pictures: tuple[Picture, ...]
    show: Show

    @property
    def first_s(self) -> float:
        """Time of the first picture."""
        return self.pictures[0].time

    def at(self, time_s: float) -> Picture:
        """Return the picture that is shown at a time from the beginning."""
        return max(
            (picture for picture in self.pictures if picture.time <= self.first_s + time_s + 1e-6),
            key=lambda picture: picture.time,
        )


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Return a browser."""
    with chromium() as started:
        yield started


@pytest.fixture(scope="module")
def drive() -> Drive:
    """Return a simulated drive."""
    pictures = demo_pictures(10.0)
    return Drive(pictures, show_of(pictures))


@pytest.fixture(scope="module")
def recorded() -> Drive:
    """Return the beginning of the recorded drive."""
    log = DATA / "rav4_drive" / "drive_with_ins.log.gz"
    if not log.exists():
        pytest.skip(f"no recorded drive at {log}")
    binding = bind(load_config(ROOT / "config" / "toyota_rav4_ins.yaml"))
    stream = pictures_of_log(binding, [log])
    first = next(stream)
    pictures = (first, *takewhile(lambda picture: picture.time < first.time + DRIVEN_S, stream))
    show = show_of(pictures)
    show.stage = stage_of(binding)
    return Drive(pictures, show)


@pytest.fixture
def page(browser: Any, drive: Drive) -> Iterator[Tab]:
    """Open the page on a drive."""
    with good_page(browser, drive) as opened:
        yield opened


@contextmanager
def good_page(browser: Any, drive: Drive) -> Iterator[Tab]:
    """Open the page on a drive; whatever it did, it complained of nothing and asked nobody else."""
    with served_page(drive.show) as server, tab(browser, server.url) as opened:
        yield opened
        assert opened.errors == []
        assert {url.partition("//")[2].partition("/")[0] for url in opened.asked} == {f"127.0.0.1:{server.port}"}
        assert any(url.startswith("ws:") for url in opened.asked)


def colours(page: Tab) -> dict[str, list[int]]:
    """Return the colours of the states as red, green and blue."""
    found: dict[str, list[int]] = {}
    for name in STATES:
        text = page.do("n => getComputedStyle(document.documentElement).getPropertyValue('--' + n).trim()", name)
        found[name] = [int(text[k : k + 2], 16) for k in (1, 3, 5)]
    return found


def pixel(page: Tab, x: float, y: float) -> list[int]:
    """Return the colour of a point of the canvas, in px of CSS."""
    read = """([x, y]) => {
        const canvas = document.getElementById('road'), ratio = devicePixelRatio;
        return [...canvas.getContext('2d').getImageData(Math.round(x * ratio), Math.round(y * ratio), 1, 1).data];
    }"""
    found: list[int] = page.do(read, [x, y])
    return found[:3]


def pause(page: Tab) -> None:
    if page.do("document.getElementById('play').textContent") == "Pause":
        page.page.click("#play")
    page.wait("document.getElementById('play').textContent === 'Play'")


def kept(page: Tab, session: Any) -> tuple[int, int]:
    """Return the bytes and nodes that the page keeps; for a moment it also keeps the message that it got last."""
    page.page.wait_for_timeout(300)
    for _ in range(3):
        session.send("HeapProfiler.collectGarbage")
    return session.send("Runtime.getHeapUsage")["usedSize"], session.send("Memory.getDOMCounters")["nodes"]


def seek(page: Tab, drive: Drive, time_s: float) -> Picture:
    """Go to a time from the beginning, and return the picture that is to be seen."""
    picture = drive.at(time_s)
    page.seek(time_s)
    page.wait("t => Math.abs(document.getElementById('road').dataset.time - t) < 2e-3", picture.time)
    page.wait("n => document.querySelectorAll('#obstacles tbody tr').length === n", len(picture))
    return picture


def test_obstacles_are_drawn_where_the_table_and_the_tracks_say(drive: Drive, page: Tab) -> None:
    check_places(drive, page)


def test_the_recorded_drive_is_drawn_where_the_tracks_say(browser: Any, recorded: Drive) -> None:
    with good_page(browser, recorded) as page:
        check_places(recorded, page)


def check_places(drive: Drive, page: Tab) -> None:
    """Check at ten instants that the canvas, the table and the tracks agree."""
    pause(page)
    own, size = colours(page), page.do("(c => [c.clientWidth, c.clientHeight])(document.getElementById('road'))")
    seen = 0
    for time_s in np.linspace(1.0, drive.pictures[-1].time - drive.first_s - 0.5, INSTANTS).tolist():
        picture = seek(page, drive, time_s)
        rows = {int(cells[0]): cells for cells in page.table()}
        assert sorted(rows) == sorted(picture.columns["id"].tolist())
        shown = page.shown()
        places = {}
        for identity, state, x, y in zip(
            *(picture.columns[n].tolist() for n in ("id", "state", "x", "y")), strict=True
        ):
            cells = rows[identity]
            assert cells[1] == STATES[state]
            assert float(cells[2]) == pytest.approx(x, abs=0.006)
            assert float(cells[3]) == pytest.approx(y, abs=0.006)
            places[identity] = (shown["cx"] - y * shown["scale"], shown["cy"] - x * shown["scale"])
        for identity, (px, py) in places.items():
            inside = 4 < px < size[0] - 4 and 4 < py < size[1] - 4
            alone = all(max(abs(px - qx), abs(py - qy)) > 8 for other, (qx, qy) in places.items() if other != identity)
            if inside and alone:
                assert pixel(page, px, py) == own[rows[identity][1]], (identity, time_s)
                seen += 1
    assert seen > 2 * INSTANTS


def test_it_plays_pauses_and_steps(drive: Drive, page: Tab) -> None:
    before = page.shown()["time"]
    page.wait("t => document.getElementById('road').dataset.time > t + 0.5", before)
    pause(page)
    seek(page, drive, 3.0)
    held = page.shown()["time"]
    page.page.wait_for_timeout(300)
    assert page.shown()["time"] == held
    page.page.keyboard.press(".")
    page.wait("t => document.getElementById('road').dataset.time > t", held)
    page.page.keyboard.press(",")
    page.wait("t => Math.abs(document.getElementById('road').dataset.time - t) < 2e-3", held)
    page.page.keyboard.press(" ")
    page.wait("t => document.getElementById('road').dataset.time > t + 0.5", held)


def test_speed_is_followed(drive: Drive, page: Tab) -> None:
    pause(page)
    seek(page, drive, 0.5)
    page.page.select_option("#speed", "0.1")
    page.page.keyboard.press("Escape")
    page.page.click("#play")
    page.wait("document.getElementById('play').textContent === 'Pause'")
    advance = """() => new Promise(done => {
        const road = document.getElementById('road'), from = +road.dataset.time, begin = performance.now();
        setTimeout(() => done((road.dataset.time - from) / ((performance.now() - begin) / 1000)), 1000);
    })"""
    slow = page.do(advance)
    page.page.select_option("#speed", "4")
    page.wait("document.getElementById('speed').value === '4'")
    fast = page.do(advance)
    assert slow < 1.0 < fast
    assert fast > 5 * slow


def test_an_obstacle_is_selected_by_click_row_and_key(drive: Drive, page: Tab) -> None:
    pause(page)
    picture = seek(page, drive, 5.0)
    shown = page.shown()
    order = np.argsort(np.hypot(picture.columns["x"] - 40, picture.columns["y"]))
    row = int(order[0])
    identity, x, y = (picture.columns[name].tolist()[row] for name in ("id", "x", "y"))
    page.page.locator("#road").click(
        position={"x": shown["cx"] - y * shown["scale"], "y": shown["cy"] - x * shown["scale"]}
    )
    page.wait("i => document.getElementById('selected-title').textContent === `Obstacle ${i}`", identity)
    assert page.do("document.querySelector('#obstacles tr[aria-selected=true]').dataset.id") == str(identity)
    assert page.do("document.querySelectorAll('#plots canvas').length") == 5
    drawn = (
        "[...document.querySelectorAll('#plots canvas')].every(c => c.width > 100 && c.getContext('2d')"
        ".getImageData(0, 0, c.width, c.height).data.some(v => v))"
    )
    page.wait(drawn)
    page.page.keyboard.press("Escape")
    page.wait("document.getElementById('selected-title').textContent === 'No obstacle selected'")
    page.page.click(f"#obstacles tr[data-id='{identity}']")
    page.wait("i => document.getElementById('selected-title').textContent === `Obstacle ${i}`", identity)
    page.page.keyboard.press("n")
    page.wait("i => document.getElementById('selected-title').textContent !== `Obstacle ${i}`", identity)


def test_everything_has_a_key_and_help_lists_them(drive: Drive, page: Tab) -> None:
    scale = page.shown()["scale"]
    page.page.keyboard.press("+")
    page.wait("s => document.getElementById('road').dataset.scale > s", scale)
    page.page.keyboard.press("0")
    page.wait("s => Math.abs(document.getElementById('road').dataset.scale - s) < 1e-9", scale)
    before = page.do("getComputedStyle(document.documentElement).colorScheme")
    page.page.keyboard.press("d")
    assert page.do("getComputedStyle(document.documentElement).colorScheme") != before
    page.page.keyboard.press("u")
    page.wait("document.getElementById('units').textContent === 'km/h'")
    assert page.do("document.getElementById('colours').open")
    page.page.keyboard.press("g")
    assert not page.do("document.getElementById('colours').open")
    page.page.keyboard.press("?")
    assert page.do("document.getElementById('help').open")
    assert page.do("document.querySelectorAll('#keys dt').length") > 20
    page.page.keyboard.press("Escape")
    assert not page.do("document.getElementById('help').open")


def test_it_begins_where_the_address_says(browser: Any) -> None:
    pictures = demo_pictures(10.0)
    identity = int(pictures[140].columns["id"][0])
    with served_page(show_of(pictures)) as server, tab(browser, f"{server.url}#t=7&id={identity}") as page:
        page.wait("t => document.getElementById('road').dataset.time >= t - 0.06", pictures[0].time + 7)
        assert page.do("document.getElementById('selected-title').textContent") == f"Obstacle {identity}"
        assert page.errors == []


def test_it_goes_where_the_address_is_changed_to(page: Tab, drive: Drive) -> None:
    pause(page)
    page.do("location.hash = '#t=4'")
    page.wait("t => Math.abs(document.getElementById('road').dataset.time - t) < 0.06", drive.at(4.0).time)
    page.do("location.hash = '#t=99999'")
    page.wait("t => Math.abs(document.getElementById('road').dataset.time - t) < 2e-3", drive.pictures[-1].time)
    page.page.keyboard.press("Home")
    page.wait("document.getElementById('time').textContent.startsWith('0.00 / ')")


def test_it_goes_on_where_it_was_after_it_slept(page: Tab, drive: Drive, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(viewer, "CONFIRM_S", 1.0)  # for how long a page may sleep and not be dropped
    pause(page)
    seek(page, drive, 4.0)
    page.do("{ const end = performance.now() + 2500; while (performance.now() < end); }")
    page.wait("document.getElementById('link').textContent === 'connected'")
    page.page.wait_for_timeout(500)
    page.wait("t => Math.abs(document.getElementById('road').dataset.time - t) < 2e-3", drive.at(4.0).time)
    assert page.do("document.getElementById('play').textContent") == "Play"


@pytest.mark.parametrize(("width", "height"), [(1366, 768), (768, 1024), (1024, 768)])
def test_a_laptop_and_a_tablet_show_all_of_it(browser: Any, width: int, height: int) -> None:
    with (
        served_page(show_of(demo_pictures(10.0))) as server,
        tab(browser, server.url, width=width, height=height, touch=True) as page,
    ):
        assert page.do("document.documentElement.scrollWidth <= innerWidth")
        assert page.do("document.getElementById('colours').open") == (width > 900)  # px: else it covers the road
        for name in ("road", "play", "seek", "obstacles", "theme"):
            box = page.page.locator(f"#{name}").bounding_box()
            assert box is not None
            assert box["width"] > 0
        for name in ("play", "back", "forth", "theme", "zoom-in"):
            box = page.page.locator(f"#{name}").bounding_box()
            assert min(box["width"], box["height"]) >= 36, name  # px: a finger's
            assert box["x"] + box["width"] <= width
            assert box["y"] + box["height"] <= height
        assert page.errors == []


def test_it_connects_again_after_the_server_was_started_again(browser: Any) -> None:
    pictures = demo_pictures(10.0)
    with served_page(show_of(pictures)) as server:
        port, url = server.port, server.url
        opening = ExitStack()
        page = opening.enter_context(tab(browser, url))
        page.page.select_option("#speed", "2")
        page.wait("document.getElementById('speed').value === '2'")
        page.page.keyboard.press("Escape")
        pause(page)
        page.seek(4.0)
        page.wait("document.getElementById('time').textContent.startsWith('4.00 / ')")
    with opening:
        page.wait("document.getElementById('link').textContent.startsWith('no connection')")
        # whatever it asks for in that moment, its WebSocket or an icon, is refused, reset or ends without an answer
        assert all("WebSocket" in error or "net::ERR_" in error for error in page.errors), page.errors
        with served_page(show_of(pictures[:150], session="two"), port):
            page.wait("document.getElementById('link').textContent === 'connected'")
            page.wait("document.getElementById('time').textContent.startsWith('4.00 / 7')")  # of a shorter log
            page.wait("document.querySelectorAll('#obstacles tbody tr').length > 0")
            assert page.do("document.getElementById('play').textContent") == "Play"
            assert page.do("document.getElementById('speed').value") == "2"


def test_a_live_show_is_followed_and_can_be_looked_back_at(browser: Any) -> None:
    pictures = demo_pictures(10.0)
    show = show_of(pictures[:100], live=True)
    with served_page(show) as server, tab(browser, server.url) as page:
        page.wait("t => Math.abs(document.getElementById('road').dataset.time - t) < 2e-3", pictures[99].time)
        show.store.append(pictures[100].time, pictures[100].encoded())
        page.wait("t => Math.abs(document.getElementById('road').dataset.time - t) < 2e-3", pictures[100].time)
        page.page.click("#play")
        page.wait("document.getElementById('play').textContent === 'Play'")
        page.seek(1.0)
        page.wait("t => document.getElementById('road').dataset.time < t", pictures[30].time)
        page.page.click("#follow")
        page.wait("t => Math.abs(document.getElementById('road').dataset.time - t) < 2e-3", pictures[100].time)
        assert page.errors == []


def test_plots_reach_20_s_back_however_many_pictures_come(page: Tab) -> None:
    spans = """async () => {
        const {Memory} = await import('./memory.js'), memory = new Memory(), found = [];
        const picture = (t) => ({t, pose: [0, 0, 0], obstacles: {id: [], x: [], y: []}, scans: []});
        for (let k = 0; k < 9000; k++) {
            memory.add([picture(k / 300)], false);
            if (k >= 6000) found.push([memory.latest.t - memory.pictures[0].t, memory.pictures.length]);
        }
        const steps = memory.pictures.slice(1).map(({t}, k) => t - memory.pictures[k].t);
        const counts = found.map(([, count]) => count);
        return [Math.min(...found.map(([span]) => span)), Math.max(...counts), Math.max(...steps)];
    }"""
    shortest, most, widest = page.do(spans)
    assert shortest > 19.9
    assert most <= 2000
    assert widest < 0.025


def test_memory_stays_flat_with_64_obstacles_at_20_hz(browser: Any) -> None:
    seconds, speed = (60 * MINUTES, 1.0) if MINUTES else (120.0, 8.0)
    show = show_of(crowd(64, seconds + 60))  # its end is never reached: there, the button that pauses plays
    show.stage = {**stage_of(demo_binding()), "modes": ["one", "two", "three"]}
    show.speed = speed
    with served_page(show) as server, tab(browser, server.url) as page:
        page.page.keyboard.press("n")
        session = page.page.context.new_cdp_session(page.page)
        used = []
        for share in (0.3, 0.65, 1.0):  # the memory of 20 s is full from the first on
            while page.shown()["time"] < share * seconds:
                page.page.wait_for_timeout(200)
            pause(page)
            # back, so that all of the last 20 s come again, whatever was left out before; and be sure that they came
            page.seek(share * seconds - 1)
            page.wait("t => document.getElementById('road').dataset.time < t", share * seconds)
            page.wait("Math.abs(document.documentElement.dataset.pictures - 400) <= 1")
            used.append(min(kept(page, session) for _ in range(5)))
            page.page.click("#play")
        print(f"\nheap {[round(size / 1e6, 1) for size, _ in used]} MB, nodes {[nodes for _, nodes in used]}")
        assert used[2][0] < 1.1 * used[0][0] + 1e6
        assert used[2][1] < 1.2 * used[0][1] + 200
        assert page.errors == []
