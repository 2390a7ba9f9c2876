"""Algorithm 1 beside the paper's baselines and the field's tools.

    python bench/peers.py nine [FOLDER]  all nine methods on the simulated bench: half an hour of one core

It is `heft run bench/peers.toml`, needs the extra sysid, and goes on where it was left.
"""

from __future__ import annotations

import sys
from pathlib import Path

import torch
from shared import head_table, show

from scenarios.cli.main import main as heft
from scenarios.results.estimates import load_results


def nine(folder: str) -> None:
    """Run the scenario and print a table per sensor, a row per method: NAD of every object, the rest on average."""
    heft(["run", str(Path(__file__).with_suffix(".toml")), "--out", folder])
    results = load_results(folder)
    names = list(dict.fromkeys(results["object"]))
    for sensing, rows in results.groupby("sensing", sort=False):
        first, columns = f"{sensing}: NAD, %", (*names, "MPD, cm", "s", "rollouts", "robot s")
        table = head_table(first, *columns, left=(first,), padding=(0, 1, 0, 0))
        for method, own in rows.groupby("method", sort=False):
            nads = [f"{100 * own[own['object'] == name]['nad'].mean():.1f}" for name in names]
            rest = [f"{v:.2g}" for v in (100 * own["mpd_open_loop_m"].mean(), own["seconds"].mean())]
            rest += [f"{v.mean():.0f}" for v in (own["rollouts"].fillna(0), own["robot_s"])]
            table.add_row(str(method), *nads, *rest)
        best = 100 * rows["mpd_open_loop_of_truth_m"].mean()
        table.add_row("the true masses", *[""] * len(names), f"{best:.2g}", "", "", "")
        show(table, width=120)


if __name__ == "__main__":
    torch.set_num_threads(1)
    if sys.argv[1:2] != ["nine"]:
        sys.exit(__doc__)
    nine(*sys.argv[2:] or ["results/peers"])
