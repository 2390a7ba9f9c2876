"""From the published method to ours, a row per step: python bench/ablation.py [RESULTS], after `heft run ablation`.

NAD in percent, mean over the draws of an object: each of the paper's objects, and the median of the drawn ones. Where
there is no answer, even masses count in its place.
"""

from __future__ import annotations

import sys

import numpy as np
import pandas as pd
from shared import head_table, show

from scenarios.results.estimates import load_results

AXIS = "axis.policy.kind"
STEPS = (
    ("published", "published", "hidden_states_published"),
    ("+ there and back", "published_back", "hidden_states_published"),
    ("+ beside the particle", "published_back_beside", "hidden_states_published"),
    ("+ exact minimum", "published_back_beside", "hidden_states_published_exact"),
    ("+ gripper load", "published_back_beside", "hidden_states_published_load"),
    ("+ covariance", "published_back_beside", "hidden_states"),
    ("+ twelve trials = ours", "reversed_pairs", "hidden_states"),
    ("ours on the published turns", "published", "hidden_states"),
    ("published on our trials", "reversed_pairs", "hidden_states_published"),
    ("exact minimum, our trials", "reversed_pairs", "hidden_states_published_exact"),
    ("random_search, M", "reversed_pairs", "random_search_M"),
    ("weighted_sampling, M", "reversed_pairs", "weighted_sampling_M"),
    ("explicit_state, M", "reversed_pairs", "explicit_state_M"),
    ("least squares of velocities, M", "reversed_pairs", "least_squares_velocity"),
    ("least squares, M, covariance", "reversed_pairs", "least_squares"),
)
"""Name of each row, its policy and its method."""


def even_masses(row: pd.Series) -> float:
    """NAD of even masses, which a method without an answer leaves one with."""
    true = np.array(row["true_mass_kg"])
    return float(np.abs(true - true.mean()).sum() / true.sum())


def main() -> None:
    """Print the table."""
    rows = load_results(sys.argv[1] if len(sys.argv) > 1 else "results/ablation")
    drawn = rows["object"].str.startswith("drawn_")
    named = list(dict.fromkeys(rows.loc[~drawn, "object"]))
    columns = ("", *named, f"{rows.loc[drawn, 'object'].nunique()} drawn", "answers, %", "trials", "robot s", "s")
    title = f"NAD, %: own weight, ft300s; {rows['seed'].nunique()} draws with trials of their own"
    table = head_table(*columns, left=("",), title=title)
    for name, policy, method in STEPS:
        part = rows[(rows[AXIS] == policy) & (rows["method"] == method) & (rows["status"] != "infeasible")]
        of, answered = part["object"].to_numpy(), part["nad"].notna().to_numpy()
        nad = 100 * np.where(answered, part["nad"], [even_masses(row) for _, row in part.iterrows()])
        means = {each: float(nad[of == each].mean()) for each in dict.fromkeys(of.tolist())}
        cells = [f"{means[each]:.1f}" for each in named]
        cells.append(f"{np.median([mean for each, mean in means.items() if each not in named]):.1f}")
        cells += [f"{100 * answered.mean():.0f}", f"{part['trials'].mean():.1f}", f"{part['robot_s'].mean():.0f}"]
        table.add_row(name, *cells, f"{part['seconds'].mean():.2g}")
    show(table, width=180)


if __name__ == "__main__":
    main()
