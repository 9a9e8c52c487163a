"""What the comparison of two revisions tells, and that this checkout writes twice the same."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

import pytest

from tests import digests
from tests.digests import Case, DigestsError, Outcome, Side, Verdict, choose, compare, covering, run_case
from tests.support.paths import ROOT

HERE, THERE = Side("here", ROOT), Side("revision", ROOT)
CONFIGS = HERE.shipped("*.yaml")
SCENARIOS = HERE.shipped("scenarios/*.yaml")


@pytest.fixture
def folders(tmp_path: Path) -> tuple[Path, Path]:
    """Return two folders with the same two files."""
    here, there = tmp_path / "one", tmp_path / "other"
    for folder in (here, there):
        folder.mkdir()
        (folder / "tracks.csv").write_text("time,x\n0.1,1\n0.2,2\n", encoding="utf-8")
        (folder / "summary.json").write_text("{}\n", encoding="utf-8")
    return here, there


def outcome(folders: tuple[Path, Path], leave_out: Iterable[str] = (), crashed: Iterable[str] = ()) -> Outcome:
    return Outcome(Case("some", ()), compare(*folders, leave_out=leave_out, crashed=crashed), ())


@pytest.fixture
def short(tmp_path: Path) -> Path:
    """Return a scenario of one second."""
    shipped = (ROOT / "config" / "scenarios" / "highway.yaml").read_text(encoding="utf-8")
    path = tmp_path / "short.yaml"
    path.write_text(shipped.replace("duration: 40", "duration: 1"), encoding="utf-8")
    return path


def test_equal_folders_are_equal(folders: tuple[Path, Path]) -> None:
    same = outcome(folders)
    assert same.equal
    assert str(same) == "some: equal: summary.json, tracks.csv"


def test_the_artefact_that_differs_is_told_with_its_line(folders: tuple[Path, Path]) -> None:
    (folders[1] / "tracks.csv").write_text("time,x\n0.1,1\n0.2,3\n", encoding="utf-8")
    other = outcome(folders)
    assert {name: each.verdict for name, each in other.artefacts.items()} == {
        "summary.json": Verdict.EQUAL,
        "tracks.csv": Verdict.DIFFERS,
    }
    assert not other.equal
    assert str(other) == "some: DIFFERS: tracks.csv (from line 3 on); equal: summary.json"


@pytest.mark.parametrize(
    ("content", "line"), [("time,x\n0.1,1\n", 3), ("time,x\n0.1,1\n0.2,2\n\n", 4), ("time,x\n0.1,1\n0.2,2", 3), ("", 1)]
)
def test_a_file_that_ends_earlier_or_later_differs(folders: tuple[Path, Path], content: str, line: int) -> None:
    (folders[1] / "tracks.csv").write_text(content, encoding="utf-8")
    artefact = outcome(folders).artefacts["tracks.csv"]
    assert (artefact.verdict, artefact.line) == (Verdict.DIFFERS, line)
    assert artefact.here != artefact.revision


@pytest.mark.parametrize(("missing", "verdict"), [(0, Verdict.ONLY_THERE), (1, Verdict.ONLY_HERE)])
def test_what_one_side_wrote_is_not_equal(folders: tuple[Path, Path], missing: int, verdict: Verdict) -> None:
    (folders[missing] / "tracks.csv").unlink()
    other = outcome(folders)
    assert other.artefacts["tracks.csv"].verdict is verdict
    assert not other.equal


def test_crashes_are_not_equal_even_if_they_are_alike(folders: tuple[Path, Path]) -> None:
    assert not outcome(folders, crashed={"summary.json"}).equal


def test_inputs_are_no_artefacts_and_nothing_written_is_not_equal(folders: tuple[Path, Path]) -> None:
    assert outcome(folders, leave_out={"tracks.csv"}).artefacts.keys() == {"summary.json"}
    assert not outcome(folders, leave_out={"tracks.csv", "summary.json"}).equal


def test_each_scenario_and_configuration_is_driven() -> None:
    pairs = covering(sorted(SCENARIOS), sorted(CONFIGS))
    assert {scenario for scenario, _ in pairs} == SCENARIOS
    assert {config for _, config in pairs} == CONFIGS
    assert len(set(pairs)) == len(pairs) < len(SCENARIOS) * len(CONFIGS)


@pytest.mark.parametrize(("scenarios", "configs"), [("a", "vwxyz"), ("abcde", "z"), ("abc", "yz"), ("a", "z")])
def test_unequal_numbers_are_covered(scenarios: str, configs: str) -> None:
    pairs = covering(scenarios, configs)
    assert {scenario for scenario, _ in pairs} == set(scenarios)
    assert {config for _, config in pairs} == set(configs)


def test_the_quick_cases_are_there() -> None:
    cases, skipped = choose(HERE, THERE, quick=True)
    named = [case.name for case in cases]
    assert [f"{scenario}/{config}" for scenario, config in digests.QUICK] == named[-len(digests.QUICK) :]
    assert len(cases) + len(skipped) == len(digests.QUICK) + len(digests.RECORDED)


def test_drives_that_are_missing_are_skipped_with_a_reason(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(digests, "DRIVES", tmp_path)
    cases, skipped = choose(HERE, THERE, quick=True)
    assert len(cases) == len(digests.QUICK)
    assert skipped[0] == f"recorded/toyota_rav4: there is no {tmp_path / 'drive.log.gz'}"


def test_this_checkout_equals_itself(short: Path, tmp_path: Path) -> None:
    simulate = ("simulate", str(short), "toyota_rav4", "-o", "drive.log", "--truth", "truth.csv", "--seed", "1")
    replay = ("replay", "toyota_rav4", "drive.log", "--tracks", "tracks.csv", "--summary", "summary.json")
    results = tmp_path / "results"
    same = run_case(Case("short/toyota_rav4", (simulate, replay)), HERE, THERE, results, keep=True)
    assert str(same) == (
        "short/toyota_rav4: equal: drive.log, replay.txt, simulate.txt, summary.json, tracks.csv, truth.csv"
    )
    assert same.equal
    assert "replayed in TIME" in (results / "here" / "short" / "toyota_rav4" / "replay.txt").read_text(encoding="utf-8")


def test_a_refusal_is_compared_and_ends_the_case(tmp_path: Path) -> None:
    case = Case("refused", (("replay",), ("schema",)))
    same = run_case(case, HERE, THERE, tmp_path)
    assert same.artefacts.keys() == {"replay.txt"}
    assert same.equal
    assert same.failed == ("here: replay exits 2", "revision: replay exits 2")


def test_what_one_tree_does_not_ship_is_only_in_the_other(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    case = Case("refused", (("replay",),), needs=("demo.yaml",))
    other = run_case(case, HERE, Side("revision", tmp_path / "empty"), tmp_path / "results")
    assert {each.verdict for each in other.artefacts.values()} == {Verdict.ONLY_HERE}


def test_another_candaemon_is_noticed(tmp_path: Path) -> None:
    with pytest.raises(DigestsError, match=f"not from {tmp_path}"):
        digests.candaemon(Side("here", tmp_path), ("schema",), tmp_path)


@pytest.fixture
def without_trees(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the command line compare without git."""
    monkeypatch.setattr(digests, "commit_of", lambda _: "0" * 40)
    monkeypatch.setattr(digests, "_git", lambda *_: "")
    monkeypatch.setattr(digests, "export_revision", lambda *_: None)
    monkeypatch.setattr(digests, "choose", lambda *_, **__: ([Case("one", ()), Case("two", ())], ["three: why"]))


