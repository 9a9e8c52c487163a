"""What the tests of the view share: pictures of a simulated drive, and a page that is served meanwhile."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterable, Iterator
from contextlib import asynccontextmanager, contextmanager
from functools import cache
from threading import Event, Thread
from typing import Any

import numpy as np

from candaemon.binding.bind import bind
from candaemon.binding.bound import Binding
from candaemon.config.load import load_config
from candaemon.ego.pose import EgoPose, EgoStatus
from candaemon.view.drive_pictures import pictures_of_frames
from candaemon.view.page_server import PageAddress, PageServer
from candaemon.view.painter import stage_of
from candaemon.view.picture import COLUMNS, Picture, ScanMarks
from candaemon.view.picture_store import PictureStore
from candaemon.view.viewer import Show
from tests.support.paths import ROOT
from tests.support.recorded import highway


@cache
def demo_binding() -> Binding:
    """Return the configuration of the demo."""
    return bind(load_config(ROOT / "config" / "demo.yaml"))


@cache
def demo_pictures(seconds: float = 2.0) -> tuple[Picture, ...]:
    """Return the pictures of a simulated drive."""
    return tuple(pictures_of_frames(demo_binding(), highway(demo_binding(), seconds)))


def crowd(count: int, seconds: float, rate: float = 20.0) -> Iterator[Picture]:
    """Yield pictures of so many obstacles around a vehicle, each with three detections."""
    row = np.arange(count)
    for k in range(round(seconds * rate)):
        time_s = k / rate
        angle = row * 2.4 + 0.2 * time_s
        x, y = 5 + 80 * ((row / count + 0.02 * time_s) % 1), 20 * np.sin(angle)
        columns: dict[str, Any] = {name: np.full(count, 0.3) for name in COLUMNS}
        columns |= {"id": row + 1 + count * (k // 2000), "state": row % 3, "x": x, "y": y, "class": row % 6}
        columns |= {"vx": np.full(count, 12.0), "vy": np.cos(angle), "heading": 0.1 * np.sin(angle)}
        pose = EgoPose(round(time_s * 1e9), 15 * time_s, 0.0, 0.0, 15.0, 0.0, 0.0, 0.01, EgoStatus.VALID)
        marks = ScanMarks(0, np.tile(row, 3), np.tile(x, 3) + 0.5, np.tile(y, 3))
        modes = np.tile([0.7, 0.2, 0.1], (count, 1))
        yield Picture(pose.time_ns, pose, columns, modes, (marks,))


def show_of(pictures: Iterable[Picture], *, live: bool = False, session: str = "one") -> Show:
    """Return pictures as they are shown."""
    store = PictureStore(forgets=live)
    for picture in pictures:
        store.append(picture.time, picture.encoded())
    if not live:
        store.complete()
    return Show(store, stage_of(demo_binding()), live, "a drive", session)


@asynccontextmanager
async def serving(show: Show, host: str = "127.0.0.1", token: str = "") -> AsyncIterator[PageServer]:
    """Serve a page in the loop of the caller."""
    async with PageServer(show, PageAddress(host, 0, token)) as server:
        yield server


@contextmanager
def served_page(show: Show, port: int = 0) -> Iterator[PageServer]:
    """Serve a page from a thread."""
    ready, ended = Event(), Event()
    found: list[Any] = []

    async def run() -> None:
        async with PageServer(show, PageAddress("127.0.0.1", port)) as server:
            found.append(server)
            ready.set()
            while not ended.is_set():
                await asyncio.sleep(0.02)

    thread = Thread(target=lambda: asyncio.run(run()), daemon=True)
    thread.start()
    assert ready.wait(20)
    try:
        yield found[0]
    finally:
        ended.set()
        thread.join(20)
