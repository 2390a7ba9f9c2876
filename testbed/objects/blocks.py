"""Block objects: square blocks on a grid, joined edge to edge, as in the paper's re-configurable set."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from testbed.errors import InvalidValueError
from testbed.objects.model import ROBOTIQ_2F85, Grasp, Hand, MassDistribution, ObjectModel, ObjectShape
from testbed.validation import MOST_WEIGHT, Range, check_integer

MOST_ROWS, MOST_BLOCKS, MOST_GRID = 100, 400, 100
"""Rows and columns of a layout, its blocks, and particles along a block's side, at most."""


class Cell(NamedTuple):
    """Column and row of a block; row 0 is the bottom."""

    column: int
    """Column, from 0 at the left."""
    row: int
    """Row, from 0 at the bottom."""

    @property
    def name(self) -> str:
        """Column as a letter, row counted from 1 at the bottom: A1, A2, B1, ..."""
        return f"{_letters(self.column)}{self.row + 1}"


def parse_layout(rows: list[str]) -> list[Cell]:
    """Blocks of a drawn layout, bottom row first and left to right in each row.

    Args:
        rows: one string per row, top to bottom; "1" is a block, "0", "." or a space is none.

    Raises:
        InvalidValueError: an unknown character, no block, or blocks not joined edge to edge.
    """
    if not isinstance(rows, list | tuple) or not all(isinstance(row, str) for row in rows):
        raise InvalidValueError("layout", rows, 'a list of rows, such as ["10", "11"]')
    widest, blocks = max(map(len, rows), default=0), sum(row.count("1") for row in rows)
    if max(len(rows), widest) > MOST_ROWS or blocks > MOST_BLOCKS:
        given = f"{len(rows)} rows of up to {widest}, {blocks} blocks"
        raise InvalidValueError("layout", given, f"at most {MOST_ROWS} rows of {MOST_ROWS}, and {MOST_BLOCKS} blocks")
    unknown = sorted({c for row in rows for c in row} - set("10. "))
    if unknown:
        raise InvalidValueError("layout", "".join(unknown), 'rows of "1" (block) and "0", "." or space (none)')
    cells = [
        Cell(column, row)
        for row, line in enumerate(reversed(rows))
        for column, character in enumerate(line)
        if character == "1"
    ]
    if not cells:
        raise InvalidValueError("layout", rows, 'at least one "1"')
    _check_joined(cells, "layout")
    return cells


def _check_joined(cells: Sequence[Cell], field: str) -> None:
    """Raise InvalidValueError unless the cells are distinct and joined edge to edge."""
    if len(set(cells)) < len(cells):
        raise InvalidValueError(field, [cell.name for cell in cells], "each place once")
    joined, frontier = {cells[0]}, [cells[0]]
    while frontier:
        for neighbor in neighbors(frontier.pop()):
            if neighbor in cells and neighbor not in joined:
                joined.add(neighbor)
                frontier.append(neighbor)
    if apart := [cell.name for cell in cells if cell not in joined]:
        raise InvalidValueError(field, f"{', '.join(apart)} apart from {cells[0].name}", "blocks joined edge to edge")


def layout_of(cells: Collection[Cell]) -> list[str]:
    """Drawn layout of blocks, as `parse_layout` takes it."""
    columns, rows = (max(values) + 1 for values in zip(*cells, strict=True))
    return ["".join("10"[Cell(c, r) not in cells] for c in range(columns)) for r in reversed(range(rows))]


def neighbors(cell: Cell) -> tuple[Cell, Cell, Cell, Cell]:
    """The four cells that share an edge with `cell`: right, top, left, bottom."""
    column, row = cell
    return Cell(column + 1, row), Cell(column, row + 1), Cell(column - 1, row), Cell(column, row - 1)


