"""Mass map for a terminal: the object from above, with a shade, a color and a number for each group's mass."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.colors import to_hex
from rich.text import Text

from viz.report.answers import Answer
from viz.style import MASS_COLORS, mapped, text_color

WIDEST = 72
"""Largest width [characters]."""
_SHADES = "·░▒▓█"
"""Fill characters from zero to the largest mass; on a terminal with colors they equal their background."""


def mass_map(answer: Answer) -> Text:
    """Map of the object from above, y up, each group with its name and mass [kg], or "?" where it is not observed.

    Raises:
        ValueError: an answer without masses.
    """
    if answer.distribution is None:
        raise ValueError("an answer without masses has no map")
    groups, names = _grid(answer), answer.shape.group_names
    found = answer.quantities[: answer.shape.n_m]
    mass = np.array([math.nan if math.isinf(quantity.error) else quantity.value for quantity in found])
    top = float(np.nanmax(mass, initial=1e-9))
    level = np.nan_to_num(np.clip(mass / top, 0, 1) * (len(_SHADES) - 1)).round().astype(int)
    backgrounds = mapped(mass, top, MASS_COLORS)
    letters = np.array([[" " if g < 0 else _SHADES[level[g]] for g in row] for row in groups])
    written = np.zeros(groups.shape, dtype=bool)
    for index, name in enumerate(names):
        value = "?" if math.isnan(mass[index]) else f"{mass[index]:.3f}"
        for label, row, columns in _places(groups == index, [name, value]):
            letters[row, columns] = list(label)
            written[row, columns] = True
    text = Text(f"{answer.object} by {answer.method}: mass of each block, kg\n")
    for row, line in enumerate(letters):
        for column, letter in enumerate(line):
            group = int(groups[row, column])
            if group < 0:
                text.append(letter)
                continue
            background = to_hex(tuple(backgrounds[group] / 255))
            color = to_hex(tuple(text_color(backgrounds[group]) / 255)) if written[row, column] else background
            text.append(letter, f"{color} on {background}")
        text.append("\n")
    return text


def _grid(answer: Answer) -> np.ndarray:
    """Group at each character, (rows, columns), two characters per cell; -1 outside the object."""
    shape = answer.shape
    cells = shape.particles[shape.cells]
    places = np.round((cells - cells.min(axis=0)) / shape.cell).astype(int)
    columns, rows = places.max(axis=0) + 1
    grid = np.full((rows, columns), -1)
    grid[rows - 1 - places[:, 1], places[:, 0]] = shape.mass_group[shape.cells]
    step = -(-2 * columns // WIDEST)
    return np.repeat(grid[::step, ::step], 2, axis=1)


def _places(inside: np.ndarray, labels: list[str]) -> list[tuple[str, int, slice]]:
    """Row and columns of each label, stacked in the middle of a group; labels that do not fit are left out."""
    rows = np.flatnonzero(inside.any(axis=1))
    first = int(rows[max((len(rows) - len(labels)) // 2, 0)]) if len(rows) else 0
    labels = labels if len(rows) > 1 else labels[-1:]
    found = []
    for row, label in enumerate(labels, start=first):
        cells = np.flatnonzero(inside[row]) if row < len(inside) else np.empty(0, dtype=int)
        runs = np.split(cells, np.flatnonzero(np.diff(cells) > 1) + 1)
        widest = max(runs, key=len)
        if len(label) <= len(widest):
            begin = int(widest[0]) + (len(widest) - len(label)) // 2
            found.append((label, row, slice(begin, begin + len(label))))
    return found
