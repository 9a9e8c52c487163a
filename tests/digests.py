"""Compares what this checkout writes with what another git revision writes: `python -m tests.digests REV`.

Both trees run on this machine with this interpreter, by their command lines alone, so that modules may have moved
between them. Each case is a few commands in a folder of its own; every file that they write is compared byte for byte,
and so is what they print, without paths and times. The checkout is taken as it is, with what is not committed.

The exit code is 0 if everything is equal, 1 if anything differs, 2 for wrong usage.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tarfile
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from itertools import zip_longest
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

ROOT = Path(__file__).resolve().parents[1]
DRIVES = ROOT.parent / "shared" / "data" / "rav4_drive"

RECORDED = (("drive.log.gz", "toyota_rav4"), ("drive_with_ins.log.gz", "toyota_rav4_ins"))
"""The recorded drives, each with its configuration; the last one is smoothed too."""
QUICK = (("automotive_turn", "esr_ins_fd"), ("turning_ego", "demo"), ("intersection", "ars408"))
"""Scenarios and configurations of --quick: short drives, different sensors and outputs."""
LONG_EXPERIMENTS = frozenset({"004-noise-sweep", "004-table-4"})
"""Experiments that only --full runs: over a third of the time of all, and the other sweep and tables are alike."""
RUNS = 3  # of each experiment
SEED = 1
RINGS = 2  # without --full each scenario is driven with so many configurations, or more

_WRONG_TREE = 86  # exit code
_INTERRUPTED = 130  # likewise
_LAUNCHER = f"""
import runpy, sys
from pathlib import Path
tree = Path(sys.argv.pop(1))
import candaemon
if Path(str(candaemon.__file__)).resolve().parent != tree / "candaemon":
    print(f"candaemon was imported from {{candaemon.__file__}}, not from {{tree}}", file=sys.stderr)
    sys.exit({_WRONG_TREE})
