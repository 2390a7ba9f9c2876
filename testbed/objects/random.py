"""Random block objects: layouts, masses and friction drawn from a seeded family."""

from __future__ import annotations

from typing import Annotated, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from testbed.errors import InvalidValueError
from testbed.objects.blocks import Cell, layout_of, neighbors
from testbed.objects.files import Blocks, FeetTable, ObjectFile, Points, Side
from testbed.toml import Positive


class Family(BaseModel):
    """A [[random]] table: `count` objects, each a tree of blocks grown edge by edge."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    name: Annotated[str, Field(min_length=1, max_length=40, pattern=r"^[\w.-]+$")] = "random"
    count: Annotated[int, Field(ge=1, le=100_000)]
    seed: Annotated[int, Field(ge=0)] = 0
    blocks: Annotated[list[int], Field(min_length=2, max_length=2)] = [4, 8]
    mass_kg: Annotated[list[Positive], Field(min_length=1)] = [0.1, 0.2, 0.4]
    friction: Annotated[list[Positive], Field(min_length=2, max_length=2)] = [0.2, 0.8]
    size_m: Side = 0.05
    height_m: Side = 0.03
    feet_m: Points | None = None

    @model_validator(mode="after")
    def _ranges(self) -> Self:
        for name, (low, high), least in (("blocks", self.blocks, 1), ("friction", self.friction, 0.0)):
            if not least <= low <= high:
                raise InvalidValueError(name, [low, high], f"the least and the most, from {least} up, in that order")
        if self.blocks[1] > 64:
            raise InvalidValueError("blocks", self.blocks, "at most 64 blocks")
        return self

    def names(self) -> list[str]:
        """Names of all its objects."""
        digits = len(str(self.count - 1))
        return [f"{self.name}_{index:0{digits}d}" for index in range(self.count)]

    def draw(self, index: int, attempt: int) -> ObjectFile:
        """Object by its index; another `attempt` draws another object, in place of one that is not feasible."""
        rng = np.random.default_rng([self.seed, index, attempt])
        cells = _grown(int(rng.integers(self.blocks[0], self.blocks[1] + 1)), rng)
        return ObjectFile(
            name=self.names()[index],
            blocks=Blocks(
                layout=layout_of(cells),
                mass_kg=[float(m) for m in rng.choice(self.mass_kg, len(cells))],
                friction=float(rng.uniform(self.friction[0], self.friction[1])),
                size_m=self.size_m,
                height_m=self.height_m,
            ),
            feet=None if self.feet_m is None else FeetTable(under_each_m=self.feet_m),
        )


def _grown(count: int, rng: np.random.Generator) -> set[Cell]:
    """Blocks joined edge to edge, each placed at random beside those before it; columns and rows start at 0."""
    cells = {Cell(0, 0)}
    while len(cells) < count:
        free = sorted({n for cell in cells for n in neighbors(cell)} - cells)
        cells.add(free[rng.integers(len(free))])
    low = [min(values) for values in zip(*cells, strict=True)]
    return {Cell(c - low[0], r - low[1]) for c, r in cells}
