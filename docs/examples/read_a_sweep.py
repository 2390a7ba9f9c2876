"""Results of a sweep with pandas: python read_a_sweep.py [results/blocks]. NAD by method and object, and its cost."""

import sys

import heft

results = heft.load_results(sys.argv[1] if len(sys.argv) > 1 else "results/blocks")
answered = results[results["status"] == "ok"]
by = ["support", "sensing", "method", "object"]
print((100 * answered.groupby(by)["nad"].median()).unstack("object").round(1).to_string())
print(answered.groupby("method")[["seconds", "robot_s", "trials"]].mean().round(2).to_string())
worst = answered.loc[answered["nad"].idxmax()]
print(
    f"worst: {worst['object']} by {worst['method']}, kg, and in truth:",
    worst["mass_kg"],
    worst["true_mass_kg"],
    sep="\n",
)
