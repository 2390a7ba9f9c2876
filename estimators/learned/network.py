"""Network: attention over windows and groups, and a conditional normalizing flow over the groups' loads.

The flow is autoregressive over the groups: the number of each group has an affine map and a spline, conditioned on
the groups before it. The number is the departure of the logarithm of its load from the first answer, in units of the
first answer's error.
Needs the extra `learned`.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn
from zuko.distributions import DiagNormal
from zuko.flows import Flow, MaskedAutoregressiveTransform, UnconditionalDistribution
from zuko.transforms import MonotonicRQSTransform

from estimators.learned.examples import Examples

FAR = 4.5
"""Bound of a departure from the first answer as an input of later groups, in errors of the first answer."""


@dataclass(frozen=True)
class Sizes:
    """Sizes of the network: numbers of an edge, a group and the whole, and widths."""

    edge: int
    group: int
    summary: int
    width: int = 48
    heads: int = 4
    layers: int = 2
    bins: int = 8


class Network(nn.Module):
    """Distribution of the loads of the groups of some examples."""

    def __init__(self, sizes: Sizes):
        super().__init__()
        self.sizes = sizes
        width = sizes.width
        for name in ("edge", "group", "summary"):
            self.register_buffer(f"{name}_mean", torch.zeros(getattr(sizes, name)))
            self.register_buffer(f"{name}_std", torch.ones(getattr(sizes, name)))
        self.of_group = _perceptron(sizes.group + sizes.summary + 2, width)
        self.of_edge = _perceptron(sizes.edge + width, width)
        self.over_windows = nn.MultiheadAttention(width, sizes.heads, batch_first=True)
        layer = {"dim_feedforward": 2 * width, "dropout": 0.0, "batch_first": True, "norm_first": True}
        self.over_groups = nn.TransformerEncoder(
            nn.TransformerEncoderLayer(width, sizes.heads, **layer), sizes.layers, enable_nested_tensor=False
        )
        self.before = nn.Linear(2, width)
        self.in_order = nn.TransformerEncoderLayer(width, sizes.heads, **layer)
        hidden = {"context": width, "hidden_features": (width,)}
        spline = {"univariate": MonotonicRQSTransform, "shapes": [(sizes.bins,), (sizes.bins,), (sizes.bins - 1,)]}
        base = UnconditionalDistribution(DiagNormal, torch.zeros(1), torch.ones(1), buffer=True)
        self.flow = Flow(
            [MaskedAutoregressiveTransform(1, **hidden), MaskedAutoregressiveTransform(1, **hidden, **spline)], base
        )

    def standardize(self, examples: Examples) -> None:
        """Set means and standard deviations of the inputs to those of examples."""
        present = (examples.windows[:, :, None] & examples.groups[:, None]).float()[..., None]
        for name, values, weight in (
            ("edge", examples.edges, present),
            ("group", examples.group, examples.groups.float()[..., None]),
            ("summary", examples.summary, torch.ones(len(examples), 1)),
        ):
            flat, share = values.flatten(0, -2), weight.flatten(0, -2) / weight.sum()
            mean = (flat * share).sum(0)
            std = ((flat - mean).square() * share).sum(0).sqrt()
            getattr(self, f"{name}_mean").copy_(mean)
            getattr(self, f"{name}_std").copy_(torch.where(std > 1e-6, std, 1.0))

    def encode(self, examples: Examples) -> Float[Tensor, "N G d"]:
        """Token of each group, from all windows and all groups."""

        def scaled(name: str, values: Tensor) -> Tensor:
            found = (values.float() - getattr(self, f"{name}_mean")) / getattr(self, f"{name}_std")
            return found.clamp(-6, 6)

        windows, groups = examples.edges.shape[1:3]
        whole = scaled("summary", examples.summary)[:, None].expand(-1, groups, -1)
        token = self.of_group(torch.cat([scaled("group", examples.group), whole, examples.center.float()], -1))
        seen = token[:, None].expand(-1, windows, -1, -1)
        edge = self.of_edge(torch.cat([scaled("edge", examples.edges), seen], -1))
        each = edge.transpose(1, 2).flatten(0, 1)  # a row per group: its windows
        hidden = ~examples.windows.repeat_interleave(groups, 0)
        query = token.reshape(-1, 1, token.shape[-1])
        token = token + self.over_windows(query, each, each, hidden, need_weights=False)[0].reshape(token.shape)
        return self.over_groups(token, src_key_padding_mask=~examples.groups)

    def log_prob(self, examples: Examples) -> Float[Tensor, "N"]:
        """Log density of the true departures, in units of the first answer's errors."""
        z = departures(examples).float()
        context = self._contexts(self.encode(examples), z)
        each = self.flow(context).log_prob(z[..., None])
        return (each * examples.groups).sum(1)

    def draw(self, examples: Examples, noise: Float[Tensor, "S N G"]) -> Float[Tensor, "S N G"]:
        """Draws of the logarithms of the loads, from standard normal numbers."""
        token, draws, groups = self.encode(examples), len(noise), noise.shape[-1]
        wide = token.repeat(draws, 1, 1)
        z = torch.zeros(draws * len(token), groups)
        for g in range(groups):  # each after those before it
            context = self._contexts(wide, z)[:, g]
            z = z.clone()
            z[:, g] = self.flow(context).transform.inv(noise.reshape(-1, groups)[:, g, None].float())[:, 0]
        root = torch.linalg.cholesky(examples.covariance)
        return examples.mean + torch.einsum("nij,snj->sni", root, z.reshape(noise.shape).double())

    def _contexts(self, token: Float[Tensor, "N G d"], z: Float[Tensor, "N G"]) -> Float[Tensor, "N G d"]:
        """Context of each group's number: its token, and tokens and numbers of the groups before it."""
        bounded = FAR * torch.tanh(z / FAR)
        shifted = torch.nn.functional.pad(torch.stack([bounded, torch.ones_like(z)], -1)[:, :-1], (0, 0, 1, 0))
        mask = torch.ones(z.shape[1], z.shape[1], dtype=torch.bool).triu(1)
        return self.in_order(token + self.before(shifted), src_mask=mask)


def departures(examples: Examples) -> Float[Tensor, "N G"]:
    """Departures of the truth from the first answer, whitened in the order of the groups."""
    root = torch.linalg.cholesky(examples.covariance)
    off = torch.where(examples.groups, examples.truth - examples.mean, 0.0)
    return torch.linalg.solve_triangular(root, off[..., None], upper=False)[..., 0]


def _perceptron(inputs: int, width: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, width), nn.GELU(), nn.Linear(width, width), nn.GELU())
