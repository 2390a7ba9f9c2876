"""Colors of mass groups: the same in scenes, films and recordings, and distinct to the color-blind."""

from __future__ import annotations

GROUP_COLORS = (
    "#0072B2", "#E69F00", "#661166", "#56B4E9", "#AA2200", "#99FF00",
    "#FFCCCC", "#4400BB", "#D55E00", "#665566", "#BB33FF", "#009E73",
)  # fmt: skip
"""Colors of the first twelve groups; further groups repeat them."""


def group_color(group: int) -> str:
    """Color of a mass group by its index, as #RRGGBB."""
    return GROUP_COLORS[group % len(GROUP_COLORS)]


def group_rgba(group: int) -> tuple[float, float, float, float]:
    """Color of a mass group by its index: red, green, blue and opacity, 0 to 1."""
    red, green, blue = (part / 255 for part in bytes.fromhex(group_color(group)[1:]))
    return red, green, blue, 1.0
