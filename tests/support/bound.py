"""The project's configurations, each bound once for all tests."""

from __future__ import annotations

from functools import cache

from candaemon.binding.bind import bind
from candaemon.binding.bound import Binding
from candaemon.config.load import load_config
from tests.support.paths import ROOT


@cache
def binding(name: str) -> Binding:
    """Bind a configuration of `config/` by its name."""
    return bind(load_config(ROOT / "config" / f"{name}.yaml"))
