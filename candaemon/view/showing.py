"""Shows pictures in browsers: a thread makes them, the page is served meanwhile."""

from __future__ import annotations

import asyncio
import logging
import secrets
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import inf
from threading import Event, Thread
from typing import Any, Final, TypeAlias

from candaemon.errors import CandaemonError
from candaemon.status.socket_paths import running_instances
from candaemon.status.status_client import snapshots
from candaemon.view.page_server import PageAddress, PageServer
from candaemon.view.picture import Picture
from candaemon.view.picture_store import LARGEST_DRIVE, LARGEST_LIVE, PictureStore
from candaemon.view.viewer import Show

logger = logging.getLogger(__name__)

Source: TypeAlias = Callable[[Event], Iterator[Picture]]
"""Makes pictures until the event is set."""

_AGAIN_S: Final = 2.0
_POLL_S: Final = 0.2


@dataclass(frozen=True, slots=True)
class ShowRequest:
    """What to show, and where.

    Attributes:
        source: of the pictures.
        stage: what does not change: sensors, names.
        title: what it is of.
        live: whether it is of live buses.
        speed: multiple of real time to begin with.
        instance: name of the running service whose figures are shown, if it runs.
        address: where the page is served.
    """

    source: Source
    stage: dict[str, Any]
    title: str
    live: bool
    address: PageAddress
    speed: float = 1.0
    instance: str | None = None


def show_pictures(request: ShowRequest, ready: Callable[[str], None], duration: float | None = None) -> None:
    """Show pictures in browsers until a signal ends it.

    Args:
        request: what to show, and where.
        ready: called with the page's address once it can be opened.
        duration: s after which it ends; None: never.

    Raises:
        CandaemonError: the address cannot be used, or the source failed before its first picture.
    """
    largest = LARGEST_LIVE if request.live else LARGEST_DRIVE
    store = PictureStore(largest, forgets=request.live)
    show = Show(store, request.stage, request.live, request.title, secrets.token_hex(8), request.speed)
    feeder = Feeder(show, request.source)
    stopping = feeder.stopping
    threads: list[Thread] = [feeder]
    if request.live and request.instance is not None:
        threads.append(Thread(target=_watch_status, args=(show, request.instance, stopping), daemon=True))
    try:
        for thread in threads:
            thread.start()
        feeder.await_first()
        asyncio.run(_serve(show, request.address, ready, duration))
    finally:
        stopping.set()
        feeder.join()
        store.close()


class Feeder(Thread):
    """Puts the pictures of a source into the store.

    Args:
        show: what is shown.
        source: of the pictures.

    Attributes:
        stopping: set to end it.
    """

    def __init__(self, show: Show, source: Source) -> None:
        super().__init__(name="pictures", daemon=True)
        self._show, self._source = show, source
        self._error: CandaemonError | OSError | None = None
        self._begun = Event()
        self.stopping = Event()

    def run(self) -> None:
        """Feed until there are no more, there is no more room, or it is to stop."""
        store = self._show.store
        try:
            for picture in self._source(self.stopping):
                if self.stopping.is_set() or not store.append(picture.time, picture.encoded()):
                    break
                self._begun.set()
        except (CandaemonError, OSError) as error:
            self._error = error
            self._show.problem = f"no more pictures come: {error}"
        finally:
            if not self._show.live:
                store.complete()
            self._begun.set()

    def await_first(self) -> None:
        """Wait for the first picture of a drive; live, there may be none for long.

        Raises:
            CandaemonError: there was none, for that reason.
            OSError: likewise.
        """
        if not self._show.live:
            while not self._begun.wait(_POLL_S):  # a wait without end would take no signal
                pass
        if self._error is not None:
            extent = self._show.store.extent()
            if extent.after == extent.first:
                raise self._error
            logger.warning("%s", self._show.problem)


async def _serve(show: Show, address: PageAddress, ready: Callable[[str], None], duration: float | None) -> None:
    """Serve the page."""
    async with PageServer(show, address) as server:
        ready(server.url)
        end_s = inf if duration is None else asyncio.get_running_loop().time() + duration
        while asyncio.get_running_loop().time() < end_s:
            await asyncio.sleep(_POLL_S)


def _watch_status(show: Show, instance: str, stopping: Event) -> None:
    """Keep the figures of a running service up to date; where it does not run, look again later."""
    while not stopping.is_set():
        path = running_instances().get(instance)
        try:
            for tree in snapshots(path) if path is not None else ():
                show.status = tree
                if stopping.is_set():
                    return
        except CandaemonError:
            pass  # it has ended, or hangs: the page shows that there are no figures
        show.status = None
        stopping.wait(_AGAIN_S)
