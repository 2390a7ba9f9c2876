"""`heft benchmark answer`: answers of methods to a split of a benchmark, a CSV file a method."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import tyro


def answer(
    methods: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="METHOD ...")],
    *,
    benchmark: Annotated[Path, tyro.conf.arg(metavar="DIR")],
    split: Annotated[str, tyro.conf.arg(metavar="SPLIT")] = "validation",
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("results/answers"),
    workers: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
) -> None:
    """Answer the problems of a benchmark split with heft's methods or your own: DIR/SPLIT/METHOD.csv for each.

    Ctrl-C keeps finished answers; run the same command again to continue.

    Examples: heft benchmark answer hidden_states bayes --benchmark results/benchmark
              heft benchmark answer my_estimator:LeastSquares --benchmark results/benchmark --split test

    Args:
        methods: method names, package:Class, or labels from the scenario `blocks`, such as weighted_sampling_M.
        benchmark: folder of the published benchmark.
        split: train, validation or test.
        out: folder for the CSV files.
        workers: number of worker processes; default: one per core. 0 runs everything in this process.
    """
    from scenarios.benchmark.answers import write_answers
    from scenarios.benchmark.dataset import Benchmark
    from scenarios.benchmark.methods import AnswerRun
    from scenarios.cli.run import MOST_LINES, show_progress
    from scenarios.config import load_scenario
    from scenarios.execution.executor import work_off
    from scenarios.execution.select import open_executor
    from scenarios.results.files import exclusive
    from scenarios.results.store import Store
    from scenarios.study.run import DEFAULT_SCENARIO
    from testbed.plugins import find_code_here

    if any(":" in method for method in methods):
        find_code_here()
    opened = Benchmark.open(benchmark)
    problems = opened.of_split(split)
    chosen = load_scenario(DEFAULT_SCENARIO)[1].changed(methods=methods).methods
    with (
        exclusive(out),
        open_executor("local", workers, preload=(AnswerRun.__module__,)) as tasks,
        show_progress() as progress,
    ):
        run = AnswerRun(opened, problems, chosen, Store(out.absolute()), tasks, progress)
        work_off(tasks, run.start)
    for line in run.failures[:MOST_LINES]:
        print(line)
    for label, answers in run.answers.items():
        path = out / split / f"{label.replace(':', '.')}.csv"
        write_answers(path, answers, problems)
        print(path)
    if run.failures:
        sys.exit(1)