@pytest.mark.usefixtures("without_trees")
@pytest.mark.parametrize("different", [False, True])
def test_the_command_line_tells_and_ends(
    different: bool,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    folders: tuple[Path, Path],
    tmp_path: Path,
) -> None:
    if different:
        (folders[0] / "tracks.csv").write_text("", encoding="utf-8")

    def run_it(case: Case, **_: object) -> Outcome:
        return Outcome(case, compare(*folders), ())

    monkeypatch.setattr(digests, "run_case", run_it)
    written = tmp_path / "digests.json"
    assert digests.main(["HEAD", "--jobs", "2", "--json", str(written)]) == int(different)
    lines = capsys.readouterr().out.splitlines()
    said = (
        "DIFFERS: tracks.csv (from line 1 on); equal: summary.json" if different else "equal: summary.json, tracks.csv"
    )
    assert lines[1] == "skipped: three: why"
    assert lines[3:5] == [f"one: {said}", f"two: {said}"]
    assert f"2 cases, {2 * different} not equal, 0 refused alike by both sides, 1 skipped" in lines[5]
    told = json.loads(written.read_text(encoding="utf-8"))
    assert told["equal"] is not different
    assert told["cases"]["one"]["artefacts"]["summary.json"]["verdict"] == "equal"


def test_an_unknown_revision_is_wrong_usage(capsys: pytest.CaptureFixture[str]) -> None:
    assert digests.main(["no-such-revision"]) == 2
    assert "git knows no revision 'no-such-revision'" in capsys.readouterr().err


def test_what_was_kept_is_not_overwritten(folders: tuple[Path, Path], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        digests.main(["HEAD", "--keep", str(folders[0])])
    assert "name a new or empty folder" in capsys.readouterr().err
