"""What is fuzzed: each target takes any bytes, and returns if candaemon did with them what it says."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

from .fuzz_codec import fuzz_codec
from .fuzz_files import fuzz_configuration, fuzz_dbc
from .fuzz_logs import fuzz_logs
from .fuzz_pipeline import fuzz_pipeline
from .fuzz_protection import fuzz_protection
from .fuzz_state import fuzz_state

Target: TypeAlias = Callable[[bytes], None]

TARGETS: dict[str, Target] = {
    "codec": fuzz_codec,
    "configuration": fuzz_configuration,
    "dbc": fuzz_dbc,
    "logs": fuzz_logs,
    "pipeline": fuzz_pipeline,
    "protection": fuzz_protection,
    "state": fuzz_state,
}
