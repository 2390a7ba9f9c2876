"""Cost of a sweep beside its tasks, and survival of kills: python bench/sweeps.py [overhead|resume|memory|kills|all].

overhead  wall time of a sweep on 2 warm workers over the sum of its tasks' times, and of 1 worker over 2
resume    wall time of the same command on a finished sweep of 10,000 estimates
memory    peak memory of the driver of 170 trials over that of 20
kills     20 sweeps, each killed at a random moment and resumed; what happened to each
"""

from __future__ import annotations

import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from metered import Metered

from estimators.base import Estimate
from scenarios.config import Policy, Scenario
from scenarios.execution.executor import work_off
from scenarios.execution.select import open_executor
from scenarios.results.store import Store
from scenarios.study import run as sweep
from scenarios.study import trials
from scenarios.study.estimates import EstimateTask
from scenarios.study.experiment import experiments_of
from scenarios.study.run import run_scenario
from testbed.actions.rotate import Rotate
from testbed.objects.random import Family
from testbed.simulation.runner import SimulationRunner
from testbed.simulation.settings import SimulationSettings
from testbed.trajectory import Trajectory
from testbed.trial import Trial
from tests.helpers.runs import VICTIMS, done_in, draw_killing, kill_a_run, quiet, resumed, small_scenario

METHODS = {f"search_{i}": {"method": "random_search", "iterations": i} for i in range(1, 11)}


def sweep_of(objects: int, **more: Any) -> Scenario:
    """Random objects under two supports, turns of 2 s."""
    policy = Policy(pivots=3, duration=2.0, accelerated=0, held_out=1)
    family = Family(count=objects, blocks=[2, 3])
    return Scenario(random=[family], support=["own_weight", "rigid"], policy=policy, sensing=["ft300s"], **more)


@contextmanager
def warm(workers: int) -> Iterator[Metered]:
    """Workers that have imported everything, used by every run."""
    before = sweep.open_executor
    with open_executor("local", workers) as executor:
        for index in range(workers):
            executor.start(index, time.sleep, 1.0)
        while executor.running:
            executor.wait()
        counted = Metered(executor)

        @contextmanager
        def same(*_: object, **__: object) -> Iterator[Metered]:
            yield counted

        sweep.open_executor = same
        try:
            yield counted
        finally:
            sweep.open_executor = before


def overhead() -> None:
    """Time of a sweep over its tasks; 1 worker over 2."""
    scenario = sweep_of(3, seeds=8)
    wall = {}
    for workers in (2, 1):
        with tempfile.TemporaryDirectory() as folder, warm(workers) as executor:
            experiments_of(scenario, Store(Path(folder)), quiet)
            begin = time.perf_counter()
            run_scenario(scenario, Path(folder), workers, quiet)
            wall[workers] = time.perf_counter() - begin
            share = wall[workers] * workers / sum(task.wall for task in executor.tasks) - 1
            print(f"{workers} workers, {len(executor.tasks)} tasks: sweep over their sum +{100 * share:.1f} %")
    print(f"1 worker over 2: {wall[1] / wall[2]:.2f}")


def canned() -> tuple[Trial, Trajectory]:
    """A turn of 2 s there and back, of a small object."""
    with tempfile.TemporaryDirectory() as folder:
        scenario = sweep_of(1)
        experiment = experiments_of(scenario, Store(Path(folder)), quiet)[0][0]
        turn = Rotate(experiment.grasps[0], duration=2.0, back=True)
        trial = Trial(experiment.model, turn, experiment.support)
        return trial, SimulationRunner().run_clean(trial)


