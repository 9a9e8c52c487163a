"""The endpoint for Prometheus, on the loopback interface where a port is configured."""

from __future__ import annotations

import logging
from functools import partial
from typing import TYPE_CHECKING

from candaemon.binding.bound import Binding
from candaemon.daemon.observer import DaemonView, Observer
from candaemon.errors import CandaemonError, InputError
from candaemon.status.service_monitor import ServiceMonitor

if TYPE_CHECKING:
    from candaemon.status.metrics_http import MetricsServer

logger = logging.getLogger(__name__)

_TURN_S = 1.0


class MetricsEndpoint(Observer):
    """Serves the metrics at `service.metrics.port`; without one it does nothing and loads nothing.

    Args:
        meter: takes the snapshots; it observes the same daemon.
    """

    def __init__(self, meter: ServiceMonitor) -> None:
        self._meter = meter
        self._server: MetricsServer | None = None

    @property
    def port(self) -> int | None:
        """The port that is served; None: none is."""
        return None if self._server is None else self._server.port

    def on_start(self, daemon: DaemonView) -> None:
        """Open the configured port; where it cannot be had, the obstacles are served without metrics."""
        self._follow(daemon.pipeline.binding)

    def on_reload_end(self, daemon: DaemonView, error: str) -> None:
        """Follow the port that is configured; where it cannot be had, stay at the one before."""
        if not error:
            self._follow(daemon.pipeline.binding)

    def on_stop(self, daemon: DaemonView) -> None:  # noqa: ARG002 - the hook's signature
        """Close the port."""
        self._close()

    def _follow(self, binding: Binding) -> None:
        """Serve at the configured port, or say why not: obstacles matter more than their metrics."""
        try:
            self._serve(binding)
        except CandaemonError as problem:
            until = f"metrics stay at port {self.port}" if self.port else "there are no metrics"
            logger.error("%s, then reload. Until then %s", problem, until)  # noqa: TRY400 - nothing here is at fault

    def _serve(self, binding: Binding) -> None:
        """Serve at the configured port and no other."""
        port = binding.settings.service.metrics.port
        if port == self.port:
            return
        server = None if port is None else self._opened(port, binding)
        self._close()
        self._server = server
        if server is not None:
            server.start()
            logger.info("metrics at http://%s:%d/metrics", *server.server_address)

    def _opened(self, port: int, binding: Binding) -> MetricsServer:
        """Open a port."""
        from candaemon.status.metrics_http import MetricsServer  # noqa: PLC0415 - loads what only few services need

        try:
            return MetricsServer(port, partial(self._meter.wait_for_snapshot, _TURN_S), self._count_unserved)
        except OSError as error:
            loaded = binding.loaded
            raise InputError(
                f"service.metrics.port: cannot listen at 127.0.0.1:{port}: {error.strerror}; "
                f"`ss -ltnp 'sport = :{port}'` shows who does; choose another port",
                file=loaded.path,
                line=loaded.line_of(("service", "metrics", "port")),
            ) from error

    def _count_unserved(self) -> None:
        self._meter.clients.scrapes += 1

    def _close(self) -> None:
        server, self._server = self._server, None
        if server is not None:
            server.stop()