runpy.run_module("candaemon", run_name="__main__", alter_sys=True)
"""
"""`python -m candaemon`, but not from an installed package."""
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
_SURROUNDINGS = {**_ONE_THREAD, "COLUMNS": "200", "PYTHONHASHSEED": "0", "PYTHONUTF8": "1", "TZ": "UTC"}

_TIMES = re.compile(r"(?<=replayed in )[\d.]+ s, [\d,.]+ frames/s")
_TRACEBACK = "Traceback (most recent call last)"


class DigestsError(Exception):
    """The comparison cannot be made."""


class Verdict(StrEnum):
    """What became of an artefact."""

    CRASHED = "CRASHED"
    DIFFERS = "DIFFERS"
    ONLY_HERE = "only here"
    ONLY_THERE = "only in the revision"
    EQUAL = "equal"


@dataclass(frozen=True, slots=True)
class Side:
    """One of the two trees.

    Attributes:
        name: `here` or `revision`.
        tree: folder that holds `candaemon/`, `config/` and `dbc/`.
    """

    name: str
    tree: Path

    def shipped(self, pattern: str) -> set[str]:
        """Return the names of shipped files below `config/`."""
        return {path.stem for path in (self.tree / "config").glob(pattern)}


@dataclass(frozen=True, slots=True)
class Case:
    """Commands whose results are compared.

    Attributes:
        name: also that of its folder.
        steps: the arguments of candaemon, in order; a step that fails is the last.
        inputs: files that the steps find in their folder.
        needs: shipped files below `config/`; a tree without them does not run the case.
    """

    name: str
    steps: tuple[tuple[str, ...], ...]
    inputs: tuple[Path, ...] = ()
    needs: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Artefact:
    """A file that one side or both wrote.

    Attributes:
        verdict: of the comparison.
        here: SHA-256 of this checkout's; None: there is none.
        revision: SHA-256 of the revision's; None: there is none.
        line: first line that differs, from 1.
    """

    verdict: Verdict
    here: str | None
    revision: str | None
    line: int | None = None


@dataclass(frozen=True, slots=True)
class Outcome:
    """A case after both sides have run it.

    Attributes:
        case: which one.
        artefacts: by file name.
        failed: steps that did not end with exit code 0, such as `here: simulate exits 2`.
    """

    case: Case
    artefacts: dict[str, Artefact]
    failed: tuple[str, ...]

    @property
    def equal(self) -> bool:
        """Whether both sides wrote something, and the same."""
        return bool(self.artefacts) and all(each.verdict is Verdict.EQUAL for each in self.artefacts.values())

    def __str__(self) -> str:
        """Return the outcome as a line, what differs first."""
        groups = []
        for verdict in Verdict:
            names = [_with_line(name, each) for name, each in self.artefacts.items() if each.verdict is verdict]
            if names:
                groups.append(f"{verdict}: {', '.join(names)}")
        told = "; ".join(groups) or "DIFFERS: neither side wrote anything"
        return f"{self.case.name}: {told}" + (f" ({'; '.join(self.failed)})" if self.failed else "")


def main(arguments: Sequence[str]) -> int:
    """Compare; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.digests", description=str(__doc__).partition("\n")[0])
    parser.add_argument("revision", metavar="REV", help="git revision that this checkout is compared with")
    parser.add_argument("--json", type=Path, metavar="F", help="all digests and verdicts, for programs")
    parser.add_argument(
        "--jobs", type=_positive, default=os.cpu_count() or 1, metavar="N", help="cases at once; default: %(default)s"
    )
    parser.add_argument("--keep", type=Path, metavar="DIR", help="new folder for what both sides write")
    size = parser.add_mutually_exclusive_group()
    size.add_argument("--quick", action="store_true", help="recorded drives and three simulated ones only")
    size.add_argument("--full", action="store_true", help="every scenario with every configuration; all experiments")
    given = parser.parse_args(arguments)
    if given.keep is not None and given.keep.exists() and (not given.keep.is_dir() or any(given.keep.iterdir())):
        parser.error(f"--keep {given.keep}: it is there already; name a new or empty folder")
    if given.json is not None and (given.json.is_dir() or not given.json.parent.is_dir()):
        parser.error(f"--json {given.json}: cannot be written; name a file in a folder that exists")
    try:
        return run(given)
    except DigestsError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return _INTERRUPTED


def _positive(text: str) -> int:
    """Read a whole number over 0."""
    if not (text.isascii() and text.isdigit() and int(text)):
        raise argparse.ArgumentTypeError(f"found '{text}', expected a whole number over 0")
    return int(text)


def run(given: argparse.Namespace) -> int:
    """Export both trees, run all cases on them and print what came of it; return the exit code."""
    began = time.monotonic()
    with TemporaryDirectory(prefix="digests-") as temporary:
        scratch = Path(temporary).resolve()
        commit = commit_of(given.revision)
        here, there = Side("here", scratch / "here"), Side("revision", scratch / "revision")
        export_checkout(here.tree)
        export_revision(commit, there.tree)
        head = commit_of("HEAD") + (" with changes" if _git("status", "--porcelain") else "")
        print(f"here: {head}; revision: {commit}", flush=True)
        cases, skipped = choose(here, there, quick=given.quick, full=given.full)
        for reason in skipped:
            print(f"skipped: {reason}", flush=True)
        if not given.full:
            print(f"{len(cases)} cases, not all there are: --full runs every one", flush=True)
        results = scratch / "results" if given.keep is None else given.keep.resolve()
        outcomes = list(_shown(cases, here, there, results, given.jobs, keep=given.keep is not None))
    counts = Counter(each.verdict for outcome in outcomes for each in outcome.artefacts.values())
    unequal = sum(not outcome.equal for outcome in outcomes)
    failed = sum(outcome.equal and bool(outcome.failed) for outcome in outcomes)
    if given.json is not None:
        tree = {
            "here": head,
            "revision": commit,
            "equal": not unequal,
            "skipped": skipped,
            "cases": {outcome.case.name: _for_json(outcome) for outcome in outcomes},
        }
        given.json.write_text(json.dumps(tree, indent=2) + "\n", encoding="utf-8")
    print(
        f"{len(outcomes)} cases, {unequal} not equal, {failed} refused alike by both sides, {len(skipped)} skipped; "
        f"artefacts: {', '.join(f'{counts[verdict]} {verdict}' for verdict in Verdict if counts[verdict])}; "
        f"{time.monotonic() - began:.0f} s"
    )
    if unequal and given.keep is None:
        print("--keep DIR keeps what both sides wrote")
    return 1 if unequal else 0


