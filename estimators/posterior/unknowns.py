"""Unknowns of an estimate: named blocks with priors, standardized to one vector z of independent standard normals."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from jaxtyping import Float
from torch import Tensor

from estimators.wrench.jacobian import Theta

SMALLEST = 1e-12
"""Least value of a positive parameter."""


@dataclass(frozen=True, eq=False)
class Block:
    """Parameter and its prior: normal, or log-normal where `positive`."""

    mean: Tensor
    """Prior mean in the parameter's unit; of a positive parameter that of its logarithm."""
    std: Tensor
    """Prior standard deviation, likewise; same shape as `mean`."""
    positive: bool = False
    """True for a log-normal prior."""
    by_trial: bool = False
    """True for a value per trial: the leading axis is the trial."""
    inverse: bool = False
    """True for a positive parameter whose steps are linear in its inverse."""

    def value(self, z: Float[Tensor, "n"]) -> Tensor:
        """Parameter in its own unit."""
        value = self.mean + self.std * z.reshape(self.mean.shape)
        return value.exp() if self.positive else value

    def standardized(self, value: Tensor) -> Float[Tensor, "n"]:
        """z of a value; 0 where the parameter is known."""
        off = (value.clamp(min=SMALLEST).log() if self.positive else value) - self.mean
        return torch.where(self.std > 0, off / self.std, 0.0).flatten()

    def stepped(self, z: Float[Tensor, "n"], step: Float[Tensor, "n"]) -> Float[Tensor, "n"]:
        """z after a step linear in the parameter or its inverse, also where the prior is of its logarithm.

        Below half of its value, the parameter or its inverse falls exponentially.
        """
        if not self.positive:
            return z + step
        std, side = self.std.flatten(), -1.0 if self.inverse else 1.0
        part = side * std * step
        beyond = (part + 0.5).clamp(max=0)
        logarithm = torch.log1p(part.clamp(min=-0.5)) + beyond + beyond.expm1()
        return torch.where(std > 0, z + side * logarithm / std.clamp(min=SMALLEST), z)

    def scale(self, z: Float[Tensor, "n"]) -> Float[Tensor, "n"]:
        """Derivative of the parameter in z."""
        return (self.std * self.value(z) if self.positive else self.std).flatten()

    @staticmethod
    def normal(size: Tensor | float, trials: int | None = None) -> Block:
        """Error of mean 0 and standard deviation `size`, with a value per trial where their number is given."""
        std = torch.as_tensor(size, dtype=torch.float64)
        std = std if trials is None else std.expand(trials, *std.shape)
        return Block(torch.zeros_like(std), std, by_trial=trials is not None)

    @staticmethod
    def known(value: Tensor) -> Block:
        """Parameter without errors."""
        return Block(value, torch.zeros_like(value))

    @staticmethod
    def log_normal(median: float | Tensor, std: float, count: int, *, inverse: bool = False) -> Block:
        """Positive parameter by its median and the standard deviation of its logarithm."""
        mean = torch.as_tensor(median, dtype=torch.float64).log().expand(count)
        return Block(mean, torch.full((count,), std, dtype=torch.float64), positive=True, inverse=inverse)


@dataclass(frozen=True, eq=False)
class Unknowns:
    """All blocks in order."""

    blocks: dict[str, Block]
    at: dict[str, slice] = field(init=False)
    """Entries of each block in z."""

    def __post_init__(self) -> None:
        at, begin = {}, 0
        for name, block in self.blocks.items():
            at[name] = slice(begin, begin + block.mean.numel())
            begin += block.mean.numel()
        object.__setattr__(self, "at", at)

    def __len__(self) -> int:
        return sum(block.mean.numel() for block in self.blocks.values())

    def start(self, **values: float | Tensor) -> Float[Tensor, "n"]:
        """z of the prior means, with the given values of some parameters."""
        z = torch.zeros(len(self), dtype=torch.float64)
        for name, value in values.items():
            z[self.at[name]] = self.blocks[name].standardized(torch.as_tensor(value, dtype=torch.float64))
        return z

    def values(self, z: Float[Tensor, "n"]) -> Theta:
        """Parameters by name, in their own units."""
        return {name: block.value(z[self.at[name]]) for name, block in self.blocks.items()}

    def stepped(self, z: Float[Tensor, "n"], step: Float[Tensor, "n"]) -> Float[Tensor, "n"]:
        """z after a step linear in the parameters or their inverses, so that the weighed sum of masses is linear."""
        return torch.cat([block.stepped(z[self.at[name]], step[self.at[name]]) for name, block in self.blocks.items()])

    def given(self, **values: Tensor) -> Unknowns:
        """Unknowns with some parameters known."""
        return Unknowns(self.blocks | {name: Block.known(value) for name, value in values.items()})

    def of(self, names: set[str], z: Float[Tensor, "n"]) -> tuple[Theta, Theta]:
        """Values of the named parameters that are unknown: those of all trials, and those with a value per trial."""
        found = {name: self.blocks[name].value(z[self.at[name]]) for name in names if name in self.blocks}
        by_trial = {name: value for name, value in found.items() if self.blocks[name].by_trial}
        return {name: value for name, value in found.items() if name not in by_trial}, by_trial

    def columns(
        self, slopes: dict[str, Float[Tensor, "K r m"]], trial: Tensor, z: Float[Tensor, "n"]
    ) -> Float[Tensor, "K r n"]:
        """Derivatives of K windows' rows in z, from those in each parameter of a window's trial.

        Args:
            slopes: derivatives by name.
            trial: trial of each window.
            z: point at which they are the derivatives.
        """
        count, rows = next(iter(slopes.values())).shape[:2]
        found = torch.zeros(count, rows, len(self), dtype=torch.float64)
        for name, slope in slopes.items():
            block, where = self.blocks[name], self.at[name]
            if block.by_trial:
                own = torch.arange(slope.shape[-1]) + where.start + trial[:, None] * slope.shape[-1]
                scale = block.scale(z[where]).reshape(len(block.mean), -1)[trial]
                found.scatter_(2, own[:, None].expand(-1, rows, -1), slope * scale[:, None])
            else:
                found[..., where] = slope * block.scale(z[where])
        return found
