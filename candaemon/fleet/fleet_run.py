"""A fleet's run: what is done already is left, what fails is tried again and set aside, all else is computed."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

from candaemon.errors import ConfigError, InputError
from candaemon.fleet.dataset import (
    DriveRecordFile,
    ReplayOptions,
    failure_name,
    noted_drives,
    records_in,
    write_failure,
)
from candaemon.fleet.drive_list import FleetDrive
from candaemon.fleet.drive_task import DriveOrder, DriveOutcome
from candaemon.fleet.kept_configuration import KeptConfiguration
from candaemon.fleet.locations import LogFile, files_at, weight
from candaemon.fleet.result_store import ResultStore
from candaemon.fleet.software import software
from candaemon.fleet.workers import Workers

logger = logging.getLogger(__name__)


@dataclass(slots=True)
class FleetResult:
    """How a run ended.

    Attributes:
        drives: all.
        kept: that were there already.
        computed: by this run.
        failed: reasons by drive.
        others: drives that the folder holds of former runs.
        duration: of the logs computed, s.
        effort: s of processor time that took.
    """

    drives: int = 0
    kept: int = 0
    computed: int = 0
    failed: dict[str, str] = field(default_factory=dict)
    others: tuple[str, ...] = ()
    duration: float = 0.0
    effort: float = 0.0

    def add(self, outcome: DriveOutcome) -> None:
        """Count a drive's end."""
        if outcome.reason:
            self.failed[outcome.drive] = outcome.reason
            return
        self.failed.pop(outcome.drive, None)
        if outcome.computed:
            self.computed += 1
            self.duration += outcome.duration
            self.effort += outcome.effort
        else:
            self.kept += 1


def configurations_of(drives: Sequence[FleetDrive], options: ReplayOptions) -> dict[Path, KeptConfiguration]:
    """Return all configurations that drives name, loaded.

    Raises:
        ConfigError: one cannot be used, or has no bus that the options name.
    """
    found = {path: KeptConfiguration.load(path) for path in dict.fromkeys(drive.configuration for drive in drives)}
    for path, configuration in found.items():
        for channel, bus in options.channels.items():
            if bus not in configuration.buses:
                known = ", ".join(sorted(configuration.buses))
                raise ConfigError(f"--map {channel}={bus}: no bus '{bus}'; expected one of {known}", file=path)
    return found


def orders_of(
    drives: Sequence[FleetDrive],
    configurations: Mapping[Path, KeptConfiguration],
    store: ResultStore,
    options: ReplayOptions,
    result: FleetResult,
    *,
    verify: bool = False,
) -> list[DriveOrder]:
    """Return what is left to do, heavy drives first; what is done already is counted.

    Args:
        drives: all.
        configurations: of theirs, by path.
        store: with what former runs left.
        options: of the replay.
        result: takes what is done, and which drives the folder holds beside these.
        verify: look into logs that seem to be unchanged, too.
    """
    sizes, records, orders = store.sizes(), records_in_order(store), []
    result.drives = len(drives)
    result.others = tuple(sorted(noted_drives(sizes) - {drive.name for drive in drives}))
    for drive in drives:
        kept = configurations[drive.configuration]
        order = DriveOrder(drive, store.url, kept.digest, kept.yaml, kept.base, options, software())
        try:
            files = files_at(drive.logs)
        except InputError:
            files = []  # the worker will say so, unless it finds them
        record = records.get(drive.name)
        failed = failure_name(drive.name) in sizes
        if record and not verify and not failed and _is_done(record, order, files) and record.is_complete(sizes):
            result.add(DriveOutcome(drive.name))
            continue
        orders.append(replace(order, weight=sum(map(weight, files))))
    return sorted(orders, key=lambda order: (-order.weight, order.drive.name))


def records_in_order(store: ResultStore) -> dict[str, DriveRecordFile]:
    """Return the records that can be read; a damaged one is removed, as its drive has to be computed again."""
    try:
        return records_in(store)
    except InputError:
        found = {}
        for name in store.sizes("records"):
            content = store.read(name)
            try:
                record = DriveRecordFile.from_bytes(content or b"", name)
            except InputError:
                store.remove(name)
            else:
                found[record.drive] = record
        return found


def _is_done(record: DriveRecordFile, order: DriveOrder, files: Sequence[LogFile]) -> bool:
    return (
        record.configuration == order.configuration
        and record.options == asdict(order.options)
        and record.software == order.software
        and record.tags == dict(order.drive.tags)
        and record.logs == order.drive.logs
        and record.is_of(files)
    )


def run_fleet(
    orders: Sequence[DriveOrder],
    workers: Workers,
    store: ResultStore,
    result: FleetResult,
    ended: Callable[[DriveOrder, DriveOutcome], None] | None = None,
) -> None:
    """Compute drives; those that fail are tried once more at the end, one after another, and then noted.

    Args:
        orders: what to do.
        workers: who does it.
        store: where notes of failures go.
        result: takes the outcomes.
        ended: called after each drive's last try.
    """
    of = {order.drive.name: order for order in orders}
    again = []
    for outcome in workers.outcomes(orders):
        if outcome.reason:
            again.append(of[outcome.drive])
            continue
        _take(of[outcome.drive], outcome, result, ended)
    for outcome in workers.outcomes(again, alone=True):
        if outcome.reason:
            try:
                write_failure(store, outcome.drive, of[outcome.drive].drive.logs, outcome.reason)
            except InputError as error:  # a disk that is full for results is full for notes
                logger.warning("not noted that %s failed: %s", outcome.drive, error)
        _take(of[outcome.drive], outcome, result, ended)


def _take(
    order: DriveOrder,
    outcome: DriveOutcome,
    result: FleetResult,
    ended: Callable[[DriveOrder, DriveOutcome], None] | None,
) -> None:
    result.add(outcome)
    if ended is not None:
        ended(order, outcome)
