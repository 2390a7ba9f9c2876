"""heft learn: train the network of the method `learned`."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

if TYPE_CHECKING:
    from estimators.learned.examples import Examples
    from scenarios.execution.executor import Executor
    from scenarios.study.experiment import Progress

PART = 10
"""Objects of a task, whose examples are a file of their own until the end."""


def learn(
    *,
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    objects: Annotated[int, tyro.conf.arg(metavar="N")] = 300,
    epochs: Annotated[int, tyro.conf.arg(metavar="N")] = 60,
    seed: Annotated[int, tyro.conf.arg(metavar="S")] = 0,
    workers: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
) -> None:
    """Train the network of the method `learned`: the posterior of the masses of joined blocks in a lab.

    Draws objects, contacts and setups in the analytic lab, simulates trials, trains on nine tenths of the objects, and
    writes the network of the epoch that is best on the others. Needs the extra `learned`. After an interruption, the
    same command continues with the examples in the folder FILE.parts.

    Examples: heft learn
              heft learn --objects 2000 --out lab.pt

    Args:
        out: output file; default: learned.pt in heft's folder of the user cache, where `learned` finds it.
        objects: number of objects to draw, with three examples each.
        epochs: passes through the examples.
        seed: seed of objects, setups and training.
        workers: number of processes that make the examples; default: one per core. 0 uses this process.
    """
    import torch

    from estimators.learned.checkpoint import Origin, default_path
    from estimators.learned.estimator import Learned
    from estimators.learned.examples import Examples
    from scenarios.cli.run import show_progress
    from scenarios.cli.terminal import orderly_end
    from scenarios.execution.executor import Limits
    from scenarios.execution.select import open_executor
    from testbed.validation import check_integer

    Learned.check_package()
    for name, value, least in (("objects", objects, 2 * PART), ("epochs", epochs, 1), ("seed", seed, 0)):
        check_integer(f"--{name}", value, least)
    from estimators.learned.training import HELD_OUT, train

    path = out or default_path()
    folder = path.with_name(f"{path.name}.parts")
    files = [folder / f"{seed}-{index:05d}.pt" for index in range(-(-objects // PART))]
    torch.set_num_threads(1)
    with orderly_end(), show_progress() as progress:
        with open_executor("local", workers, Limits(memory_gib=2.0)) as executor:
            made = _made(executor, files, seed, progress)
        held_out = -(-len(made) // HELD_OUT)
        parts, seconds = [examples for examples, _ in made], sum(spent for _, spent in made)
        origin = Origin(PART * len(files), seed)
        learned = train(
            Examples.joined(parts[held_out:]), Examples.joined(parts[:held_out]), origin, epochs, progress, seconds
        )
    learned.save(path)
    shutil.rmtree(folder)
    examples = sum(map(len, parts))
    print(
        f"{path}: {origin.objects} objects, {examples} examples, {learned.core_seconds / 60:.1f} minutes of one core;"
    )
    print(f"on objects held out {learned.loss:.3f} nats a group, where the first answer alone has {learned.first:.3f}")


def _made(executor: Executor, files: Sequence[Path], seed: int, progress: Progress) -> list[tuple[Examples, float]]:
    """Examples of every file with the CPU time of each, s; those that are not there are made.

    Raises:
        HeftError: examples that cannot be made.
    """
    from estimators.learned.checkpoint import load_examples, make_part
    from scenarios.execution.executor import Failure, work_off
    from testbed.errors import HeftError
    from testbed.files import unless_damaged

    made = {}
    for index, file in enumerate(files):
        if file.exists() and (found := unless_damaged(partial(load_examples, file), "it is made again")):
            made[index] = found
    missing = iter([index for index in range(len(files)) if index not in made])

    def start() -> bool:
        index = next(missing, None)
        if index is not None:
            numbers = range(PART * index, PART * (index + 1))
            executor.start(partial(take, index), make_part, files[index], seed, numbers)
        return index is not None

    def take(index: int, value: object) -> None:
        if isinstance(value, Failure):
            raise HeftError(f"examples {index * PART} to {(index + 1) * PART - 1}: {value.reason}")
        made[index] = load_examples(files[index])
        progress("examples", PART * len(made), PART * len(files))

    work_off(executor, start)
    return [made[index] for index in range(len(files))]