def _shown(
    cases: Sequence[Case], here: Side, there: Side, results: Path, jobs: int, *, keep: bool
) -> Iterator[Outcome]:
    """Run cases, several at once; print and yield their outcomes in order."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    bar = Progress(
        *columns,
        console=console,
        disable=not console.is_terminal,
        transient=True,
        redirect_stdout=sys.stdout.isatty(),  # else the lines would go to standard error with it
    )
    compare_case = partial(run_case, here=here, there=there, results=results, keep=keep)
    with ThreadPoolExecutor(jobs) as pool, bar:
        task = bar.add_task("cases", total=len(cases))
        for outcome in pool.map(compare_case, cases):
            print(outcome, flush=True)
            bar.advance(task)
            yield outcome


def _with_line(name: str, artefact: Artefact) -> str:
    """Return an artefact's name, and the line from which on it differs."""
    return name if artefact.line is None else f"{name} (from line {artefact.line} on)"


def _for_json(outcome: Outcome) -> dict[str, Any]:
    """Return an outcome for JSON."""
    artefacts = {
        name: {"verdict": str(each.verdict), "here": each.here, "revision": each.revision, "line": each.line}
        for name, each in outcome.artefacts.items()
    }
    return {"equal": outcome.equal, "failed": list(outcome.failed), "artefacts": artefacts}


# What is compared


def choose(here: Side, there: Side, *, quick: bool = False, full: bool = False) -> tuple[list[Case], list[str]]:
    """Return the cases, and why some are left out.

    What only one of the trees ships is a case too.

    Args:
        here: this checkout.
        there: the revision.
        quick: the recorded drives and three simulated ones only.
        full: every scenario with every configuration, and all experiments.
    """
    configs = sorted(here.shipped("*.yaml") | there.shipped("*.yaml"))
    scenarios = sorted(here.shipped("scenarios/*.yaml") | there.shipped("scenarios/*.yaml"))
    if not configs or not scenarios:
        raise DigestsError(f"no configurations or no scenarios in {here.tree} and {there.tree}")
    cases, skipped = recorded(configs, smoothed=not quick)
    if not quick:
        experiments = sorted(_experiments(here) | _experiments(there))
        if not experiments:
            raise DigestsError("neither side's `papers --list` tells any experiments")
        cases += [experiment(name) for name in experiments if full or name not in LONG_EXPERIMENTS]
    if quick:
        pairs = [(scenario, config) for scenario, config in QUICK if scenario in scenarios and config in configs]
        missing = [pair for pair in QUICK if pair not in pairs]
        skipped += [f"{scenario}/{config}: neither tree has one of the two" for scenario, config in missing]
    elif full:
        pairs = [(scenario, config) for scenario in scenarios for config in configs]
    else:
        pairs = covering(scenarios, configs)
    return cases + [simulated(scenario, config) for scenario, config in pairs], skipped


