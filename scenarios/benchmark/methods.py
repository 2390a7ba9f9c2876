"""Answers of methods, heft's own or of other packages, to the problems of a benchmark, in parallel and resumable."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from estimators.registry import METHODS, check_installed, code_of, kind_of
from scenarios.benchmark.answers import Answer
from scenarios.benchmark.dataset import Benchmark, Problem, trajectories_of
from scenarios.execution.executor import Executor, Failure
from scenarios.results.store import Store, key_of
from scenarios.study.estimates import judged_answers, printing_into
from scenarios.study.experiment import Progress


@dataclass(eq=False)
class AnswerRun:
    """Answers of some methods to some problems; those in the store are reused."""

    benchmark: Benchmark
    problems: Sequence[Problem]
    methods: Mapping[str, dict[str, Any]]
    """Settings of each method by its label."""
    store: Store
    executor: Executor
    progress: Progress
    answers: dict[str, dict[str, Answer]] = field(default_factory=dict)
    """Answers by label and problem."""
    failures: list[str] = field(default_factory=list)
    """A line for each answer that failed."""
    waiting: deque[tuple[Problem, str]] = field(init=False)

    def __post_init__(self) -> None:
        for label, settings in self.methods.items():
            check_installed(label, settings)
        self.answers |= {label: {} for label in self.methods}
        self.waiting = deque((problem, label) for problem in self.problems for label in self.methods)

    def start(self) -> bool:
        """Start the next answer, or reuse a stored one; False if none is left."""
        if not self.waiting:
            return False
        problem, label = self.waiting.popleft()
        settings = self.methods[label]
        asked = {"problem": asdict(problem), "method": kind_of(label, settings), "settings": settings}
        key = key_of(asked | code_of(label, settings) | {"version": version("heft-testbed")})
        if (known := self.store.note(key)) is not None:
            self._put(problem, label, known)
        else:
            take = partial(self._take, problem, label, key)
            self.executor.start(take, answer, self.benchmark.folder, problem, label, settings, self.store)
        return True

    def _take(self, problem: Problem, label: str, key: str, value: dict[str, Any] | Failure) -> None:
        if isinstance(value, Failure):
            self.failures.append(f"{label}, {problem.problem}: {value.reason}")
            value = {"mass_kg": None, "error_kg": None, "status": "failed"}
        else:
            self.store.put_note(key, value)
        self._put(problem, label, value)

    def _put(self, problem: Problem, label: str, value: dict[str, Any]) -> None:
        mass, error = value["mass_kg"], value["error_kg"]
        unbounded = None if error is None else tuple(np.inf if one is None else one for one in error)  # no inf in JSON
        self.answers[label][problem.problem] = Answer(None if mass is None else tuple(mass), unbounded, value["status"])
        done = sum(map(len, self.answers.values()))
        self.progress("answers", done, len(self.problems) * len(self.methods), len(self.failures))


def answer(folder: Path, problem: Problem, label: str, settings: dict[str, Any], store: Store) -> dict[str, Any]:
    """Worker's task: the answer of a method to a problem, as plain data."""
    shape, trials = problem.model(folder).shape, list(trajectories_of(folder, problem.problem))
    with nullcontext() if kind_of(label, settings) in METHODS else printing_into(store.log(label)):
        (found,) = judged_answers(label, settings, shape, [problem.weight_kg], [trials], [0])
    mass, error = found.group_mass(shape), found.group_error(shape)
    return {
        "mass_kg": None if mass is None else mass.tolist(),
        "error_kg": None if mass is None or error is None else error.tolist(),
        "status": found.status,
    }
