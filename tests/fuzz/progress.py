"""A progress bar on standard error where that is a terminal, and lines on standard output that it leaves alone."""

from __future__ import annotations

from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn


class ProgressLines:
    """A bar that gives way to each line.

    Args:
        name: of the task.
        total: of its steps.
    """

    def __init__(self, name: str, total: float) -> None:
        console = Console(stderr=True)
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        self._shown = console.is_terminal
        self._bar = Progress(
            *columns,
            console=console,
            transient=True,
            disable=not self._shown,
            redirect_stdout=False,  # else what is printed goes where the bar is
            redirect_stderr=False,
        )
        self._task = self._bar.add_task(name, total=total)

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._shown:
            self._bar.stop()

    def advance(self, more: float) -> None:
        """Go on by so many steps."""
        self._bar.advance(self._task, more)

    def line(self, text: str) -> None:
        """Print a line of the result."""
        if self._shown:
            self._bar.stop()
        print(text, flush=True)
        if self._shown:
            self._bar.start()