def covering(scenarios: Sequence[str], configs: Sequence[str]) -> list[tuple[str, str]]:
    """Return pairs that hold each scenario and each configuration, `RINGS` times where there are enough others."""
    pairs: dict[tuple[str, str], None] = {}
    for ring in range(RINGS):
        for k in range(max(len(scenarios), len(configs))):
            pairs[scenarios[k % len(scenarios)], configs[(k + ring * len(configs) // RINGS) % len(configs)]] = None
    return sorted(pairs)


def recorded(configs: Iterable[str], *, smoothed: bool) -> tuple[list[Case], list[str]]:
    """Return the cases of the recorded drives, and why some are left out.

    Args:
        configs: those that one of the trees has.
        smoothed: whether the last drive is smoothed too.
    """
    cases, skipped = [], []
    known = set(configs)
    for log, config in RECORDED:
        name, path = f"recorded/{config}", DRIVES / log
        if not path.is_file():
            skipped.append(f"{name}: there is no {path}")
        elif config not in known:
            skipped.append(f"{name}: neither tree has the configuration")
        else:
            cases.append(Case(name, (_replay(config, log),), (path,), (f"{config}.yaml",)))
    if smoothed and cases:
        log, config = RECORDED[-1]
        step = ("replay", config, log, "--tracks", "tracks.csv", "--smooth", "1")
        if any(case.name == f"recorded/{config}" for case in cases):
            cases.append(Case(f"smoothed/{config}", (step,), (DRIVES / log,), (f"{config}.yaml",)))
    return cases, skipped


def simulated(scenario: str, config: str) -> Case:
    """Return the case of a simulated drive."""
    simulate = ("simulate", scenario, config, "-o", "drive.log", "--truth", "truth.csv", "--seed", str(SEED))
    steps = (simulate, _replay(config, "drive.log"))
    return Case(f"{scenario}/{config}", steps, needs=(f"scenarios/{scenario}.yaml", f"{config}.yaml"))


def experiment(name: str) -> Case:
    """Return the case of a paper's experiment."""
    step = ("papers", name, "--json", "papers.json", "--runs", str(RUNS), "--seed", str(SEED))
    return Case(f"papers/{name}", (step,))


def _replay(config: str, log: str) -> tuple[str, ...]:
    """Return the arguments that replay a log and write all there is."""
    written = ("-o", "obstacles.log", "--tracks", "tracks.csv", "--predictions", "predictions.csv")
    return ("replay", config, log, *written, "--summary", "summary.json")


def _experiments(side: Side) -> set[str]:
    """Return the papers' experiments that a tree has; none if it cannot tell."""
    with TemporaryDirectory(prefix="digests-") as folder:
        done = candaemon(side, ("papers", "--list"), Path(folder))
    return set(re.findall(r"^\s*(\d{3}-[\w-]+)", done.stdout, re.MULTILINE)) if done.returncode == 0 else set()


# Running


def run_case(case: Case, here: Side, there: Side, results: Path, *, keep: bool = False) -> Outcome:
    """Run a case on both trees and compare.

    Args:
        case: what is run.
        here: this checkout.
        there: the revision.
        results: folder for what is written, a folder for each side and case.
        keep: whether it stays.
    """
    folders, failed, crashed = [], [], set()
    for side in (here, there):
        folder = results / side.name / case.name
        folder.mkdir(parents=True)
        folders.append(folder)
        if not all((side.tree / "config" / name).is_file() for name in case.needs):
            continue
        for path in case.inputs:
            (folder / path.name).symlink_to(path)
        for step in case.steps:
            done = candaemon(side, step, folder)
            (folder / f"{step[0]}.txt").write_text(_told(done, side, folder), encoding="utf-8")
            if done.returncode != 0:
                failed.append(f"{side.name}: {step[0]} exits {done.returncode}")
                if done.returncode not in (1, 2) or _TRACEBACK in done.stderr:
                    crashed.add(f"{step[0]}.txt")
                break
    artefacts = compare(*folders, leave_out={path.name for path in case.inputs}, crashed=crashed)
    if not keep:
        for folder in folders:
            shutil.rmtree(folder)
    return Outcome(case, artefacts, tuple(failed))


def candaemon(side: Side, arguments: Sequence[str], folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a tree's candaemon in a folder.

    Raises:
        DigestsError: another candaemon was imported, or Ctrl-C ended it.
    """
    done = subprocess.run(
        [sys.executable, "-P", "-c", _LAUNCHER, str(side.tree), *arguments],
        cwd=folder,
        env={**os.environ, **_SURROUNDINGS, "PYTHONPATH": str(side.tree)},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        encoding="utf-8",
        check=False,
    )
    if done.returncode == _WRONG_TREE:
        raise DigestsError(done.stderr.strip())
    if done.returncode in (-signal.SIGINT, _INTERRUPTED):
        raise DigestsError("interrupted")
    return done


def _told(done: subprocess.CompletedProcess[str], side: Side, folder: Path) -> str:
    """Return a command's exit code and what it printed, without paths and times."""
    text = f"exit code {done.returncode}\n\nstandard output:\n{done.stdout}\nstandard error:\n{done.stderr}"
    return _TIMES.sub("TIME", text.replace(str(side.tree), "TREE").replace(str(folder), "FOLDER"))


def compare(
    here: Path, there: Path, *, leave_out: Iterable[str] = (), crashed: Iterable[str] = ()
) -> dict[str, Artefact]:
    """Compare the files of two folders.

    Args:
        here: what this checkout wrote.
        there: what the revision wrote.
        leave_out: names of files that are not compared.
        crashed: names of files that are no good even if they are equal.

    Returns:
        Every file of either folder, by name.
    """
    names = {path.name for folder in (here, there) for path in folder.iterdir()} - set(leave_out)
    unsound = set(crashed)
    return {name: _compared(here / name, there / name, crashed=name in unsound) for name in sorted(names)}


def _compared(here: Path, there: Path, *, crashed: bool) -> Artefact:
    """Compare two files, of which one may not exist."""
    mine, theirs = (path.read_bytes() if path.is_file() else None for path in (here, there))
    line = None
    if crashed:
        verdict = Verdict.CRASHED
    elif theirs is None:
        verdict = Verdict.ONLY_HERE
    elif mine is None:
        verdict = Verdict.ONLY_THERE
    elif mine == theirs:
        verdict = Verdict.EQUAL
    else:
        verdict = Verdict.DIFFERS
        lines = zip_longest(mine.splitlines(keepends=True), theirs.splitlines(keepends=True))
        line = next(number for number, (one, other) in enumerate(lines, start=1) if one != other)
    return Artefact(verdict, _digest(mine), _digest(theirs), line)


def _digest(content: bytes | None) -> str | None:
    """Return the SHA-256 of a file, if there is one."""
    return None if content is None else hashlib.sha256(content).hexdigest()


# Trees


def commit_of(revision: str) -> str:
    """Return the commit that a revision names.

    Raises:
        DigestsError: there is none.
    """
    try:
        return _git("rev-parse", "--verify", "--quiet", "--end-of-options", f"{revision}^{{commit}}").strip()
    except DigestsError as error:
        raise DigestsError(f"git knows no revision '{revision}' in {ROOT}") from error


def export_checkout(folder: Path) -> None:
    """Copy this checkout as it is, without what git ignores: it may change while the comparison runs."""
    for name in _git("ls-files", "--cached", "--others", "--exclude-standard", "-z").split("\0"):
        if name and (ROOT / name).is_file():
            target = folder / name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, target)


def export_revision(commit: str, folder: Path) -> None:
    """Write the files of a commit into a folder."""
    packed = folder.with_suffix(".tar")
    _git("archive", "--format=tar", f"--output={packed}", commit)
    with tarfile.open(packed) as archive:
        archive.extractall(folder, filter="data")
    packed.unlink()


def _git(*arguments: str) -> str:
    """Run git in this checkout and return what it prints.

    Raises:
        DigestsError: git failed.
    """
    done = subprocess.run(
        ["git", "--no-optional-locks", "-C", str(ROOT), *arguments], capture_output=True, encoding="utf-8", check=False
    )
    if done.returncode != 0:
        raise DigestsError(f"git {arguments[0]} failed: {done.stderr.strip() or f'exit code {done.returncode}'}")
    return done.stdout


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
