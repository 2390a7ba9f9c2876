"""Golden folder of the present format: python -m tests.archives.make VERSION.

Made once, with the last commit that writes a format; never again. It holds a run of a simulated object in a lab, with
its estimates and its recording; a push measured with a camera, with its raw record and its estimates, a lift, and a
slide of an object in links; an imported log with its mapping; a calibration; and what the version that wrote them read
in each (`read.json`).
"""

import json
import math
import os
import shutil
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from scenarios.cli.main import main
from scenarios.results.store import Store, key_of, object_request
from testbed import RIGID, Lift, Push, Rotate, SimulationRunner, Slide, Trial, draw_sensing, load_object, preset
from testbed.robot.calibration.file import save_calibration
from testbed.robot.calibration.static_poses import Calibration
from testbed.robot.runner import read_off
from testbed.trajectory import SCHEMA_VERSION, Trajectory
from tests.archives.read import HERE, content
from tests.fakes.lab_bench import mapping_of, write_csv, write_toml
from tests.fakes.robot import robot_for

OBJECT = """\
name = "pair"
[blocks]
layout = ["11"]
mass_kg = [0.5, 0.25]
friction = 0.35
[feet]
under_each_m = [[-0.02, -0.02], [0.02, -0.02], [0.02, 0.02], [-0.02, 0.02]]
"""
LINKS = """\
name = "links"
[blocks]
layout = ["111"]
mass_kg = [0.3, 0.2, 0.25]
[[hinges]]
at_m = [0.025, 0.0]
link = ["C1"]
friction_Nm = 0.02
"""
SCENARIO = """\
objects = ["pair.toml"]
support = ["own_weight"]
sensing = ["ft300s"]
seeds = 2
simulation = { timestep_s = 0.002 }
grid = { feet = 2, particles = 2 }
[world]
preset = "lab"
[policy]
pivots = 1
duration = 1.6
accelerated = 0
held_out = 1
[methods.bayes]
[methods.hidden_states]
[methods.least_squares]
[methods.random_search]
iterations = 20
"""
CALIBRATION = Calibration(
    sign=-1,
    sensor_in_hand=np.array([0.8, 0.0, 0.0, 0.6]),
    sensor_in_hand_std=np.array([1e-3, 2e-3, 3e-3]),
    bias=np.array([1.5, -2.5, 3.5, 0.1, -0.2, 0.3]),
    bias_std=np.full(6, 0.02),
    mass=0.925,
    mass_std=0.004,
    com=np.array([0.001, -0.002, 0.06]),
    com_std=np.full(3, 5e-4),
    misfit=1.25,
    poses=12,
    gain=np.array([1.01, 0.99, 1.0, 1.02, 0.98, 1.0]),
    gain_std=np.full(6, 0.005),
)
DROPPED = "report.html", "masses.csv", "masses.json", "figures", "recordings", ".lock", "notes"
"""Parts of a results folder that heft writes for people and never reads back."""


def run(folder: Path) -> None:
    """A run of a small scenario in a lab, with a recording of one of its estimates."""
    for name, text in (("pair.toml", OBJECT), ("links.toml", LINKS)):
        (folder / name).write_text(text, encoding="utf-8")
    (folder / "small.toml").write_text(SCENARIO, encoding="utf-8")
    main(["run", "small.toml", "--out", "run"])


def measured(folder: Path) -> None:
    """A push by the fake robot with its camera, a weighing, estimates from both; a lift; links with a camera."""
    obj, out = load_object(str(folder / "pair.toml"), measured=True), folder / "measured"
    measure(out, Trial(obj, Push((0.05, -0.01), math.pi, length=0.06)), raw=out / "raw")
    keep(out, Trial(obj, read_off(0.75).action), read_off(0.75))
    main(["estimate", "measured", "--methods", "bayes", "hidden_states", "least_squares"])
    measure(out, Trial(obj, Lift(0, math.radians(3), hold=0.5), RIGID))
    measure(out, Trial(load_object(str(folder / "links.toml"), measured=True), Slide(0, duration=1.6)))


def measure(out: Path, trial: Trial, raw: Path | None = None) -> None:
    """Run a trial on the fake robot and store it, its raw record in a folder of its own."""
    _, runner = robot_for(trial, seed=1, raw=raw)
    with runner:
        record = runner.run(trial)
    assert record.ok, record.reason
    keep(out, trial, record)


def imported(folder: Path) -> None:
    """Another bench's table of one turn, its mapping, and the trial made of them."""
    obj, turn = load_object(str(folder / "pair.toml")), Rotate(0, duration=1.6)
    clean = SimulationRunner().run_clean(Trial(obj, turn))
    drawn = draw_sensing(clean, preset("ft300s"), 7)
    write_csv(folder / "turn.csv", drawn)
    write_toml(folder / "bench.toml", mapping_of(drawn, object="pair.toml"))
    main(["import", "bench.toml", "turn.csv", "--out", "imported", "--weight", "0.75"])


def keep(out: Path, trial: Trial, record: Trajectory) -> None:
    """Store a measured trial as `heft robot trial` does."""
    request = {
        "schema": SCHEMA_VERSION,
        "object": object_request(trial.object),
        "action": trial.action.to_dict(),
        "support": trial.support.name,
        "robot": {},
        "recorded": record.provenance["recorded"],
    }
    Store(out).put_trial(key_of(request), trial, request, record)


def make(version: str) -> None:
    """Write the folder of a version; it must not be there."""
    place = HERE / version
    if place.exists():
        raise SystemExit(f"{place}: is there already, and is never made again")
    with TemporaryDirectory() as made:
        folder, before = Path(made) / version, Path.cwd()
        folder.mkdir()
        os.chdir(folder)
        save_calibration(folder / "calibration.toml", CALIBRATION, "FSC-1234", "2026-11-25")
        try:
            for part in (run, measured, imported):
                part(folder)
        finally:
            os.chdir(before)
        for name in DROPPED:
            for path in [*folder.rglob(name)]:
                shutil.rmtree(path) if path.is_dir() else path.unlink()
        (folder / "read.json").write_text(json.dumps(content(folder), indent=1) + "\n", encoding="utf-8")
        shutil.copytree(folder, place)


if __name__ == "__main__":
    make(sys.argv[1])
