"""Your own logs: CSV files in your own units, imported and estimated.

The files stand in for yours: they come from a recorded block, with an FT-300S's errors.
"""

from pathlib import Path

import numpy as np

import heft
from estimators.testing.recorded import load_block
from scenarios.cli.main import main

COLUMNS = "ms,fx,fy,fz,tx,ty,tz,x_mm,y_mm,z_mm,qw,qx,qy,qz"
MAPPING = """
object = "L2"
time = {{ column = "ms", unit = "ms" }}

[sensor]
force = ["fx", "fy", "fz"]
torque = ["tx", "ty", "tz"]

[hand]
position = ["x_mm", "y_mm", "z_mm"]
position_unit = "mm"
orientation = ["qw", "qx", "qy", "qz"]
orientation_as = "wxyz"
closing_deg = 0

[tool]
mass_kg = {tool.mass}
com_m = {com}
inertia_kg_m2 = {inertia}
tcp_m = {tcp}
"""
LOG = """
[[logs]]
file = "{file}"
action = {{ kind = "rotate", grasp = {a.grasp}, duration = {a.duration}, pivot = {pivot}, back = true }}
"""


def write_logs() -> None:
    """Four turns and their mapping, in the current folder."""
    turns = [t for t in load_block("L2-own_weight").trials("ft300s") if isinstance(t.action, heft.Rotate)]
    tool = turns[0].tool
    text = MAPPING.format(tool=tool, com=tool.com.tolist(), inertia=tool.inertia.tolist(), tcp=tool.tcp.tolist())
    for i, turn in enumerate(turns):
        pose = [1000 * turn.tcp_position, turn.sensor_orientation]
        rows = np.column_stack([1000 * turn.time_s, turn.sensor_wrench, *pose])
        np.savetxt(f"turn_{i}.csv", rows, "%.6f", ",", header=COLUMNS, comments="")
        text += LOG.format(file=f"turn_{i}.csv", a=turn.action, pivot=list(turn.action.pivot or ()))
    Path("lab.toml").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    write_logs()
    main(["import", "lab.toml", "--weight", "1.8", "--out", "results/lab"])
    main(["estimate", "results/lab", "--methods", "hidden_states", "least_squares", "--workers", "0"])
