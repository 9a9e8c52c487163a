"""The endpoint for Prometheus, scraped as Prometheus does."""

from __future__ import annotations

import re
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from dataclasses import replace
from http.client import HTTPConnection
from pathlib import Path
from threading import Event
from urllib.request import urlopen

import pytest
from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.metrics_core import Metric
from prometheus_client.parser import text_string_to_metric_families

from candaemon.binding.bound import Binding
from candaemon.daemon.daemon import Daemon
from candaemon.daemon.observer import Observer
from candaemon.printable import printable
from candaemon.status import metrics_http as scrape
from candaemon.status.metrics_endpoint import MetricsEndpoint
from candaemon.status.prometheus_metrics import SnapshotCollector
from candaemon.status.service_monitor import ServiceMonitor
from candaemon.status.snapshot import StatusSnapshot
from tests.support.paths import ROOT
from tests.support.served import Served, bound, drive, wait_until


@pytest.fixture
def port() -> int:
    """Return a port that is free at this moment."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def with_port(folder: Path, port: int) -> Binding:
    return bound(folder, f"  metrics: {{port: {port}}}\n")


def observers(binding: Binding) -> list[Observer]:
    meter = ServiceMonitor(binding.settings.service.metrics)
    return [meter, MetricsEndpoint(meter)]


def scraped(port: int) -> dict[str, Metric]:
    wait_until(lambda: is_open(port))
    with urlopen(f"http://127.0.0.1:{port}/metrics", timeout=5.0) as answer:
        text = answer.read().decode()
    return {family.name: family for family in text_string_to_metric_families(text)}


def value(families: dict[str, Metric], sample: str, **labels: str) -> float:
    (found,) = [
        each.value
        for family in families.values()
        for each in family.samples
        if each.name == sample and labels.items() <= each.labels.items()
    ]
    return float(found)


def is_open(port: int, address: str = "127.0.0.1") -> bool:
    with socket.socket() as probe:
        return probe.connect_ex((address, port)) == 0


def test_the_counters_are_the_daemons(tmp_path: Path, port: int) -> None:
    binding = with_port(tmp_path, port)
    with Served(binding, observers(binding)) as served:
        served.feed(drive(binding, 2.0))
        families = scraped(port)
        pipeline, buses = served.daemon.pipeline, served.daemon.buses
        assert value(families, "candaemon_frames_total", bus="radar", direction="received") == buses[0].counts.received
        assert value(families, "candaemon_frames_total", bus="obstacles", direction="sent") == pipeline.counts.sent
        assert value(families, "candaemon_frames_dropped_total", bus="radar", cause="queue_full") == 0
        assert value(families, "candaemon_sensor_frames_total", sensor="front", fate="used") == 40 * 64
        assert value(families, "candaemon_cycles_total") == pipeline.counts.cycles == 40
    assert value(families, "candaemon_bus_up", bus="ins") == 1
    assert value(families, "candaemon_tracks", state="confirmed") >= 3
    assert value(families, "candaemon_own_motion", status="valid") == 1
    assert value(families, "candaemon_own_motion", status="lost") == 0
    assert value(families, "candaemon_sensor_trust", sensor="front") == pytest.approx(1.0)
    assert 0.3 < value(families, "candaemon_nis", sensor="front") < 2.0
    assert value(families, "candaemon_info", instance="mine") == 1
    assert value(families, "process_cpu_seconds_total") > 0.1
    assert value(families, "process_resident_memory_bytes") > 10e6


def test_the_histograms_add_up(tmp_path: Path, port: int) -> None:
    binding = bound(tmp_path, f"  metrics: {{port: {port}, buckets: [0.001, 0.01, 5]}}\n")
    with Served(binding, observers(binding)) as served:
        served.feed(drive(binding, 1.0))
        families = scraped(port)
    for name in ("candaemon_cycle_seconds", "candaemon_latency_seconds"):
        buckets = [each.value for each in families[name].samples if each.name.endswith("_bucket")]
        assert len(buckets) == 4
        assert buckets == sorted(buckets)
        assert buckets[-1] == value(families, f"{name}_count") == value(families, "candaemon_cycles_total")
        assert 0.0 <= value(families, f"{name}_sum") <= 5.0 * buckets[-1]


def test_every_metric_has_its_help_and_its_own_name(tmp_path: Path, port: int) -> None:
    binding = with_port(tmp_path, port)
    with Served(binding, observers(binding)):
        families = scraped(port)
    assert len(families) >= 25
    for name, family in families.items():
        assert family.documentation, name
        assert family.type != "unknown", name
        assert name.startswith(("candaemon", "process_")), name


def test_a_path_that_is_no_utf8_costs_no_scrape(tmp_path: Path, port: int) -> None:
    folder = tmp_path / "front\udcff\n\u2028\x1b"
    folder.mkdir()
    binding = with_port(folder, port)
    with Served(binding, observers(binding)):
        families = scraped(port)
    assert value(families, "candaemon_info", config=rf"{tmp_path}/front\udcff\n\u2028\x1b/mine.yaml") == 1


def test_labels_hold_nothing_that_breaks_the_text(tmp_path: Path) -> None:
    binding = bound(tmp_path)
    monitor = ServiceMonitor(binding.settings.service.metrics)
    daemon = Daemon(binding)
    monitor.on_start(daemon)
    snapshot = monitor.snapshot(daemon)
    hostile = 'a"\\\n# HELP x\udcff\u2028'
    (bus, *_), (sensor,) = snapshot.buses.values(), snapshot.sensors.values()
    registry = CollectorRegistry()
    registry.register(SnapshotCollector(replace(snapshot, buses={hostile: bus}, sensors={hostile: sensor})))
    families = {each.name: each for each in text_string_to_metric_families(generate_latest(registry).decode())}
    assert {each.labels["bus"] for each in families["candaemon_frames"].samples} == {printable(hostile)}
    assert {each.labels["sensor"] for each in families["candaemon_sensor_lost"].samples} == {printable(hostile)}


def test_the_endpoint_listens_on_loopback_only_and_not_after_the_end(tmp_path: Path, port: int) -> None:
    binding = with_port(tmp_path, port)
    with Served(binding, observers(binding)):
        wait_until(lambda: is_open(port))
        listening = Path("/proc/net/tcp").read_text(encoding="ascii").splitlines()[1:]
        ours = [line.split()[1] for line in listening if line.split()[1].endswith(f":{port:04X}")]
        assert all(address.startswith("0100007F:") for address in ours), ours
    assert not is_open(port)


def test_without_a_port_nothing_listens_and_nothing_is_loaded(tmp_path: Path) -> None:
    binding = bound(tmp_path)
    meter = ServiceMonitor(binding.settings.service.metrics)
    endpoint = MetricsEndpoint(meter)
    with Served(binding, [meter, endpoint]):
        meter.wait_for_snapshot(5.0)
        assert endpoint.port is None
    code = (
        "import sys\nimport candaemon.cli.serve, candaemon.status.metrics_endpoint, candaemon.status.service_monitor\n"
        "import candaemon.status.status_socket\n"
        "sys.exit('prometheus_client' in sys.modules or 'http.server' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False).returncode == 0


def test_a_port_in_use_is_said_with_its_line_and_does_not_end_the_service(
    tmp_path: Path, port: int, caplog: pytest.LogCaptureFixture
) -> None:
    binding = with_port(tmp_path, port)
    with socket.socket() as other:
        other.bind(("127.0.0.1", port))
        other.listen()
        meter, endpoint = observers(binding)
        with Served(binding, [meter, endpoint]) as served:
            served.feed(drive(binding, 0.5))
            assert served.daemon.pipeline.counts.cycles
        assert is_open(port)  # the other one's still
    (said,) = [message for message in caplog.messages if "in use" in message]
    assert "choose another port, then reload. Until then there are no metrics" in said
    place = re.search(rf"mine\.yaml:(\d+): service\.metrics\.port: .*:{port}", said)
    assert place is not None
    assert "port:" in (tmp_path / "mine.yaml").read_text(encoding="utf-8").splitlines()[int(place[1]) - 1]


def test_a_reload_moves_the_port_or_keeps_it_where_it_cannot(
    tmp_path: Path, port: int, caplog: pytest.LogCaptureFixture
) -> None:
    first = with_port(tmp_path, port)
    meter = ServiceMonitor(first.settings.service.metrics)
    endpoint = MetricsEndpoint(meter)
    ports = []
    with Served(first, [meter]) as served, socket.socket() as other:
        endpoint.on_start(served.daemon)
        other.bind(("127.0.0.1", 0))
        other.listen()
        taken, none = with_port(tmp_path, other.getsockname()[1]), bound(tmp_path)
        for binding, error in ((taken, ""), (none, "mine.yaml:1: refused"), (none, "")):
            served.daemon.pipeline.binding = binding
            endpoint.on_reload_end(served.daemon, error)
            ports.append(endpoint.port)
    assert ports == [port, port, None]
    assert "in use" in caplog.text
    assert f"port {port}" in caplog.text
    assert not is_open(port)


class Unserved:
    """Counts connections that got no metrics."""

    def __init__(self) -> None:
        self.count = 0

    def __call__(self) -> None:
        self.count += 1


@pytest.fixture
def unserved() -> Unserved:
    return Unserved()


@pytest.fixture
def unturned(unserved: Unserved) -> Iterator[scrape.MetricsServer]:
    """Yield a server whose core loop takes no turn."""

    def ask() -> StatusSnapshot:
        raise TimeoutError

    server = scrape.MetricsServer(0, ask, unserved)
    server.start()
    yield server
    server.stop()


def test_a_core_loop_that_hangs_is_said(unturned: scrape.MetricsServer, unserved: Unserved) -> None:
    connection = HTTPConnection("127.0.0.1", unturned.port, timeout=5.0)
    connection.request("GET", "/metrics")
    answer = connection.getresponse()
    assert (answer.status, answer.reason) == (503, "the core loop takes no turn")
    connection.close()
    wait_until(lambda: unserved.count == 1)


def half_open(port: int, stack: ExitStack) -> socket.socket:
    """Connect and ask for half of something."""
    client = stack.enter_context(socket.create_connection(("127.0.0.1", port), timeout=10.0))
    client.sendall(b"GET /met")
    return client


@pytest.mark.parametrize("more", [0, 1])
def test_connections_that_ask_for_nothing_make_room(
    more: int, unturned: scrape.MetricsServer, unserved: Unserved, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scrape, "REQUEST_S", 60.0)
    with ExitStack() as opened:
        clients = [half_open(unturned.port, opened) for _ in range(scrape.MOST_SCRAPERS + more)]
        if more:
            assert clients[0].recv(100) == b""
            wait_until(lambda: unserved.count == 1)
        else:
            clients[0].settimeout(0.3)
            with pytest.raises(TimeoutError):
                clients[0].recv(100)
            assert unserved.count == 0


def test_forty_half_open_connections_cost_no_scrape_and_are_counted(tmp_path: Path, port: int) -> None:
    binding = with_port(tmp_path, port)
    meter, endpoint = observers(binding)
    assert isinstance(meter, ServiceMonitor)
    with Served(binding, [meter, endpoint]), ExitStack() as opened:
        wait_until(lambda: is_open(port))
        wait_until(lambda: meter.clients.scrapes == 1)  # which that was
        for _ in range(40):
            half_open(port, opened)
        for _ in range(3):
            lost = value(scraped(port), "candaemon_losses_total", kind="scrapes")
        assert lost >= 40 - scrape.MOST_SCRAPERS
        opened.close()
        wait_until(lambda: meter.clients.scrapes == 41 + 3)  # `scraped` looks whether it is open


@pytest.mark.parametrize("late", ["silent", "dripping"])
def test_a_request_comes_in_time_or_is_hung_up_on(
    late: str, unturned: scrape.MetricsServer, unserved: Unserved, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scrape, "REQUEST_S", 0.5)
    began_s = time.monotonic()
    with ExitStack() as opened:
        client = half_open(unturned.port, opened)
        with suppress(OSError):
            while late == "dripping":
                client.sendall(b"x")
                time.sleep(0.05)
                assert time.monotonic() - began_s < 10.0
        if late == "silent":
            assert client.recv(100) == b""
    assert time.monotonic() - began_s >= 0.4
    wait_until(lambda: unserved.count == 1)


def test_an_answer_that_takes_too_long_is_hung_up_on(monkeypatch: pytest.MonkeyPatch, unserved: Unserved) -> None:
    monkeypatch.setattr(scrape, "ANSWER_S", 0.5)
    go = Event()

    def ask() -> StatusSnapshot:
        go.wait(20.0)
        raise TimeoutError

    server = scrape.MetricsServer(0, ask, unserved)
    server.start()
    with socket.create_connection(("127.0.0.1", server.port), timeout=15.0) as client:
        began_s = time.monotonic()
        client.sendall(b"GET /metrics HTTP/1.0\r\n\r\n")
        assert client.recv(100) == b""
        assert time.monotonic() - began_s >= 0.4
        go.set()
    wait_until(lambda: unserved.count == 1)
    server.stop()


@pytest.mark.parametrize(("over", "status"), [(0, 503), (1, 431), (1 << 20, 431)])
def test_a_request_as_long_as_its_limit_is_read(over: int, status: int, unturned: scrape.MetricsServer) -> None:
    start, end = b"GET /metrics HTTP/1.0\r\nX: ", b"\r\n\r\n"
    request = start + b"x" * (scrape.LONGEST_REQUEST + over - len(start) - len(end)) + end
    with socket.create_connection(("127.0.0.1", unturned.port), timeout=10.0) as client:
        with suppress(OSError):  # it is hung up on before it is read whole
            client.sendall(request)
        with suppress(ConnectionResetError):
            assert client.recv(100).split()[1:2] in ([b"%d" % status], [])


def test_clients_without_rest_do_not_hold_the_core_loop(tmp_path: Path, port: int) -> None:
    binding = with_port(tmp_path, port)
    with Served(binding, observers(binding)) as served:
        wait_until(lambda: is_open(port))
        silent = [socket.create_connection(("127.0.0.1", port)) for _ in range(12)]
        began_s = time.monotonic()
        served.feed(drive(binding, 1.0))
        assert time.monotonic() - began_s < 5.0
        for client in silent:
            client.close()
    assert served.daemon.pipeline.counts.cycles >= 20
