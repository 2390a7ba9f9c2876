"""Predictions of many windows at once, and their derivatives in every unknown by reverse differentiation."""

from __future__ import annotations

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor
from torch.func import vmap

Theta = dict[str, Tensor]
"""Unknowns by name: masses, and the errors of the setup in their own units."""
Window = dict[str, Tensor]
"""Fields of windows by name, with the window as the leading axis; of a single window without that axis."""
Slopes = dict[str, Float[Tensor, "K r n"]]
"""Derivatives of the r rows of K windows in each unknown, flattened."""
NONE = torch.zeros((), dtype=torch.float64)
"""Value of a scalar unknown that is left out."""


def linearized(
    predict: Callable[[Theta, Window], Float[Tensor, "r"]], theta: Theta, windows: Window, chunk: int | None = None
) -> tuple[Float[Tensor, "K r"], Slopes]:
    """Predicted rows of K windows, and their derivatives in each unknown, flattened.

    Args:
        predict: rows of one window.
        theta: point of linearization.
        windows: fields of all windows.
        chunk: number of windows in a batch; all if left out.
    """

    sizes = [value.numel() for value in theta.values()]

    def rows_of(flat: Float[Tensor, "n"], window: Window) -> Float[Tensor, "r"]:
        parts = zip(theta.items(), flat.split(sizes), strict=True)
        return predict({name: part.reshape(value.shape) for (name, value), part in parts}, window)

    count, found = len(next(iter(windows.values()))), []
    size, at = chunk or count, torch.cat([value.flatten() for value in theta.values()])
    # not `torch.func.jacrev`, whose first call imports torch's compiler: two to three core-seconds in every process
    for begin in range(0, count, size):
        part = {name: field[begin : begin + size] for name, field in windows.items()}
        with torch.enable_grad():  # a caller may have it off
            flat = at.repeat(min(size, count - begin), 1).requires_grad_()
            rows = vmap(rows_of)(flat, part)
        each = torch.eye(rows.shape[1], dtype=rows.dtype)[:, None].expand(-1, len(rows), -1)
        slopes = torch.autograd.grad(rows, flat, each, is_grads_batched=True)[0]
        found.append((rows.detach(), slopes.transpose(0, 1)))
    rows, slopes = (torch.cat(parts) for parts in zip(*found, strict=True))
    return rows, dict(zip(theta, slopes.split(sizes, -1), strict=True))


def zeros(**shapes: tuple[int, ...]) -> Theta:
    """Unknowns of value 0."""
    return {name: torch.zeros(shape, dtype=torch.float64) for name, shape in shapes.items()}
