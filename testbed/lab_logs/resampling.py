"""Series of several clocks' rates brought onto one base of 100 Hz."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation, Slerp

from testbed.lab_logs.logs import LogError, Series

RATE = 100.0
"""Samples a second of every trajectory."""
_FAST = 1.5
"""Times that rate, above which samples are averaged instead of interpolated."""


def common_base(series: Iterable[Series], longest_gap: float) -> Float[np.ndarray, "T"]:
    """Times at 100 Hz over the stretch that all series cover, s, by the log's clock.

    Raises:
        LogError: a series is silent for longer than `longest_gap` (s), or they do not overlap.
    """
    begins, ends = [], []
    for one in series:
        gaps = np.diff(one.time_s)
        at = int(np.argmax(gaps))
        if gaps[at] > longest_gap:
            raise LogError(
                f"log: silent for {gaps[at]:.3g} s at {one.time_s[at] - one.time_s[0]:.2f} s; allowed: "
                f"{longest_gap:g} s (longest_gap_s): what would be put there was never measured"
            )
        begins.append(one.time_s[0])
        ends.append(one.time_s[-1])
    begin, end = max(begins), min(ends)
    if end - begin < 1.0:
        raise LogError(f"log: its columns have {max(end - begin, 0.0):.2f} s in common; allowed: 1 s or more")
    return begin + np.arange(int((end - begin) * RATE + 1e-6) + 1) / RATE


def resampled(series: Series, base: Float[np.ndarray, "T"]) -> Float[np.ndarray, "T K"]:
    """Values at the base's times: averaged over each sample where they came faster, else interpolated."""
    time, values = series
    if np.median(np.diff(time)) * RATE * _FAST > 1:
        return np.column_stack([np.interp(base, time, column) for column in values.T])
    # a sensor integrates over its sample, and what is faster than the base must not fold into it
    total = make_interp_spline(time, values, k=1).antiderivative()
    low, high = (np.clip(base + side / (2 * RATE), time[0], time[-1]) for side in (-1, 1))
    return (total(high) - total(low)) / (high - low)[:, None]


def resampled_rotation(time: Float[np.ndarray, "N"], rotations: Rotation, base: Float[np.ndarray, "T"]) -> Rotation:
    """Orientations at the base's times, along the shortest turns between those logged."""
    return Slerp(time, rotations)(np.clip(base, time[0], time[-1]))
