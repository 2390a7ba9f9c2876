"""Mistakes of a mapping, and what is said of each: python bench/mistakes.py [--draws N].

Four turns there and back and three accelerated ones of L2 on its own weight, recorded in simulation, with the noise of
an FT-300S, are written as another bench's logs. Each mistake is made in the mapping or the logs, which are imported and
estimated. A row: what `heft import` and `heft estimate` say first; status, misfit and NAD of `support_aware`; and the
largest error of a mass over its claimed error in any draw. SILENT: nothing is said, the status is ok, and it is over 3.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from rich.console import Console
from scipy.spatial.transform import Rotation
from shared import head_table, parser_of

from estimators.registry import build_method
from estimators.testing.recorded import KnownBlock, load_block
from scenarios.results.logs import import_logs
from scenarios.views.weight_check import check_weight
from testbed.errors import HeftError
from testbed.robot.calibration.motion import wrong_motion
from tests.fakes.lab_bench import MOUNT, entry_of, mapping_of, write_csv, write_toml

Fields = dict[str, Any]
MOST = 90
"""Characters of a sentence that are shown."""
MIRRORED = 'name = "L2"\n[blocks]\nlayout = ["001", "001", "001", "111"]\n'
LARGER = 'name = "L2"\n[blocks]\nlayout = ["1", "1", "1", "111"]\nsize_m = 0.055\n'
FORCES, TORQUES = ["fx", "fy", "fz"], ["tx", "ty", "tz"]


def in_mapping(table: str, **fields: Any) -> Callable[[Fields], None]:
    """Change of a mapping's table."""
    return lambda mapping: mapping[table].update(fields)


def added(table: str, field: str, more: float) -> Callable[[Fields], None]:
    """Change of a number in a mapping's table."""
    return lambda mapping: mapping[table].update({field: mapping[table][field] + more})


def at_speed(speed: float) -> Callable[[Fields], None]:
    """Speed [rad/s] of the first turn at constant speed."""
    return lambda mapping: mapping["logs"][3]["action"].update(speed=speed)


def turned_sensor(axis: str, degrees: float) -> Callable[[Fields], None]:
    """Error of the sensor's mount."""
    mount = MOUNT * Rotation.from_euler(axis, degrees, degrees=True)
    return in_mapping("sensor", in_hand_wxyz=mount.as_quat(scalar_first=True).tolist())


def moved_tcp(mapping: Fields) -> None:
    """TCP 3 mm off, in the hand and in the sensor's frame alike."""
    off = np.array([0.003, 0.0, 0.0])
    mapping["hand"]["tcp_in_hand_m"] = (np.array(mapping["hand"]["tcp_in_hand_m"]) + off).tolist()
    mapping["tool"]["tcp_m"] = (np.array(mapping["tool"]["tcp_m"]) + MOUNT.inv().apply(off)).tolist()


def mirrored(mapping: Fields) -> None:
    """Object drawn from below: blocks, and the actions in it, are mirrored."""
    mapping["object"] = "mirrored.toml"
    names = {"B1": "B1", "C1": "A1", "A2": "C2", "A3": "C3", "A4": "C4"}
    for entry in mapping["logs"]:
        action = entry["action"]
        action["grasp"] = names[list(names)[action["grasp"]]]
        if "pivot" in action:
            action["pivot"] = [-action["pivot"][0], action["pivot"][1]]


def late(table: pd.DataFrame) -> None:
    """Wrench that comes 50 ms later than the pose of its row."""
    table[[*FORCES, *TORQUES]] = table[[*FORCES, *TORQUES]].shift(5).bfill()


def tilted(table: pd.DataFrame) -> None:
    """Base of the arm leans by 5 degrees, which its poses do not tell."""
    lean = Rotation.from_euler("x", 5, degrees=True)
    table[["px", "py", "pz"]] = lean.apply(table[["px", "py", "pz"]].to_numpy())
    table[["qx", "qy", "qz", "qw"]] = (lean * Rotation.from_quat(table[["qx", "qy", "qz", "qw"]].to_numpy())).as_quat()


class Mistake(NamedTuple):
    """A mistake: in the mapping, in the logs, or in the weight [kg over true kg]."""

    name: str
    mapping: Callable[[Fields], None] | None = None
    log: Callable[[pd.DataFrame], None] | None = None
    weight: float = 1.0


