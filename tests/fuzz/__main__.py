"""Fuzzes from the command line.

    python -m tests.fuzz all --minutes 10 --processes 2
    python -m tests.fuzz logs --runs 30000 --plain
    python -m tests.fuzz logs --input tests/fuzz/corpus/logs/FILE
    python -m tests.fuzz pipeline --frames 10000000 --mutate LOG

The first tries every target and prints what it found; atheris steers it where it is installed (`candaemon[fuzz]`). A
finding becomes a file in `tests/fuzz/corpus/`, which the tests try from then on. The second tries inputs that depend on
the seed alone. The third tries one input. The fourth sends that many frames through the configurations.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from .farm import jobs_for, run_farm, table
from .targets import WEIGHTS, load

ALL = "all"


def main(arguments: list[str]) -> int:
    """Run what is asked for; return the exit code: 1 where something was found."""
    given = _parsed(arguments)
    if given.frames is not None:
        from .campaign_report import report

        return report(given.frames, given.seed, given.mutate, given.processes, given.parts, given.results)
    if given.input is not None:
        print(dict(load(given.target)(given.input.read_bytes())))
        return 0
    jobs = jobs_for(
        sorted(WEIGHTS) if given.target == ALL else [given.target],
        seed=given.seed,
        runs=given.runs,
        seconds=None if given.minutes is None else 60.0 * given.minutes,
        plain=given.plain,
        processes=given.processes,
        findings=given.findings,
        corpus=given.corpus,
    )
    results = run_farm(jobs, given.processes)
    print(table(results))
    return 1 if any(result.findings for result in results) else 0


def _parsed(arguments: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m tests.fuzz", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("target", choices=(ALL, *sorted(WEIGHTS)), help="what is fuzzed")
    parser.add_argument("--minutes", type=float, metavar="N", help="until the end; default: 1, unless --runs is given")
    parser.add_argument("--runs", type=int, metavar="N", help="inputs of each target")
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="of chance; default: %(default)s")
    parser.add_argument("--processes", type=int, default=1, metavar="N", help="at a time; default: %(default)s")
    parser.add_argument("--plain", action="store_true", help="without atheris: the same inputs on every machine")
    parser.add_argument("--input", type=Path, metavar="FILE", help="try this one input, and nothing else")
    parser.add_argument("--findings", type=Path, metavar="DIR", help="where findings go; default: tests/fuzz/corpus")
    parser.add_argument("--corpus", type=Path, metavar="DIR", help="where atheris keeps what reached new code")
    frames = parser.add_argument_group("frames through whole pipelines, target pipeline")
    frames.add_argument("--frames", type=int, metavar="N", help="so many altogether, through every configuration")
    frames.add_argument("--mutate", type=Path, metavar="LOG", help="a drive of the RAV4 for half of them")
    frames.add_argument("--parts", type=int, default=1, metavar="N", help="of them, each with its digest")
    frames.add_argument("--results", type=Path, metavar="FILE", help="where what is done is kept, to go on from")
    given = parser.parse_args(arguments)
    if given.target == ALL and given.input is not None:
        parser.error("--input goes with one target")
    if given.target != "pipeline" and given.frames is not None:
        parser.error("--frames goes with the target pipeline")
    if given.minutes is None and given.runs is None:
        given.minutes = 1.0
    return given


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
