"""Damaged and hostile files, and what heft makes of them: python bench/damage.py [files of each kind].

storage  a bit turned, a sector lost or put in another's place, in stored files: told, or silent
fuzz     every kind of file with bytes turned, cut, doubled or put in, half of the TOML files with an extreme value;
         stored ones with extreme values and a new checksum, so that what lies behind it is reached: read, refused, or
         a traceback; CPU time and memory
folders  results folders with such a file, shown by one command after the other

Exits with 1 where damage was silent, a traceback came, or a refusal took over 3 s or 500 MB.
"""

from __future__ import annotations

import contextlib
import io
import os
import resource
import shutil
import sys
import tempfile
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import trimesh

from scenarios.cli.main import main
from scenarios.config import load_scenario
from scenarios.results.estimates import load_estimate, load_rows
from scenarios.results.files import read_manifest
from scenarios.results.trials import read_trial
from scenarios.study.run import run_scenario
from testbed import Rotate, SimulationRunner, Trial, load_object, load_trajectory
from testbed.errors import HeftError
from testbed.exporters.ros2 import write_mcap
from testbed.files import load_sealed
from testbed.foot_forces import load_foot_forces
from testbed.importers.importer import import_trajectory
from testbed.importers.messages import open_messages
from testbed.objects.conversion.surface import read_surface
from testbed.objects.files import asset_folder
from testbed.objects.meshes import read_mesh
from testbed.robot.registry import load_robot_file
from testbed.sensing.compensation import compensate
from tests.fakes.lab_bench import mapping_of, write_csv, write_toml
from tests.helpers.changes import SEALED, resealed, restated, turned
from tests.helpers.runs import small_scenario

MOST_S, MOST_MB = 3.0, 500.0
WHO = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
COMMANDS = (
    "status DIR",
    "export DIR KEY",
    *(f"view DIR {how}" for how in ("--report", "--film", "KEY --figures", "KEY --record")),
)
Read = Callable[[Path], object]
Cases = Iterator[tuple[str, Callable[[], object]]]  # the outcome where nothing is refused, and what to call


