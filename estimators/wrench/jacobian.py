"""Predictions of many windows at once, and their derivatives in every unknown by reverse differentiation."""

from __future__ import annotations

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor
from torch.func import jacrev, vmap

Theta = dict[str, Tensor]
"""Unknowns by name: masses, and the errors of the setup in their own units."""
Window = dict[str, Tensor]
"""Fields of windows by name, a leading axis a window; of one window without it."""
Slopes = dict[str, Float[Tensor, "K r n"]]
"""Derivatives of the r rows of K windows in each unknown, flattened."""
NONE = torch.zeros((), dtype=torch.float64)


def linearized(
    predict: Callable[[Theta, Window], Float[Tensor, "r"]], theta: Theta, windows: Window, chunk: int | None = None
) -> tuple[Float[Tensor, "K r"], Slopes]:
    """Predicted rows of K windows, and their derivatives in each unknown, flattened.

    Args:
        predict: rows of one window.
        theta: where to linearize.
        windows: fields of all windows.
        chunk: windows that are worked on at once; all if left out.
    """

    def twice(theta: Theta, window: Window) -> tuple[Tensor, Tensor]:
        rows = predict(theta, window)
        return rows, rows

    slopes, rows = vmap(jacrev(twice, has_aux=True), (None, 0), chunk_size=chunk)(theta, windows)
    return rows, {name: slope.flatten(2) if slope.dim() > 2 else slope[..., None] for name, slope in slopes.items()}


def zeros(**shapes: tuple[int, ...]) -> Theta:
    """Unknowns of value 0."""
    return {name: torch.zeros(shape, dtype=torch.float64) for name, shape in shapes.items()}
