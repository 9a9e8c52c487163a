"""Where the time of a replay goes: processor time by stage."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from time import thread_time_ns
from typing import Final, ParamSpec, TypeVar

from candaemon.ego.ins import InsMotion
from candaemon.pipeline.pipeline import Pipeline

STAGES: Final = (
    "read the log",
    "order frames",
    "assemble scans",
    "ego motion",
    "scans to detections",
    "trust",
    "predict",
    "associate",
    "weigh existence",
    "update",
    "initiate, confirm, delete",
    "merge and split",
    "report obstacles",
    "calibration",
    "encode",
    "write frames",
    "write tables",
    "scores",
)
"""In the order of a frame's way."""
REST: Final = "all else"
"""Between the stages: routing of frames, the bookkeeping of a cycle, progress."""

_OF_EGO_FRAMES: Final = ("receive", "receive_judged", "judged", "judged_table", "note_judged", "pass_judged")

_Given = ParamSpec("_Given")
_Result = TypeVar("_Result")


class StageTimes:
    """Processor time of the calling thread by stage; what a stage calls of another counts for that one alone.

    Logs are decompressed beside, by other threads, which do not count.
    """

    def __init__(self) -> None:
        self._spent_ns = dict.fromkeys((*STAGES, REST), 0)
        self._stage, self._since_ns = REST, thread_time_ns()

    def seconds(self) -> dict[str, float]:
        """Return s by stage until now."""
        self._enter(self._stage)
        return {stage: spent * 1e-9 for stage, spent in self._spent_ns.items()}

    def each(self, stage: str, items: Iterable[_Result]) -> Iterator[_Result]:
        """Pass items on; making them counts for a stage."""
        source = iter(items)
        while True:
            outer = self._enter(stage)
            try:
                item = next(source)
            except StopIteration:
                return
            finally:
                self._enter(outer)
            yield item

    def watch(self, owner: object, methods: Mapping[str, str]) -> None:
        """Count what methods of an object take from here on; those that count already go on.

        Args:
            owner: whose they are.
            methods: stage by name.
        """
        for name, stage in methods.items():
            if name in vars(owner):
                continue
            setattr(owner, name, self._timed(stage, getattr(owner, name)))

    def watch_pipeline(self, pipeline: Pipeline) -> None:
        """Count what a pipeline does from here on."""
        for frames in pipeline.ego_frames.values():
            self.watch(frames, dict.fromkeys(_OF_EGO_FRAMES, "ego motion"))
        if isinstance(pipeline.ego, InsMotion):
            self.watch(pipeline.ego, {"update_together": "ego motion"})
        for assembler in pipeline.assemblers:
            self.watch(assembler, dict.fromkeys(("end_whole", "expire", "flush"), "assemble scans"))
        self.watch(pipeline.ego, {"pose": "ego motion", "learn": "ego motion"})
        for mounting in pipeline.mountings:
            self.watch(mounting, {"detections": "scans to detections"})
        self.watch(pipeline.trust, {"judged": "trust", "watch": "trust"})
        for tracker in pipeline.trackers:
            self.watch(tracker, {"step": "report obstacles", **tracker.STAGES})
        for calibrator in () if pipeline.calibrator is None else (pipeline.calibrator,):
            self.watch(calibrator, {"learn": "calibration", "corrected": "calibration"})
        if pipeline.encoder is not None:
            self.watch(pipeline.encoder, {"plan": "encode", "write_planned": "encode"})
        pipeline.counts = pipeline.counts  # frames are routed anew, to the methods that are timed

    def _timed(self, stage: str, function: Callable[_Given, _Result]) -> Callable[_Given, _Result]:
        def call(*given: _Given.args, **named: _Given.kwargs) -> _Result:
            outer = self._enter(stage)
            try:
                return function(*given, **named)
            finally:
                self._enter(outer)

        return call

    def _enter(self, stage: str) -> str:
        """Begin a stage; return the one that ends."""
        now_ns, outer = thread_time_ns(), self._stage
        self._spent_ns[outer] += now_ns - self._since_ns
        self._stage, self._since_ns = stage, now_ns
        return outer


def rows(seconds: Mapping[str, float], cycles: int) -> tuple[tuple[str, ...], ...]:
    """Return the cells of a table: stage, s, share, µs a cycle; stages that took no time are left out.

    Args:
        seconds: by stage.
        cycles: of the replay.
    """
    whole = sum(seconds.values())
    told = {stage: spent for stage, spent in seconds.items() if spent > 0.0} | {"together": whole}
    return tuple(
        (stage, f"{spent:.3f}", f"{spent / max(whole, 1e-9):.1%}", f"{spent / max(cycles, 1) * 1e6:.0f}")
        for stage, spent in told.items()
    )