def resume() -> None:
    """Time of a finished sweep: 50 objects, 2 supports, 10 methods, 10 draws; trials are copies, keys are real."""
    scenario = sweep_of(50, seeds=10, methods=METHODS)
    with tempfile.TemporaryDirectory() as folder:
        store = Store(Path(folder), "bench")
        trial, record = canned()
        store.put_trial("canned", trial, {}, record)
        experiments, _ = experiments_of(scenario, store, quiet)
        answer = Estimate(None, "no_data", "none")
        for index, experiment in enumerate(experiments):
            experiment.keys = [f"{index}_{i}" for i in range(13)]
            experiment.held_out_keys = [f"{index}_{i}" for i in (13, 14)]
            for key in experiment.keys + experiment.held_out_keys:
                shutil.copytree(store.root / "trials" / "canned", store.root / "trials" / key)
            made = {"keys": experiment.keys, "held_out": experiment.held_out_keys}
            store.put_note(trials._key_of(experiment, store), made)
            row = {"status": "ok", "message": "", "nad": 0.01, "mass_kg": [0.1] * 6, "friction": [0.5], "seconds": 1.0}
            for method in scenario.methods:
                for seed, key in enumerate(EstimateTask.of(experiment, "ft300s", method).result_keys(store.draws)):
                    store.put_estimate(key, row | {"seed": seed}, answer, experiment.particles.shape)
        begin = time.perf_counter()
        rows = run_scenario(scenario, store.root, 2, quiet, secret=store.secret)
        seconds = time.perf_counter() - begin
        assert set(rows["status"]) == {"ok"}
        print(f"resume of {len(rows)} finished estimates of {15 * len(experiments)} trials: {seconds:.1f} s")


def memory() -> None:
    """Time of the driver: 170 trials over 20, their records copied from one turn."""
    peak = {}
    for objects in (2, 20):
        said = subprocess.run(
            [sys.executable, __file__, "driver", str(objects)], capture_output=True, text=True, check=True
        )
        made, mebibytes = said.stdout.split()
        peak[int(made)] = float(mebibytes)
    (few, least), (many, most) = sorted(peak.items())
    print(f"driver's peak memory: {least:.0f} MiB with {few} trials, {most:.0f} MiB with {many}: {most / least:.2f}")


def driver(objects: int) -> None:
    """In a process of its own: trials and the peak memory after them, MiB."""
    _, record = canned()
    scenario = sweep_of(objects, seeds=1)

    def copy(trial: Trial, settings: SimulationSettings, store: Store) -> None:
        asked = trials.trial_request(trial, settings)
        made = record if isinstance(trial.action, Rotate) else SimulationRunner(settings).run_clean(trial)
        store.put_trial(trials.key_of(asked), trial, asked, replace(made, action=trial.action))

    trials.simulate = copy
    with tempfile.TemporaryDirectory() as folder, open_executor("inline", 0) as executor:
        store = Store(Path(folder), "bench")
        experiments, _ = experiments_of(scenario, store, quiet)
        run = trials.TrialRun(deque(experiments), store, executor, quiet, lambda _: None)
        work_off(executor, run.start)
        made = len([*store.root.glob("trials/*")])
    print(made, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)


def kills(count: int = 20) -> None:
    """Killed at random moments, resumed, and the same results to the bit."""
    rng = np.random.default_rng(1)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        scenario = small_scenario(folder)
        undisturbed = resumed(scenario, folder / "undisturbed")
        most = done_in(folder / "undisturbed")
        same = 0
        for index in range(count):
            out = folder / f"killed_{index}"
            said = kill_a_run(scenario, out, draw_killing(rng, VICTIMS[index % 3], most))
            pd.testing.assert_frame_equal(resumed(scenario, out), undisturbed)
            same += 1
            print(f"{index + 1:2d}: {said}, resumed to {done_in(out)} of {most}, results the same", flush=True)
        print(f"{same} of {count} runs resumed to the results of the undisturbed one")


def main() -> None:
    """Print the ratios asked for."""
    what = sys.argv[1] if len(sys.argv) > 1 else "all"
    if what == "driver":
        driver(int(sys.argv[2]))
        return
    for name, show in {"overhead": overhead, "resume": resume, "memory": memory, "kills": kills}.items():
        if what in (name, "all"):
            show()


if __name__ == "__main__":
    main()
