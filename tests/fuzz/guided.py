"""atheris, which steers its inputs by the code that they reach."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

_KEPT = Path(__file__).resolve().parent / "corpus"
_LONGEST = 8192  # bytes of an input


def guided(target: str, *, runs: int | None, seconds: int | None, corpus: Path | None, seed: int) -> int:
    """Look for an input that breaks a target; atheris ends the process, and leaves the input behind where it found one.

    Args:
        target: its name.
        runs: inputs to try; None: as many as the time allows.
        seconds: to try them; None: a minute, or what the runs take.
        corpus: where inputs that reached new code are kept; None: nowhere.
        seed: of chance.

    Returns:
        1 where atheris is not installed.
    """
    try:
        import atheris  # type: ignore[import-untyped, unused-ignore] # it ships no types, and few have it
    except ImportError:
        print("atheris is not installed; install it: pip install 'candaemon[fuzz]'", file=sys.stderr)
        return 1
    with atheris.instrument_imports(include=["candaemon", "cantools", "can"], enable_loader_override=False):
        from .targets import TARGETS
    warnings.simplefilter("error")
    folders = [] if corpus is None else [str(corpus)]
    if corpus is not None:
        corpus.mkdir(parents=True, exist_ok=True)
    limits = [] if runs is None else [f"-runs={runs}"]
    if seconds is not None or runs is None:
        limits.append(f"-max_total_time={seconds or 60}")
    options = [*limits, f"-seed={seed}", f"-max_len={_LONGEST}", "-timeout=60", *folders, str(_KEPT / target)]
    atheris.Setup([sys.argv[0], *options], TARGETS[target])
    atheris.Fuzz()
    return 0
