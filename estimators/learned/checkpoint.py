"""Files of a learned posterior: the network with the origin of its training, and parts of its examples."""

from __future__ import annotations

import io
import os
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from estimators.learned.examples import BLOCKS, CONTACTS, SUBSETS, TRIALS, Examples, make_examples
from estimators.learned.question import SUMMARY
from estimators.testing.analytic_lab import LAB
from testbed.files import UNSEALED, load_sealed, write_sealed
from testbed.worlds.setup_errors import SetupErrors

FORMAT = 3
"""Version of the format; files of another version are refused."""
LEAST_FREEDOM = 15
"""Degrees of freedom below which a misfit may be large by chance."""
FALSE_ALARM = 0.01
"""Share of the examples whose misfit is above its limit, for friction and for inertia."""
COMMAND = "heft learn"
"""Command that makes a checkpoint."""


def default_path() -> Path:
    """File that `heft learn` writes and `learned` reads: heft/learned.pt in the user's cache folder."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "heft" / "learned.pt"


@dataclass(frozen=True)
class Origin:
    """Origin of a network: the objects, trials and errors of its training."""

    objects: int
    """Number of objects."""
    seed: int
    """Seed of objects, worlds and training."""
    heft: str = version("heft-testbed")
    """Version of heft."""
    world: str = "analytic lab"
    contacts: tuple[str, ...] = CONTACTS
    """Contact patterns of the blocks."""
    blocks: tuple[int, int] = BLOCKS
    """Fewest and most blocks of an object."""
    trials: int = TRIALS
    """Most trials of an example."""
    subsets: int = SUBSETS
    """Examples of an object."""

    @property
    def setup(self) -> SetupErrors:
        """Errors of the setup that were drawn and stated."""
        return LAB


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """A trained network."""

    origin: Origin
    sizes: dict[str, int]
    """Fields of `network.Sizes`."""
    weights: dict[str, Tensor]
    """State of the network."""
    low: Tensor
    """Least of each number of `SUMMARY` among the examples, (n,)."""
    high: Tensor
    """Largest of each, (n,)."""
    limits: dict[str, float]
    """Largest misfit of the first answer by its name in `SUMMARY`; `FALSE_ALARM` of the examples are above."""
    loss: float
    """Negative log density of the logarithm of a group's load on held-out objects [nats]."""
    first: float
    """Loss of the first answer, a normal distribution with its errors."""
    core_seconds: float
    """CPU time of examples and training."""

    def save(self, path: Path) -> None:
        """Write it whole."""
        write_tensors(path, vars(self) | {"origin": asdict(self.origin)})

    @staticmethod
    def load(path: Path) -> Checkpoint:
        """Checkpoint of a file.

        Raises:
            DamagedFileError: missing, damaged, or of another format.
        """
        content = read_tensors(path, "checkpoint")
        return Checkpoint(origin=Origin(**content.pop("origin")), **content)


def save_examples(path: Path, examples: Examples, seconds: float) -> None:
    """Write examples, and the CPU time that they took, s."""
    write_tensors(path, vars(examples) | {"seconds": seconds})


def make_part(path: Path, seed: int, objects: Sequence[int]) -> None:
    """Make the examples of some objects, by their numbers, and write them."""
    begin = time.process_time()
    save_examples(path, make_examples(seed, objects), time.process_time() - begin)


def load_examples(path: Path) -> tuple[Examples, float]:
    """Examples of a file, and the CPU time that they took, s.

    Raises:
        DamagedFileError: missing, damaged, or of another format.
    """
    content = read_tensors(path, "part of the examples")
    seconds = content.pop("seconds")
    return Examples(**content), seconds


def write_tensors(path: Path, content: dict[str, Any]) -> None:
    """Write tensors and plain values whole, with a checksum at the end."""

    def write(part: Path) -> None:
        buffer = io.BytesIO()
        torch.save({"format": FORMAT, "summary_names": SUMMARY, **content}, buffer)
        part.write_bytes(buffer.getvalue() + UNSEALED.encode())

    write_sealed(path, write)


def read_tensors(path: Path, what: str) -> dict[str, Any]:
    """Tensors and plain values of a file; nothing in it is executed.

    Raises:
        DamagedFileError: missing, damaged, or of another format.
    """

    def parse(data: bytes) -> dict[str, Any]:
        content = torch.load(io.BytesIO(data[: -len(UNSEALED)]), weights_only=True)
        found = content.pop("format"), tuple(content.pop("summary_names"))
        if found != (FORMAT, SUMMARY):
            raise ValueError(f"format {found[0]}, where this version of heft reads {FORMAT}: run `{COMMAND}` again")
        return content

    return load_sealed(path, what, parse)
