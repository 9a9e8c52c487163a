"""Comparing two runs: a seeded regression is found, chance is not, and bytes are told from figures."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from candaemon.cli.main import main
from candaemon.errors import InputError
from candaemon.fleet import fleet_figures
from candaemon.fleet.comparison import LEVEL, compare, markdown, sentences
from candaemon.fleet.fleet_figures import DriveFigures, FleetFigures, load_figures
from candaemon.fleet.paired_test import EXACT_UP_TO, fewest_pairs, holm, paired_difference

KEYS = ("predictions.x.0.5", "predictions.y.0.5", "predictions.x.1", "predictions.y.1", "stationary.speed", "nis.off")


def fleet(seed: int, factor: float = 1.0, noise: float = 0.0, drives: int = 40) -> FleetFigures:
    """Return drives that differ from one another by far more than a change does."""
    level = np.random.default_rng(7).lognormal(0.0, 0.5, (drives, len(KEYS)))
    found = level * (1.0 + noise * np.random.default_rng(seed).standard_normal(level.shape))
    found[:, 2] *= factor
    return FleetFigures(
        {
            f"d{k:03d}": DriveFigures(f"d{k:03d}", dict(zip(KEYS, row, strict=True)), "same", {"tracks": f"{seed}-{k}"})
            for k, row in enumerate(found.tolist())
        }
    )


def test_a_regression_of_3_percent_over_40_drives_is_found() -> None:
    found = compare(fleet(1), fleet(2, 1.03, 0.02))
    (worse,) = found.regressions
    assert worse is found.figures[0]
    assert worse.key == "predictions.x.1"
    assert worse.low < 0.03 < worse.high
    assert worse.p < 0.001


def test_between_runs_that_differ_by_chance_nothing_is_found() -> None:
    """The family's errors stay below their level: of 50 pairs of runs, 2.5 on average at most."""
    wrong = sum(bool(compare(fleet(k), fleet(1000 + k, 1.0, 0.02, 12)).regressions) for k in range(50))
    assert wrong <= 8


def test_two_runs_of_the_same_are_the_same_to_the_byte() -> None:
    found = compare(fleet(1), fleet(1))
    assert not found.regressions
    assert (len(found.same_bytes), found.same_figures, found.changed) == (40, (), ())
    other = compare(fleet(1), fleet(2))
    assert (other.same_bytes, len(other.same_figures), other.changed) == ((), 40, ())


def test_improvements_and_what_has_no_better_are_told_apart() -> None:
    before, after = fleet(1), fleet(2, 0.9)
    for run, count in ((before, 10.0), (after, 12.0)):
        for each in run.drives.values():
            each.values["tracks.confirmed"] = count  # type: ignore[index]
    verdicts = {each.key: each.verdict for each in compare(before, after).figures}
    assert verdicts["predictions.x.1"] == "better"
    assert verdicts["tracks.confirmed"] == "different"
    assert verdicts["predictions.y.1"] == "no difference"


def test_drives_with_other_logs_or_in_one_run_alone_are_not_compared() -> None:
    before, after = fleet(1), fleet(2)
    changed = dict(after.drives)
    del changed["d000"]
    changed["d001"] = DriveFigures("d001", {}, "other")
    found = compare(before, FleetFigures({**changed, "new": changed["d002"]}, {"d000": "no such log"}))
    assert found.missing == {"d000": "no such log"}
    assert (found.other_logs, found.added) == (("d001",), ("new",))
    assert found.figures[0].drives == 38


def test_a_change_below_the_least_one_is_none() -> None:
    assert not compare(fleet(1), fleet(2, 1.0009)).regressions
    assert compare(fleet(1), fleet(2, 1.0011)).regressions


def test_markdown_puts_regressions_first_and_escapes() -> None:
    text = markdown(compare(fleet(1), fleet(2, 1.2)), "a|b", "<b>")
    assert "a\\|b" in text
    assert "<b>" not in text
    rows = [line for line in text.splitlines() if "**worse**" in line]
    assert rows[0].startswith("| error of predictions forward, 1 s ahead (m) |")
    assert "+20.00 %" in rows[0]


def test_the_test_is_exact_for_few_pairs_and_near_it_for_more() -> None:
    assert paired_difference(np.ones(5)).p == pytest.approx(2 / 2**5)
    assert paired_difference(np.zeros(5)).p == 1.0
    values = np.array([3.0, -1.0, 2.0, 5.0, 4.0, -2.0, 1.0, 6.0, 2.5, 0.5, 1.5, -0.5, 3.5, 2.0])
    exact = paired_difference(values)
    assert len(values) == EXACT_UP_TO
    drawn = paired_difference(np.append(values, 0.0))  # a pair that does not differ says nothing
    assert drawn.p == pytest.approx(exact.p, abs=0.002)
    assert exact.low < exact.mean < exact.high


def test_holm_corrects_for_the_number_of_figures() -> None:
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert holm([]) == []


@pytest.mark.parametrize("figures", [1, 6, 12, 13, 48])
def test_the_fewest_pairs_are_those_from_which_on_a_figure_can_differ(figures: int) -> None:
    fewest = fewest_pairs(figures, LEVEL)
    same = [1.0] * (figures - 1)
    assert holm([paired_difference(np.ones(fewest)).p, *same])[0] < LEVEL
    assert holm([paired_difference(np.ones(fewest - 1)).p, *same])[0] >= LEVEL


def test_what_is_said_of_few_drives_is_what_the_test_finds() -> None:
    few, enough = (compare(fleet(1, drives=drives), fleet(2, 1.2, drives=drives)) for drives in (7, 8))
    told = "So few drives cannot tell a change of one of 6 figures from chance; 8 or more can."
    assert not few.regressions
    assert told in sentences(few)
    assert enough.regressions
    assert told not in sentences(enough)


