"""Fuzzes from the command line.

`python -m tests.fuzz -h` lists the targets. `python -m tests.fuzz logs --seconds 60` lets atheris look for an input
that breaks one; it comes with `pip install 'candaemon[fuzz]'`. `python -m tests.fuzz pipeline --frames 10000000
--mutate LOG` sends that many frames through the configurations.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

TARGETS = ("codec", "configuration", "dbc", "logs", "pipeline", "protection", "state")


def main(arguments: list[str]) -> int:
    """Run what is asked for; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__.partition("\n")[0])
    parser.add_argument("target", choices=TARGETS, help="what is fuzzed")
    parser.add_argument("--runs", type=int, metavar="N", help="inputs that atheris tries")
    parser.add_argument("--seconds", type=int, metavar="S", help="how long atheris tries; default: 60")
    parser.add_argument("--corpus", type=Path, metavar="DIR", help="where atheris keeps what reached new code")
    parser.add_argument("--frames", type=int, metavar="N", help="pipeline: so many frames through every configuration")
    parser.add_argument("--mutate", type=Path, metavar="LOG", help="a drive of the RAV4 for half of these frames")
    parser.add_argument("--seed", type=int, default=1, help="of chance; default: %(default)s")
    parser.add_argument("--processes", type=int, default=1, metavar="N", help="for these frames; default: %(default)s")
    parser.add_argument("--parts", type=int, default=1, metavar="N", help="of these frames, each with its digest")
    parser.add_argument("--results", type=Path, metavar="FILE", help="where what is done of these frames is kept")
    given = parser.parse_args(arguments)
    if given.frames is None:  # candaemon is imported here, for atheris to see it
        from .guided import guided

        return guided(given.target, runs=given.runs, seconds=given.seconds, corpus=given.corpus, seed=given.seed)
    if given.target != "pipeline":
        parser.error("--frames goes with the target pipeline")
    from .campaign_report import report

    return report(given.frames, given.seed, given.mutate, given.processes, given.parts, given.results)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
