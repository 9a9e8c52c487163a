"""What the documentation asks of a run's tables in SQL is answered."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from tests.support.fleets import run_inline, short_drives, simulated
from tests.support.paths import ROOT

duckdb = pytest.importorskip("duckdb")
PAGE = (ROOT / "docs" / "fleet.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```sql\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
QUERIES = [query for block in BLOCKS for query in re.findall(r"[^;]+(?=;)", block)]


def test_queries_of_the_page_are_answered(tmp_path: Path) -> None:
    logs = short_drives(tmp_path / "logs", 3, simulated(tmp_path))
    manifest = tmp_path / "manifest.csv"
    rows = [f"{log},weather={'rain' if number else 'dry'}" for number, log in enumerate(logs)]
    manifest.write_text("\n".join(["log,tags", *rows]), encoding="utf-8")
    assert run_inline([], tmp_path / "monday", manifests=[manifest]).computed == 3
    answers = [duckdb.sql(query.replace("monday/", f"{tmp_path}/monday/")).fetchall() for query in QUERIES]
    by_drive, by_weather, ((cores, overhead, size),) = answers
    assert sorted(drive for drive, _ in by_drive) == ["d000", "d001", "d002"]
    assert {weather for weather, _ in by_weather} == {"rain", "dry"}
    assert cores > 0
    assert overhead > 0
    written = sum(path.stat().st_size for path in (tmp_path / "monday").rglob("*.parquet"))
    records = [json.loads(path.read_text(encoding="utf-8")) for path in (tmp_path / "monday" / "records").iterdir()]
    assert size == pytest.approx(written / sum(record["duration"] for record in records))