def written(path: Path, figures: FleetFigures) -> str:
    path.write_text(json.dumps(figures.to_json()), encoding="utf-8")
    return str(path)


def test_the_command_fails_on_what_it_is_told_to(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a, b = written(tmp_path / "a.json", fleet(1)), written(tmp_path / "b.json", fleet(2, 1.03))
    assert main(["fleet", "compare", a, b]) == 0
    assert main(["fleet", "compare", a, b, "--fail-on", "missing,drive"]) == 0
    capsys.readouterr()
    assert main(["fleet", "compare", a, b, "--fail-on", "regression", "--json", str(tmp_path / "c.json")]) == 1
    out, err = capsys.readouterr()
    assert out.startswith("1 of 6 figures worse over 40 drives")
    assert "--fail-on: found regression" in err
    assert json.loads((tmp_path / "c.json").read_text(encoding="utf-8"))["figures"][0]["verdict"] == "worse"
    assert main(["fleet", "compare", a, b, "--fail-on", "drive", "--tolerance", "2"]) == 1
    assert main(["fleet", "compare", a, b, "--fail-on", "regression", "--least", "4"]) == 0
    assert main(["fleet", "compare", a, a, "--fail-on", "bytes,difference,missing"]) == 0
    assert main(["fleet", "compare", a, b, "--fail-on", "bytes", "--markdown"]) == 1


def test_a_comparison_replaces_nothing_that_it_reads(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a, b = written(tmp_path / "a.json", fleet(1)), written(tmp_path / "b.json", fleet(2))
    before = Path(a).read_bytes()
    assert main(["fleet", "compare", a, b, "--json", a]) == 2
    assert "it is read too" in capsys.readouterr().err
    assert Path(a).read_bytes() == before


def test_a_report_of_a_file_of_figures_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a = written(tmp_path / "a.json", fleet(1))
    assert main(["fleet", "report", a, "-o", str(tmp_path / "a.html")]) == 1
    assert f"{a}: it is a file" in capsys.readouterr().err


def test_a_file_of_figures_has_a_longest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.json"
    size = len(written(path, fleet(1)) and path.read_bytes())
    monkeypatch.setattr(fleet_figures, "LARGEST_FIGURES", size)
    assert len(load_figures(str(path)).drives) == 40
    monkeypatch.setattr(fleet_figures, "LARGEST_FIGURES", size - 1)
    with pytest.raises(InputError, match="longer than"):
        load_figures(str(path))


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"form": "other", "drives": [], "failed": {}}'])
def test_what_holds_no_figures_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.json").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match="no figures of a fleet"):
        load_figures(str(tmp_path / "a.json"))
    with pytest.raises(InputError, match="no drive"):
        load_figures(str(tmp_path))


def without(run: FleetFigures, *drives: str) -> FleetFigures:
    """Return a run in which some drives have no figures of obstacles."""
    gone = {name: replace(each, values={}, files={}) for name, each in run.drives.items() if name in drives}
    return FleetFigures({**run.drives, **gone})


def test_a_figure_that_is_gone_is_worse(tmp_path: Path) -> None:
    """As where nothing is tracked any longer: nothing is predicted wrongly then."""
    before = fleet(1, drives=4)
    nothing = compare(before, without(before, *before.drives))
    assert {each.key for each in nothing.regressions} == set(KEYS)
    assert "| 0.2" in markdown(nothing, "A", "B") or "none" in markdown(nothing, "A", "B")
    partly = compare(before, without(before, "d002"))
    assert not partly.regressions
    assert {each.drive for each in partly.worse_drives} == {"d002"}
    assert "none" in markdown(partly, "A", "B")
    a, b = written(tmp_path / "a.json", before), written(tmp_path / "b.json", without(before, "d002"))
    assert main(["fleet", "compare", a, b, "--fail-on", "regression"]) == 0
    assert main(["fleet", "compare", a, b, "--fail-on", "drive"]) == 1


@pytest.mark.parametrize(
    ("key", "before", "after", "worse"),
    [
        ("nis.off", 0.217, 0.928, True),
        ("nis.off", 0.01, 0.09, False),
        ("losses", 0.0, 500.0, True),
        ("losses", 0.1, 0.9, False),
        ("cycles.without_ego", 0.0, 200.0, True),
        ("duplicates.share", 0.0, 0.004, False),
        ("stationary.speed", 0.0, 0.1, True),
        ("stationary.speed", 0.2, 0.21, False),
    ],
)
def test_a_drive_is_worse_by_what_matters_of_shares_and_counts_too(
    key: str, before: float, after: float, worse: bool
) -> None:
    one, other = (FleetFigures({"d": DriveFigures("d", {key: value}, "same")}) for value in (before, after))
    assert bool(compare(one, other).worse_drives) == worse
    assert not compare(other, one).worse_drives


def test_drives_that_count_twice_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`drive` was `mon/drive.log` until `tue/drive.log` came, and is `mon-drive` from then on."""
    one = DriveFigures("drive", {"nis.off": 0.1}, "aaaa", configuration="a.yaml")
    others = [replace(one, drive="mon-drive"), replace(one, drive="tue-drive", inputs="bbbb")]
    others.append(replace(one, drive="mon-drive-of-b", configuration="b.yaml"))
    run = FleetFigures({each.drive: each for each in (one, *others)})
    assert run.twice == [("drive", "mon-drive")]
    path = written(tmp_path / "a.json", run)
    assert main(["fleet", "compare", path, path]) == 0
    assert f"warning: drives drive, mon-drive of {path} are the same logs" in capsys.readouterr().err
