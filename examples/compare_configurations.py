"""Two configurations on the same drive: the IMM, and the adaptive filter of the current statistical model.

`python examples/compare_configurations.py` simulates a drive through the ESR radar, replays it with both filters, and
prints the errors of each against the truth.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from candaemon import (
    ReplayRequest,
    bind,
    evaluate,
    load_config,
    load_scenario,
    record,
    replay,
    shared_folder,
    simulate,
)

SHARED = shared_folder()

with TemporaryDirectory() as folder:
    there = Path(folder)
    shipped = (SHARED / "config" / "esr_ins.yaml").read_text(encoding="utf-8").replace("../dbc", str(SHARED / "dbc"))
    files = {"imm": there / "imm.yaml", "cs": there / "cs.yaml"}
    files["imm"].write_text(shipped, encoding="utf-8")
    files["cs"].write_text(f"{shipped}tracker: {{estimator: {{kind: cs}}}}\n", encoding="utf-8")
    bindings = {name: bind(load_config(path)) for name, path in files.items()}

    log, truth = there / "drive.log", there / "truth.csv"
    scenario = load_scenario(SHARED / "config" / "scenarios" / "highway.yaml")
    record(simulate(scenario, bindings["imm"], seed=1), bindings["imm"], log, truth)

    for name, binding in bindings.items():
        tracks = there / f"{name}.csv"
        replay(binding, ReplayRequest(log, tracks=tracks))
        errors = evaluate(tracks, truth).errors
        print(f"{name}: position {errors.position:.2f} m, velocity {errors.velocity:.2f} m/s RMSE")
