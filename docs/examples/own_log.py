"""Your own logs: CSV files in your own units, imported and estimated. A recorded block stands in for your robot."""

from pathlib import Path

import numpy as np

import heft
from estimators.testing.recorded import load_block
from scenarios.cli.main import main

COLUMNS = "ms,fx,fy,fz,tx,ty,tz,x_mm,y_mm,z_mm,qw,qx,qy,qz"
MAPPING = """
object = "L2"
time = {{ column = "ms", unit = "ms" }}
sensor = {{ force = ["fx", "fy", "fz"], torque = ["tx", "ty", "tz"] }}
hand.position = ["x_mm", "y_mm", "z_mm"]
hand.position_unit = "mm"
hand.orientation = ["qw", "qx", "qy", "qz"]
tool = {{ mass_kg = {mass}, com_m = {com}, inertia_kg_m2 = {inertia}, tcp_m = {tcp} }}
setup.preset = "ideal"  # the recorded block is a simulation; state your own errors, or "lab"
"""
LOG = """
[[logs]]
file = "turn_{i}.csv"
action = {{ kind = "rotate", grasp = {a.grasp}, duration = {a.duration}, pivot = {pivot}, back = true }}
"""

turns = [t for t in load_block("L2-own_weight").trials("ft300s") if isinstance(t.action, heft.Rotate)]
tool = turns[0].tool
mapping = MAPPING.format(mass=tool.mass, com=tool.com.tolist(), inertia=tool.inertia.tolist(), tcp=tool.tcp.tolist())
for i, turn in enumerate(turns):
    pose = [1000 * turn.tcp_position, turn.sensor_orientation]
    rows = np.column_stack([1000 * turn.time_s, turn.sensor_wrench, *pose])
    np.savetxt(f"turn_{i}.csv", rows, "%.6f", ",", header=COLUMNS, comments="")
    mapping += LOG.format(i=i, a=turn.action, pivot=list(turn.action.pivot or ()))
Path("lab.toml").write_text(mapping, encoding="utf-8")

main(["import", "lab.toml", "--weight", "1.8", "--out", "results/lab"])
main(["estimate", "results/lab", "--methods", "hidden_states", "least_squares", "--workers", "0"])
