"""The state of a pipeline as bytes, and back: what a recording's files begin with.

Stored is what changes while the pipeline runs; what the configuration alone decides is not. Both sides make a pipeline
of the same binding; its parts are found by their place (`skeleton`), their content is pickled (`pickling`), and a
header says of which configuration and version it is (`header`). A state from somebody else can bring wrong numbers, but
no code.
"""

from __future__ import annotations

import pickle
from pathlib import Path

from candaemon.binding.bound import Binding
from candaemon.errors import InputError
from candaemon.pipeline.pipeline import Pipeline
from candaemon.pipeline.saved_state.fingerprint import digest, fingerprint
from candaemon.pipeline.saved_state.header import StateHeader, header_of, split
from candaemon.pipeline.saved_state.pickling import fill, pickled
from candaemon.pipeline.saved_state.skeleton import Skeleton

__all__ = ["Snapshots", "StateHeader", "begun", "dump", "fingerprint", "header_of", "restore"]

_DAMAGED = (
    pickle.UnpicklingError,
    ArithmeticError,
    AttributeError,
    EOFError,
    LookupError,
    MemoryError,
    RecursionError,
    TypeError,
    ValueError,
)
"""What unpickling raises on bytes that were not made here."""


class Snapshots:
    """Stores the states of pipelines of one configuration.

    Args:
        pipeline: one that has taken nothing yet; only its structure is looked at.

    Attributes:
        configuration: digest of what decides what the same frames lead to.
    """

    def __init__(self, pipeline: Pipeline) -> None:
        self._skeleton = Skeleton(pipeline, pipeline.binding)
        self._fingerprint = fingerprint(pipeline.binding)
        self.configuration = digest(self._fingerprint)

    def dump(self, pipeline: Pipeline, *, begins: str = "", follows: str = "", time_ns: int = 0) -> bytes:
        """Return the state of a pipeline between two runs.

        Args:
            pipeline: of the same binding.
            begins: why a recording's file begins with it.
            follows: the file whose end it is the state of; empty: of none.
            time_ns: of the first item that comes after it.
        """
        content = pickled(self._skeleton, pipeline)
        return StateHeader(self._fingerprint, self._skeleton.digest, begins, follows, time_ns).written(content)

    def restore(self, pipeline: Pipeline, data: bytes) -> None:
        """Give a pipeline that has taken nothing yet the state of another.

        Args:
            pipeline: of the same binding.
            data: what `dump` gave.

        Raises:
            InputError: it is damaged, or of another version or configuration; says what differs.
        """
        header, content = split(data)
        header.require(self._fingerprint, self._skeleton.digest)
        try:
            fill(self._skeleton, pipeline, content)
        except _DAMAGED as error:
            raise InputError(f"the state cannot be read ({error}); replay it with --fresh to do without") from error


def dump(pipeline: Pipeline) -> bytes:
    """Return the state of a pipeline between two runs; `Snapshots` does it again and again for less."""
    return _of(pipeline).dump(pipeline)


def restore(pipeline: Pipeline, data: bytes) -> None:
    """Give a pipeline that has taken nothing yet the state of another of the same configuration.

    Raises:
        InputError: it is damaged, or of another version or configuration; says what differs.
    """
    _of(pipeline).restore(pipeline, data)


def begun(binding: Binding, state: Path | None) -> Pipeline:
    """Return a pipeline that begins with a stored state, or with nothing where there is none.

    Raises:
        InputError: the state cannot be read, is damaged, or of another version or configuration; says what differs.
    """
    pipeline = Pipeline(binding)
    if state is not None:
        try:
            restore(pipeline, state.read_bytes())
        except InputError as error:
            raise InputError(error.message, file=state) from error
        except OSError as error:
            raise InputError(f"the state cannot be read: {error.strerror}", file=state) from error
    return pipeline


def _of(pipeline: Pipeline) -> Snapshots:
    return Snapshots(Pipeline(pipeline.binding))
