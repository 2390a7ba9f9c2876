"""The paper's own figures, on the real robot: Tables tab:nad and tab:mpd."""

from __future__ import annotations

_BLOCKS = ("I1", "I2", "L1", "L2", "F1", "F2")
_ALL = (*_BLOCKS, "hammer", "wrench")

NAD: dict[str, dict[str, float]] = {
    "hidden_states_published": dict(zip(_BLOCKS, (7.4, 9.2, 10.1, 7.3, 8.5, 14.2), strict=True)),
    "random_search": dict(zip(_BLOCKS, (56.5, 32.6, 31.1, 46.4, 24.2, 42.9), strict=True)),
    "weighted_sampling": dict(zip(_BLOCKS, (30.1, 25.1, 44.4, 32.9, 27.9, 25.0), strict=True)),
    "explicit_state": dict(zip(_BLOCKS, (18.2, 22.7, 35.0, 29.4, 22.8, 34.9), strict=True)),
    "diff_lcp": dict(zip(_BLOCKS, (44.2, 51.7, 32.2, 50.4, 36.3, 68.5), strict=True)),
}
"""Normalized absolute difference, %, by method and object."""
MPD: dict[str, dict[str, float]] = {
    "hidden_states_published": dict(zip(_ALL, (1.2, 1.5, 1.1, 0.8, 1.6, 2.2, 1.9, 1.3), strict=True)),
    "random_search": dict(zip(_ALL, (9.1, 13.8, 7.6, 8.2, 9.3, 9.6, 3.4, 6.1), strict=True)),
    "weighted_sampling": dict(zip(_ALL, (5.4, 9.8, 5.8, 5.9, 4.6, 7.5, 4.0, 4.2), strict=True)),
    "explicit_state": dict(zip(_ALL, (1.7, 2.6, 1.8, 1.5, 2.9, 3.2, 3.3, 3.6), strict=True)),
    "diff_lcp": dict(zip(_ALL, (6.2, 5.3, 6.8, 4.8, 3.5, 7.3, 4.6, 3.7), strict=True)),
}
"""Mean particle distance, cm, by method and object."""
