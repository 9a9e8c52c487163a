"""Spreads drives over Dask's workers: processes of this machine, or a cluster that is there already."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, suppress
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import Any, Final, Self

from candaemon.errors import ConfigError, InputError
from candaemon.exports.extras import import_extra
from candaemon.fleet.drive_task import DriveOrder, DriveOutcome, run_drive
from candaemon.fleet.software import difference, software
from candaemon.printable import printable

WAITING_A_WORKER: Final = 4
"""Drives that are on their way for each of a worker's threads."""
PATIENCE_S: Final = 300.0
"""s that a scheduler may be away, or without a worker."""
LEAST_MEMORY: Final = 512 << 20
"""Least memory of a worker of this machine, bytes: what its libraries take, and a drive."""
_LEAST_WAITING: Final = 8
_MOST_KILLED: Final = 1
"""Workers of this machine that a drive may take with it before it is set aside for the end."""
_LOOK_S: Final = 0.1
_COUNT_AGAIN_S: Final = 10.0


class Workers:
    """Dask's workers, by a client. A context manager: leaving it ends what it started.

    Args:
        scheduler: address; None: processes of this machine.
        count: of those.
        memory: most of each of those, such as `4GiB`; None: an equal share.
        patience: s that the scheduler may be away, or without a worker.

    Raises:
        ConfigError: Dask is not installed, an address or amount is none, or an amount is too small.
        InputError: there is no such scheduler, or processes do not start.
    """

    def __init__(
        self, scheduler: str | None, count: int, memory: str | None = None, patience: float = PATIENCE_S
    ) -> None:
        self._dask = import_extra("distributed", "fleet", "a fleet")
        for name in [each for each in logging.root.manager.loggerDict if each.startswith("distributed")]:
            logging.getLogger(name).setLevel(logging.CRITICAL)  # what matters is told by the outcomes
        self._files = ExitStack()
        self._patience = patience
        self._scheduler = scheduler
        self._threads, self._asked, self._manned = 1, -_COUNT_AGAIN_S, time.monotonic()
        with ExitStack() as unfinished:
            unfinished.push(self._files)
            self._client = self._local(count, memory) if scheduler is None else self._remote(scheduler)
            unfinished.pop_all()

    def _local(self, count: int, memory: str | None) -> Any:
        most = "auto" if memory is None else _bytes(memory)
        folder = self._files.enter_context(TemporaryDirectory(prefix="candaemon-fleet-"))
        try:
            cluster = self._dask.LocalCluster(
                n_workers=count,
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                dashboard_address="127.0.0.1:0",
                memory_limit=most,
                local_directory=folder,
                env={"TMPDIR": folder},  # a worker that is ended removes nothing itself
                silence_logs=logging.CRITICAL,
                scheduler_kwargs={"allowed_failures": _MOST_KILLED},
            )
        except (RuntimeError, OSError, TimeoutError) as error:
            raise _not_started(error) from error
        self._files.enter_context(cluster)
        return self._files.enter_context(self._dask.Client(cluster))

    def _remote(self, scheduler: str) -> Any:
        try:
            return self._files.enter_context(self._dask.Client(scheduler, timeout=min(self._patience, 30.0)))
        except ValueError as error:
            raise ConfigError(
                f"--scheduler: found '{printable(scheduler)}', expected an address such as tcp://host:8786: {error}"
            ) from None
        except (OSError, TimeoutError) as error:
            raise InputError(
                f"no scheduler answers: {printable(str(error))}; start one: dask scheduler", file=scheduler
            ) from None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._files.close()

    @property
    def dashboard(self) -> str:
        """Address of Dask's dashboard."""
        return str(self._client.dashboard_link)

    @property
    def count(self) -> int:
        """Workers that are there."""
        return len(self._client.nthreads())

    def await_worker(self) -> None:
        """Wait until there is a worker.

        Raises:
            InputError: none comes.
        """
        try:
            self._client.wait_for_workers(1, timeout=self._patience)
        except TimeoutError:
            raise self._unmanned() from None

    def require_same(self) -> None:
        """Refuse workers with other software than ours, as their results would differ.

        Raises:
            InputError: names a worker and what differs; or one has ended.
        """
        try:
            found = self._client.run(software)
        except (ImportError, AttributeError) as error:
            raise InputError(f"a worker has no candaemon that fits: {error}; install the same on all") from None
        except OSError as error:
            raise _not_started(error) from error
        for worker, theirs in found.items():
            differs = difference(theirs, software())
            if differs:
                raise InputError(f"the worker {worker} has {differs}; install the same on all workers")

    def outcomes(self, orders: Iterable[DriveOrder], *, alone: bool = False) -> Iterator[DriveOutcome]:
        """Yield the outcome of each drive as it ends; few are on their way at a time, whatever their number.

        Args:
            orders: begun in this order.
            alone: one after another, so that a drive that takes its worker with it harms no other.

        Raises:
            InputError: the scheduler is gone, or without a worker, for too long.
        """
        waiting, source = deque[DriveOrder](), iter(orders)
        sent: dict[str, tuple[Any, DriveOrder]] = {}
        done, ended = self._dask.as_completed([]), deque[Any]()
        number = 0
        while True:
            most = 1 if alone else self._most_waiting()
            while len(sent) < most:
                order = waiting.popleft() if waiting else next(source, None)
                if order is None:
                    break
                number += 1
                # what is before the number is a kind of task to the scheduler, of which it remembers every one
                key = f"drive-{number}-{order.drive.name}-{id(self):x}-{time.monotonic_ns():x}"
                future = self._submitted(order, key)
                sent[key] = future, order
                done.add(future)
            if not sent:
                return
            if not ended:
                ended += self._next_ended(done)
            future = ended.popleft()
            _, order = sent.pop(future.key)
            outcome = self._outcome(future, order)
            if outcome is None:
                self._await_scheduler()
                waiting.append(order)
            else:
                yield outcome

    def _next_ended(self, done: Any) -> list[Any]:
        """Wait for drives to end; return those that have, one at least.

        Raises:
            InputError: there is no worker for too long.
        """
        while not (found := done.next_batch(block=False)):
            self._count_threads()
            if time.monotonic() - self._manned > self._patience:
                raise self._unmanned()
            time.sleep(_LOOK_S)
        return list(found)

    def _outcome(self, future: Any, order: DriveOrder) -> DriveOutcome | None:
        """Return how a drive ended; None where the scheduler was lost meanwhile."""
        if future.status == "error":
            return DriveOutcome(order.drive.name, _reason(future.exception()))
        try:
            outcome: DriveOutcome = future.result()
        except (self._dask.CancelledError, OSError):  # a drive's own errors are in its outcome
            return None
        return outcome

    def _submitted(self, order: DriveOrder, key: str) -> Any:
        """Hand a drive out, as soon as there is a scheduler."""
        while True:
            self._await_scheduler()
            try:
                return self._client.submit(run_drive, order, key=key, pure=False)
            except OSError:
                time.sleep(_LOOK_S)

    def _await_scheduler(self) -> None:
        """Wait until the client has a scheduler again.

        Raises:
            InputError: it does not come.
        """
        deadline = time.monotonic() + self._patience
        while self._client.status != "running":
            if self._client.status == "closed" and self._scheduler is not None and time.monotonic() < deadline:
                self._reconnect(deadline)
            elif time.monotonic() > deadline or self._client.status == "closed":
                raise InputError(
                    "the scheduler is gone; what is complete stays: run the command again to go on",
                    file=self._scheduler,
                )
            time.sleep(_LOOK_S)

    def _reconnect(self, deadline: float) -> None:
        """Have another client, where the former has given up."""
        while time.monotonic() < deadline and self._scheduler is not None:
            try:
                self._client = self._remote(self._scheduler)
            except InputError:
                time.sleep(_LOOK_S)
            else:
                return

    def _most_waiting(self) -> int:
        """Return how many drives may be on their way."""
        self._count_threads()
        return max(WAITING_A_WORKER * self._threads, _LEAST_WAITING)

    def _count_threads(self) -> None:
        """Ask now and then how many threads the workers have, which come and go, and note when there were any."""
        now = time.monotonic()
        if now - self._asked <= _COUNT_AGAIN_S:
            return
        self._asked = now
        if self._client.status == "running":
            with suppress(OSError):  # while the scheduler is away, they are as many as before
                self._threads = sum(self._client.nthreads().values())
        if self._threads:
            self._manned = now

    def _unmanned(self) -> InputError:
        """Return the error that there is no worker."""
        return InputError(
            f"the scheduler has had no worker for {self._patience:g} s; start some, each by: dask worker ADDRESS "
            "--nthreads 1; then run the command again",
            file=self._scheduler,
        )


def _bytes(memory: str) -> int:
    """Return an amount of memory.

    Raises:
        ConfigError: it is none, or too small for a worker.
    """
    parse_bytes = import_extra("dask.utils", "fleet", "a fleet").parse_bytes
    try:
        found = int(parse_bytes(memory))
    except (ValueError, OverflowError):
        found = 0
    if found < LEAST_MEMORY:
        least = f"{LEAST_MEMORY >> 20}MiB"
        raise ConfigError(f"--memory: found '{printable(memory)}', expected an amount such as 4GiB, at least {least}")
    return found


def _not_started(error: Exception) -> InputError:
    """Return the error that workers ended before they had anything to do."""
    return InputError(
        f"workers end as they start: {printable(str(error) or type(error).__name__)}; give each more by --memory, or "
        "start fewer by --workers; those of a cluster say why in their own logs"
    )


def _reason(error: BaseException) -> str:
    """Return why a task ended with an exception."""
    if type(error).__name__ == "KilledWorker":
        return "its worker was killed each time, most likely for want of memory; give workers more, or look at the log"
    return f"{type(error).__name__}: {printable(str(error))}; this is a fault of candaemon or of the installation"
