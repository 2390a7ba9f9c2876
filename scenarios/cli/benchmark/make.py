"""`heft benchmark make`: the published set of trials, and the hidden truth beside it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from testbed.errors import InvalidValueError


def make(
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("results/benchmark"),
    objects: Annotated[tuple[int, ...], tyro.conf.arg(metavar="N ...")] = (2, 2, 2),
    seed_file: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    secret: Annotated[str | None, tyro.conf.arg(metavar="TEXT")] = None,
    workers: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
) -> None:
    """Simulate the trials of the benchmark and write them to a folder that can be published.

    The truth and the secret of the test split go to DIR-private, with the results folders. Ctrl-C keeps finished files;
    run the same command again to continue.

    Examples: heft benchmark make
              heft benchmark make --objects 1 --out results/small

    Args:
        out: folder to publish.
        objects: number of objects of each kind in each world for train, validation and test; one number sets all three.
        seed_file: file that contains the secret of the test split.
        secret: the secret itself, at least 16 letters; a random one if neither is given.
        workers: number of worker processes; default: one per core. 0 runs everything in this process.
    """
    from scenarios.benchmark import make as making
    from scenarios.benchmark.problems import SPLITS
    from scenarios.cli.run import show_progress

    numbers = objects * len(SPLITS) if len(objects) == 1 else objects
    if len(numbers) != len(SPLITS) or min(numbers) < 0 or not sum(numbers):
        raise InvalidValueError("--objects", " ".join(map(str, objects)), "one number, or three >= 0, not all 0")
    if seed_file is not None:
        if secret is not None:
            raise InvalidValueError("--secret", "a text beside --seed-file", "one of the two")
        secret = seed_file.read_text(encoding="utf-8").strip()
    with show_progress() as progress:
        made = making.make(out, dict(zip(SPLITS, numbers, strict=True)), secret, workers, progress)
    for line in made.left_out:
        print(f"left out: {line}")
    size = sum(path.stat().st_size for path in out.rglob("*") if path.is_file()) / 1e6
    print(f"{len(made.problems)} problems, {size:.1f} MB: {out}/ can be published")
    print(f"truth of test: {made.truth}; do not publish its folder")
