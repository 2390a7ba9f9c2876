"""Making of the benchmark: trials of all problems, run through results folders, and the published folder of them."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from scenarios.benchmark.card import VERSION
from scenarios.benchmark.dataset import Problem
from scenarios.benchmark.problems import PUBLISHED_SECRET, SPLITS, Cell, cells
from scenarios.benchmark.publish import Entry, publish
from scenarios.execution.executor import Executor, work_off
from scenarios.execution.select import open_executor
from scenarios.results.files import exclusive, read_json, write_json
from scenarios.results.store import Store
from scenarios.results.trials import sensed
from scenarios.study.experiment import Experiment, Progress, experiments_of
from scenarios.study.trials import TrialRun
from testbed.errors import InfeasibleTrialError, InvalidValueError
from testbed.objects.files import ObjectFile
from testbed.toml import load_toml
from testbed.trajectory import Trajectory
from testbed.worlds.seeds import new_secret

LEAST_SECRET = 16
"""Least number of letters of a secret: published layouts of test objects would show a short one."""
TRUTH_FILE = "truth_test.json"
"""Truth of the test split, in the private folder."""


@dataclass(frozen=True)
class Made:
    """Result of `make`."""

    truth: Path
    """Truth of the test split, which is not to be published."""
    problems: tuple[Problem, ...]
    left_out: tuple[str, ...]
    """A line for each object that the robot cannot handle."""


def make(folder: Path, counts: dict[str, int], secret: str | None, workers: int | None, progress: Progress) -> Made:
    """Make the benchmark, or go on with it.

    Args:
        folder: published folder; the results folders, the secret and the truth of test lie beside it, in DIR-private.
        counts: problems of each kind and world, by split.
        secret: secret of the test split; a fresh one, or that of an earlier call, if left out.
        workers: worker processes; 0 is this process, None one a core.
        progress: receives the progress.

    Raises:
        InvalidValueError: a short secret, or a folder made with another one.
        HeftError: another process writes there.
    """
    private = folder.absolute().with_name(f"{folder.absolute().name}-private")
    with exclusive(private), open_executor("local", workers, preload=("scenarios.study.run",)) as tasks:
        secret = _test_secret(private, secret)
        made: list[tuple[Cell, Entry]] = []
        left_out: list[str] = []
        for splits, name, own in ((SPLITS[:2], "public", PUBLISHED_SECRET), (SPLITS[2:], "test", secret)):
            store = Store(private / name, own)
            store.remove_leftovers()
            wanted = [cell for split in splits for cell in cells(split, counts[split])]
            run = _Simulated(wanted, store, tasks, progress)
            made += sorted(run.work_off(), key=lambda each: (wanted.index(each[0]), each[1].file.name))
            left_out += run.left_out
        problems = publish(folder.absolute(), [entry for _, entry in made], private / TRUTH_FILE, secret)
    return Made(private / TRUTH_FILE, tuple(problems), tuple(left_out))


def _test_secret(private: Path, secret: str | None) -> str:
    """Secret of the test split, kept in the private folder."""
    if secret is not None and (len(secret) < LEAST_SECRET or secret == PUBLISHED_SECRET):
        allowed = f"{LEAST_SECRET} letters or more that are not published: layouts of test objects show a short secret"
        raise InvalidValueError("--secret", "*" * len(secret), allowed)
    kept = read_json(private / "secret.json")
    if kept is None:
        kept = {"secret": secret or new_secret(), "version": VERSION}
        write_json(private / "secret.json", kept)
    if kept["version"] != VERSION or secret not in (None, kept["secret"]):
        raise InvalidValueError("--out", str(private), "a new folder: this one is of another secret or version")
    return kept["secret"]


class _Simulated:
    """Trials of some cells; the objects of a cell are prepared during the trials of the one before."""

    def __init__(self, wanted: list[Cell], store: Store, tasks: Executor, progress: Progress):
        self._waiting, self._store, self._tasks = deque(wanted), store, tasks
        self._cells: dict[str, Cell] = {}
        self._ended: list[Experiment] = []
        self.left_out: list[str] = []
        self._run = TrialRun(deque(), store, tasks, progress, self._ended.append)
        self._run.expected = sum(cell.expected_trials for cell in wanted)

    def work_off(self) -> list[tuple[Cell, Entry]]:
        """Simulate all trials; return the problems whose trials succeeded, with their cells."""
        work_off(self._tasks, self._run.start, self._prepare)
        self.left_out += [f"{each.particles.name}: {why}" for each in self._ended if (why := failure_of(each))]
        done = [each for each in self._ended if not failure_of(each)]
        return [(cell := self._cells[each.particles.name], _entry(cell, each, self._store)) for each in done]

    def _prepare(self) -> bool:
        if not self._waiting:
            return False
        cell = self._waiting.popleft()
        try:
            made, refused = experiments_of(cell.scenario(self._store), self._store, lambda *_, **__: None)
        except InfeasibleTrialError as error:
            self.left_out.append(f"{cell.name}: {error}")
            return True
        self._cells |= {each.particles.name: cell for each in made}
        self.left_out += [f"{each.name}: {each.reason}" for each in refused]
        self._run.waiting.extend(made)
        return True


def failure_of(experiment: Experiment) -> str:
    """Reason why an experiment is no problem; empty for one with a trial on the table."""
    if experiment.failure or len(experiment.keys) > 1:
        return experiment.failure
    return next((f"every action was refused: {why}" for why in experiment.reasons.values()), "it has no trial")


def _entry(cell: Cell, experiment: Experiment, store: Store) -> Entry:
    model = experiment.particles
    file = load_toml(next(store.root.glob(f"objects/*/{model.name}.toml")), ObjectFile)
    return Entry(cell.split, cell.kind, cell.world, file, model, partial(given, experiment, store))


def given(experiment: Experiment, store: Store) -> list[Trajectory]:
    """Trials of an experiment as a method is given them, the weighing first."""
    return [
        sensed(store.trajectory(key), *experiment.policy_draw, index, key, store.secret)
        for index, key in enumerate(experiment.keys)
    ]