def block_object(
    name: str,
    cells: list[Cell],
    *,
    size: float,
    height: float,
    mass: list[float],
    friction: list[float],
    friction_group: list[int],
    grid: int,
    hand: Hand = ROBOTIQ_2F85,
) -> ObjectModel:
    """A block object as particles.

    Args:
        name: the object's name.
        cells: places of the blocks, in the order of `mass`.
        size: side of a block, m.
        height: height of a block, m.
        mass: mass of each block, kg.
        friction: friction coefficient of each friction group.
        friction_group: index into `friction` of each block.
        grid: particles along a block's side; a block becomes grid x grid particles.
        hand: the gripper, whose opening limits the rows of blocks that it grasps.

    Raises:
        InvalidValueError: cells that are not joined, grid < 1, lengths that do not match, or values out of range.
    """
    grid = check_integer("grid", grid, most=MOST_GRID)
    if not isinstance(cells, Sequence) or not cells or not all(isinstance(cell, Cell) for cell in cells):
        raise InvalidValueError("cells", cells, "one Cell(column, row) or more, as parse_layout gives them")
    _check_joined(cells, "cells")
    for field, length in (("size", size), ("height", height)):
        Range(0.001, 1, "m").check(field, length)
    if not isinstance(mass, Sequence | np.ndarray):
        raise InvalidValueError("mass", mass, "a list of numbers, one per block")
    for each in mass:
        Range(0, MOST_WEIGHT, "kg").check("mass", each)
    if len(mass) != len(cells):
        raise InvalidValueError("mass", mass, f"{len(cells)} numbers, one per block, bottom row first, left to right")
    if len(friction_group) != len(cells):
        raise InvalidValueError("friction_group", friction_group, f"{len(cells)} integers, one per block")
    centers = np.array([[cell.column, cell.row] for cell in cells], dtype=float) * size
    centers -= centers.mean(axis=0)
    steps = ((np.arange(grid) + 0.5) / grid - 0.5) * size
    offsets = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    per_block = grid * grid
    shape = ObjectShape(
        particles=(centers[:, None] + offsets).reshape(-1, 2),
        mass_group=np.repeat(np.arange(len(cells)), per_block),
        friction_group=np.repeat(friction_group, per_block),
        cell=size / grid,
        height=height,
        grasps=(*_block_grasps(cells, centers, size), *_row_grasps(cells, centers, size, hand)),
        group_names=tuple(cell.name for cell in cells),
    )
    return ObjectModel(name, shape, MassDistribution(np.asarray(mass) / per_block, np.asarray(friction)))


def _block_grasps(cells: list[Cell], centers: np.ndarray, size: float) -> tuple[Grasp, ...]:
    """Grasps of blocks with two free opposite faces: across x if these are left and right, else across y."""
    grasps = []
    for cell, center in zip(cells, centers, strict=True):
        right, top, left, bottom = (neighbor in cells for neighbor in neighbors(cell))
        if not (right or left):
            grasps.append(Grasp(cell.name, center, angle=0.0, width=size, length=size))
        elif not (top or bottom):
            grasps.append(Grasp(cell.name, center, angle=np.pi / 2, width=size, length=size))
    return tuple(grasps)


def _row_grasps(cells: list[Cell], centers: np.ndarray, size: float, hand: Hand) -> list[Grasp]:
    """Grasps across rows of blocks between two free faces, where the hand opens far enough and has room."""
    at, grasps = dict(zip(cells, centers, strict=True)), []
    for closing, (across, up) in ((0.0, (1, 0)), (np.pi / 2, (0, 1))):
        for first in cells:
            row = [first]
            while (following := Cell(row[-1].column + across, row[-1].row + up)) in at:
                row.append(following)
            width, middle = len(row) * size, (at[row[0]] + at[row[-1]]) / 2
            begins = Cell(first.column - across, first.row - up) not in at
            if (
                begins
                and len(row) > 1
                and hand.takes(width)
                and _has_room(centers - middle, (across, up), width, size, hand)
            ):
                grasps.append(Grasp(f"{first.name}-{row[-1].name}", middle, closing, width, length=size))
    return grasps


def _has_room(
    offsets: Float[np.ndarray, "N 2"], closing: tuple[int, int], width: float, size: float, hand: Hand
) -> bool:
    """True if no block, at `offsets` from the middle of a row [m], is where the open fingers come down."""
    along, across = np.abs(offsets @ closing), np.abs(offsets @ closing[::-1])
    ends = (along + size / 2 > width / 2 + 1e-9) & (along - size / 2 < hand.stroke / 2 + hand.finger_depth - 1e-9)
    return not (ends & (across < (hand.finger_width + size) / 2 - 1e-9)).any()


def _letters(column: int) -> str:
    name = ""
    while column >= 0:
        name = chr(ord("A") + column % 26) + name
        column = column // 26 - 1
    return name
