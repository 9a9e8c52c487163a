"""The state of a pipeline as bytes, and back: what a recording's files begin with.

Stored is what the stages remember (`PipelineState`); what the configuration alone decides is not. A header says of
which configuration and version it is (`header`), the rest is data that is checked piece by piece (`codec`): a state
from somebody else can bring wrong numbers, but no code, and what does not fit is refused.
"""

from __future__ import annotations

from hashlib import sha256
from pathlib import Path

from candaemon.binding.bound import Binding
from candaemon.errors import InputError
from candaemon.files.bounded import read_bounded
from candaemon.pipeline.pipeline import Pipeline
from candaemon.pipeline.pipeline_state import PipelineState
from candaemon.pipeline.saved_state.codec import MOST_BYTES, decoded, encoded, schema
from candaemon.pipeline.saved_state.fingerprint import digest, fingerprint
from candaemon.pipeline.saved_state.header import StateHeader, header_of, split

__all__ = ["Snapshots", "StateHeader", "begun", "dump", "fingerprint", "header_of", "restore"]


class Snapshots:
    """Stores the states of pipelines of one configuration.

    Args:
        binding: the configuration.

    Attributes:
        configuration: digest of what decides what the same frames lead to.
    """

    def __init__(self, binding: Binding) -> None:
        self._fingerprint = fingerprint(binding)
        self._structure = sha256(schema(PipelineState).encode()).hexdigest()[:16]
        self.configuration = digest(self._fingerprint)

    def dump(self, pipeline: Pipeline, *, begins: str = "", follows: str = "", time_ns: int = 0) -> bytes:
        """Return the state of a pipeline between two runs.

        Args:
            pipeline: of the same configuration.
            begins: why a recording's file begins with it.
            follows: the file whose end it is the state of; empty: of none.
            time_ns: of the first item that comes after it.
        """
        content = encoded(pipeline.state)
        return StateHeader(self._fingerprint, self._structure, begins, follows, time_ns).written(content)

    def restore(self, pipeline: Pipeline, data: bytes) -> None:
        """Set the state of a fresh pipeline to that of another.

        Args:
            pipeline: of the same configuration; it is of no use where the state is refused.
            data: what `dump` returned.

        Raises:
            InputError: it is damaged, or of another version or configuration; says what differs.
        """
        header, content = split(data)
        header.require(self._fingerprint, self._structure)
        try:
            pipeline.state = decoded(PipelineState, content, pipeline.state)
        except ValueError as error:
            raise InputError(f"the state cannot be read ({error}); replay it with --fresh to do without") from error


def dump(pipeline: Pipeline) -> bytes:
    """Return the state of a pipeline between two runs; `Snapshots` does it again and again for less."""
    return Snapshots(pipeline.binding).dump(pipeline)


def restore(pipeline: Pipeline, data: bytes) -> None:
    """Set the state of a fresh pipeline to that of another of the same configuration.

    Raises:
        InputError: it is damaged, or of another version or configuration; says what differs.
    """
    Snapshots(pipeline.binding).restore(pipeline, data)


def begun(binding: Binding, state: Path | None) -> Pipeline:
    """Return a pipeline that begins with a stored state, or with nothing where there is none.

    Raises:
        InputError: the state cannot be read, is damaged, or of another version or configuration; says what differs.
    """
    pipeline = Pipeline(binding)
    if state is not None:
        try:
            restore(pipeline, read_bounded(state, MOST_BYTES))
        except InputError as error:
            raise InputError(error.message, file=state) from error
        except OSError as error:
            raise InputError(
                f"the state cannot be read: {error.strerror}; use --fresh to do without", file=state
            ) from error
    return pipeline