def storage(files: list[Path], count: int) -> Cases:
    """Turned bits, lost and misplaced sectors."""
    rng = np.random.default_rng(0)
    while count:
        path = files[rng.integers(len(files))]
        data = path.read_bytes()
        at, other = (int(i) // 512 * 512 for i in rng.integers(len(data), size=2))
        kind, new = rng.integers(4), bytearray(data)
        if kind < 2:
            new[int(rng.integers(len(new)))] ^= 1 << rng.integers(8)
        else:
            new[at : at + 512] = (data[other : other + 512] if kind == 2 else bytes(512))[: len(data) - at]
        if new != data:
            count -= 1
            path.write_bytes(new)
            yield "silent", lambda path=path: load_sealed(path, "file", len)
            path.write_bytes(data)


def fuzz(read: Read, whole: bytes, path: Path, count: int) -> Cases:
    """One file of a kind, changed anew each time."""
    for seed in range(count):
        rng = np.random.default_rng(seed)
        path.write_bytes(whole)
        if path.suffix in SEALED:
            resealed(path, rng)
        elif path.suffix == ".toml" and seed % 2:
            with contextlib.suppress(AttributeError, TypeError):  # what is no table
                path.write_bytes(restated(whole, rng))
        else:
            path.write_bytes(turned(whole, rng))
        yield "read", lambda: read(path)
    path.write_bytes(whole)


def folders(out: Path, files: list[Path], count: int) -> Cases:
    """A folder with one changed file, shown."""
    for seed in range(count):
        rng = np.random.default_rng(seed)
        path, key = files[rng.integers(len(files))], files[rng.integers(len(files))].parent.name
        whole = path.read_bytes()
        resealed(path, rng)
        words = COMMANDS[seed % len(COMMANDS)].replace("DIR", str(out)).replace("KEY", key).split()
        yield "read", lambda words=words: main(words)
        path.write_bytes(whole)


def row_of(name: str, cases: Cases) -> bool:
    """Run the cases in a process of their own, and print their row; False where a bound was passed."""
    sys.stdout.flush()
    if child := os.fork():
        return os.waitpid(child, 0)[1] == 0
    found, places, slowest, quiet = Counter[str](), Counter[str](), 0.0, io.StringIO()
    for unless, call in cases:
        begin = spent()
        try:
            with contextlib.redirect_stdout(quiet), contextlib.redirect_stderr(quiet):
                call()
            found[unless] += 1
        except (HeftError, SystemExit):
            found["refused"] += 1
            slowest = max(slowest, spent() - begin)
        except Exception as error:
            found["traceback"] += 1
            frame = traceback.extract_tb(error.__traceback__)[-1]
            places[f"{Path(frame.filename).name}:{frame.lineno}: {error!r:.100}"] += 1
    memory = max(resource.getrusage(who).ru_maxrss for who in WHO) / 1024
    said = ", ".join(f"{count} {outcome}" for outcome, count in sorted(found.items()))
    print(f"{name:20} {said:24} slowest refusal {slowest:.2f} s, {memory:.0f} MB", *places, sep="\n    ", flush=True)
    large = memory > MOST_MB and name != "folders"  # where whole reports and figures are drawn
    os._exit(bool(found["silent"] or found["traceback"] or slowest > MOST_S or large))


def spent() -> float:
    """CPU time of this process and of the parsers that it has waited for [s]."""
    return sum(resource.getrusage(who).ru_utime + resource.getrusage(who).ru_stime for who in WHO)


def readers(here: Path, out: Path) -> dict[str, tuple[Path, Read]]:
    """A whole file of each kind, and its reader."""
    estimate = next(out.glob("estimates/*/estimate.npz")).parent
    trial = next(out.glob("trials/*/foot_forces.parquet")).parent
    for part in ("hammer.toml", "hammer_head.stl", "hammer_handle.stl"):
        shutil.copy(asset_folder("objects") / part, here)
    for kind in ("obj", "ply", "off"):
        trimesh.load_mesh(here / "hammer_head.stl").export(here / f"hammer_head.{kind}")
    (here / "robot.toml").write_text(
        '[arm]\naddress = "10.0.0.1"\n[bench]\ntable_height_m = -0.012\n[limits]\nforce_N = 40.0\n'
    )
    turn = compensate(SimulationRunner().run_clean(Trial(load_object("L2"), Rotate(2, duration=2.0, back=True))))
    log, mapping = write_csv(here / "log.csv", turn), write_toml(here / "map.toml", mapping_of(turn))
    write_mcap(turn, here / "log.mcap")
    scene = trimesh.load_scene(here / "hammer_head.stl")
    for kind in ("glb", "3mf"):
        scene.export(here / f"hammer_head.{kind}")
    return {
        "object": (here / "pair.toml", load_object),
        "object of meshes": (here / "hammer.toml", load_object),
        "scenario": (here / "small.toml", lambda path: load_scenario(str(path))),
        "robot file": (here / "robot.toml", load_robot_file),
        "mapping": (mapping, lambda path: import_trajectory(log, path)),
        "log, CSV": (log, lambda path: import_trajectory(path, mapping)),
        "manifest.json": (out / "manifest.json", lambda path: read_manifest(path.parent)),
        "trial.json": (trial / "trial.json", lambda _: read_trial(out, trial.name)),
        "trajectory.parquet": (trial / "trajectory.parquet", load_trajectory),
        "foot_forces.parquet": (trial / "foot_forces.parquet", load_foot_forces),
        "result.json": (estimate / "result.json", lambda _: load_estimate(out, estimate.name)),
        "estimate.npz": (estimate / "estimate.npz", lambda _: load_estimate(out, estimate.name)),
        "results.parquet": (out / "results.parquet", lambda _: load_rows(out)),
        "log, MCAP": (here / "log.mcap", lambda path: open_messages(path).messages("/wrench")),
        **{f"mesh, {kind.upper()}": (here / f"hammer_head.{kind}", read_mesh) for kind in ("stl", "obj", "ply", "off")},
        **{f"model, {kind.upper()}": (here / f"hammer_head.{kind}", read_surface) for kind in ("glb", "3mf")},
    }


if __name__ == "__main__":
    each = int(sys.argv[1]) if len(sys.argv) > 1 else 120
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as folder:
        base, results = Path(folder), Path(folder) / "out"
        scenario = small_scenario(base, ("own_weight",), "[methods.hidden_states]\n[methods.random_search]\n")
        run_scenario(load_scenario(str(scenario))[1], results, 0, lambda *_, **__: None)
        kinds = readers(base, results)
        stored = sorted(path for path in results.rglob("*.*") if path.suffix in SEALED)
        good = [row_of("storage", storage(stored, 1000))]
        good += [row_of(kind, fuzz(read, path.read_bytes(), path, each)) for kind, (path, read) in kinds.items()]
        good += [row_of("folders", folders(results, stored, each))]
    sys.exit(not all(good))