MISTAKES = (
    Mistake("none"),
    Mistake("no rotation of the sensor", in_mapping("sensor", in_hand_wxyz=[1.0, 0.0, 0.0, 0.0])),
    Mistake("closing_deg off by 90", added("hand", "closing_deg", 90.0)),
    Mistake("closing_deg off by 2", added("hand", "closing_deg", 2.0)),
    Mistake("object mirrored", mirrored),
    Mistake("one wrong grasp", lambda mapping: mapping["logs"][-1]["action"].update(grasp=2)),
    Mistake("TCP 3 mm off", moved_tcp),
    Mistake("sensor turned by 2 deg about the vertical", turned_sensor("z", 2)),
    Mistake("sensor turned by 2 deg about a horizontal", turned_sensor("x", 2)),
    Mistake("position in mm read as m", in_mapping("hand", position_unit="m")),
    Mistake("torque in N mm read as N m", in_mapping("sensor", torque_unit="N m")),
    Mistake("force in kgf read as N", in_mapping("sensor", force_unit="N")),
    Mistake("speed in deg/s, not rad/s", at_speed(10.0)),
    Mistake("speed 15 % off", at_speed(0.2)),
    Mistake("turn in the other sense", at_speed(-0.1745)),
    Mistake("sign of the wrench", in_mapping("sensor", sign=1)),
    Mistake("x and y of the force swapped", in_mapping("sensor", force=["fy", "fx", "fz"])),
    Mistake("quaternion xyzw read as wxyz", in_mapping("hand", orientation_as="wxyz")),
    Mistake("base not level: 5 deg", log=tilted),
    Mistake("wrench 50 ms late, one clock", log=late),
    Mistake("weight 10 % too large", weight=1.1),
    Mistake("blocks of 50 mm told as 55", lambda mapping: mapping.update(object="larger.toml")),
    Mistake("tool's mass 0.2 kg off", added("tool", "mass_kg", 0.2)),
)


def short(sentences: list[str]) -> str:
    """First sentence, of a misfit its likeliest cause, without what is long."""
    text = sentences[0] if sentences else ""
    cause = re.search(r"likeliest cause, for (\d+ %) of it: ([^:]*)", text)
    text = f"misfit: {cause[2]} ({cause[1]})" if cause else text
    return text if len(text) <= MOST else f"{text[:MOST]} ..."


def row_of(mistake: Mistake, block: KnownBlock, draw: int, folder: Path) -> tuple[list[str], float]:
    """Row of the table of one mistake in one draw of the noise, and the largest error over the claimed one."""
    trials = block.trials("ft300s", draw)
    logs = [entry_of(f"{i}.csv", trial) for i, trial in enumerate(trials)]
    mapping = mapping_of(trials[0], action=None, joints=None, logs=logs)
    if mistake.mapping is not None:
        mistake.mapping(mapping)
    for i, trial in enumerate(trials):
        path = write_csv(folder / f"{i}.csv", trial)
        if mistake.log is not None:
            table = pd.read_csv(path)
            mistake.log(table)
            table.to_csv(path, index=False)
    weight = mistake.weight * block.weighed("ft300s", draw)
    try:
        path = write_toml(folder / "lab.toml", mapping)
        done = import_logs(path, [], folder / "results", "own_weight", weight, lambda *_: None)
    except HeftError as error:
        lines = str(error).splitlines()
        return [mistake.name, short([f"refused: {lines[0].replace(f'{folder}/', '')}"]), "", "", "", ""], 0.0
    shape, records = done[0].object.shape, [log.trajectory for log in done]
    said = [f"{t.status}: {t.reason}" for t in records if not t.ok] + wrong_motion(shape, records)
    answer = build_method("support_aware", {}).estimate(shape, weight, [t for t in records if t.ok], 0)
    inertia = check_weight(shape, weight, records, answer)
    asked = [answer.message] if answer.status not in ("ok", "underdetermined") else []
    asked += [inertia.text] if inertia is not None and not inertia.ok else []
    words = [mistake.name, short(said), short(asked), answer.status]
    mass, claimed = answer.group_mass(shape), answer.group_error(shape)
    if mass is None or claimed is None:
        return [*words, "", ""], 0.0
    truth = dict(zip(block.model.shape.group_names, block.model.group_mass, strict=True))
    swap = str.maketrans("ACac", "CAca") if "mirrored" in mistake.name else {}
    true = np.array([truth[name.translate(swap)] for name in shape.group_names])
    off = np.abs(mass - true)
    worst = float((off / claimed).max())
    misfit, nad = answer.diagnostics.get("misfit", np.nan), 100 * off.sum() / true.sum()
    silent = " SILENT" if worst > 3 and answer.status == "ok" and not said and not asked else ""
    return [*words, f"{misfit:.2g}", f"{nad:.1f} ({100 * claimed.sum() / true.sum():.1f}){silent}"], worst


def main() -> None:
    """Print the table."""
    options = parser_of(__doc__, draws=3).parse_args()
    block = load_block("L2-own_weight")
    says = ("mistake", "import says", "estimate says", "status", "misfit", "NAD (claimed), %", "error / claimed")
    table = head_table(*says, left=says)
    for mistake in MISTAKES:
        with tempfile.TemporaryDirectory() as folder:
            for name, text in (("mirrored", MIRRORED), ("larger", LARGER)):
                (Path(folder) / f"{name}.toml").write_text(text, encoding="utf-8")
            rows = [row_of(mistake, block, draw, Path(folder)) for draw in range(options.draws)]
        worst = max(worst for _, worst in rows)
        row = next((row for row, _ in rows if "SILENT" in row[-1]), rows[-1][0])
        table.add_row(*row, f"{worst:.1f}" if worst else "")
    Console(width=190, markup=False).print(table)


if __name__ == "__main__":
    main()
