"""Series of several rates on one time base of 100 Hz, and the phases of a trial on it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import Float, Int
from numpy.lib.stride_tricks import sliding_window_view
from scipy.interpolate import make_interp_spline
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation, Slerp

from testbed.actions.base import Action
from testbed.importers.logs import LogError, Series
from testbed.importers.mapping import PhaseWindow
from testbed.sensing.series import interpolated, runs
from testbed.trajectory import Phase

RATE = 100.0
"""Sample rate of every trajectory [Hz]."""
_FAST = 1.5
"""Multiple of that rate above which samples are averaged instead of interpolated."""
_SHORTEST_STEP = 0.2
"""Shortest stretch [s]."""
_LEAST_SLOPE = 0.1
"""Change of speed below which it is constant, as a part of the largest change."""
_GRID = 0.02
"""Time between the places where a stretch may begin [s]."""
_PENALTY = 2e-3
"""Cost of a further stretch, as a part of the speed's largest square, times seconds."""
Phases = tuple[Int[np.ndarray, "T"], Int[np.ndarray, "T"]]
"""Phase and steady stretch of every sample, each of shape (T,); the stretch is -1 outside."""
STEADY_WITHIN = 0.1
"""Largest deviation of a stretch from the action's speed, as a part of it."""
PUSHED_WITHIN = 0.5
"""Largest deviation of a push before its end, as part of its speed: the arm yields as the fingertip makes contact."""
_UPRIGHT = 0.7
"""Least ratio of a hand's turn rate about the vertical to its whole turn rate. Ours."""
STILL = (0.002, np.radians(0.5))
"""Speeds below which the tool is at rest [m/s, rad/s]."""
ABOVE = 0.01
"""Height above the grasp from which the hand is empty [m]."""
SHORTEST_TARE = 0.3
"""Shortest tare [s]."""
_LONGEST_EQUAL = 0.5
"""Time for which a component of a moving sensor may keep one value [s]."""
_STUCK_PROBABILITY = 1e-9
"""Probability of a run of equal values under noise, below which the component is stuck. Ours."""
COMPONENTS = ("fx", "fy", "fz", "tx", "ty", "tz")
SPIKE = 20.0
"""Least ratio of the distance between a spike and the samples beside it to the standard deviation of such distances,
and to the change from before the spike to after it. Ours."""
SMALLEST_SPIKE = (10.0, 10.0, 10.0, 1.0, 1.0, 1.0)
"""Least distance of a spike from the samples beside it [N, N m]: more than a fingertip's chatter. Ours."""
BESIDE = 3
"""Samples on each side of a spike with which it is compared."""
MOST_LEFT_OUT = 0.2
"""Largest fraction of lost frames and spikes in a log. Ours."""
MOST_NAMED = 3
"""Largest number of spikes of a component whose times are listed."""
_SHORTEST_LOG = 0.5
"""Shortest stretch that all columns of a log cover [s]: the duration of a push at 0.2 m/s."""
ROUNDING = 1e-5
"""Rounding of a difference of logged times [s]."""
_PAUSE = 1.0
"""Gap from which an error suggests several trials, or another unit of time [s]."""
_SMOOTHING = 0.25
"""Time over which motion is averaged [s]."""


def common_base(series: Iterable[Series], longest_gap: float) -> Float[np.ndarray, "T"]:
    """Times at 100 Hz over the stretch that all series cover, by the log's clock [s].

    Raises:
        LogError: a series has a gap longer than `longest_gap` [s], or they do not overlap.
    """
    begins, ends = [], []
    for one in series:
        gaps = np.diff(one.time_s)
        at, usual = int(np.argmax(gaps)), float(np.median(gaps))
        if gaps[at] > longest_gap + ROUNDING:
            silent = f"{gaps[at]:.3g}" if gaps[at] > 1.01 * longest_gap else f"{gaps[at]:.6g}"
            given = f"silent for {silent} s at {one.time_s[at] - one.time_s[0]:.2f} s"
            hint = "; several trials in one log: give from_s and to_s of each" if gaps[at] > _PAUSE else ""
            if usual > 1.01 * longest_gap:
                given = f"a sample every {usual:.3g} s"
                hint = "; is time.unit another (ms, us, ns)?" if usual > _PAUSE else ""
            raise LogError(
                f"log: {given}; allowed: {longest_gap:g} s (longest_gap_s): interpolated values, or repeated ones, are "
                f"no measurements{hint}"
            )
        begins.append(one.time_s[0])
        ends.append(one.time_s[-1])
    begin, end = max(begins), min(ends)
    if end - begin < _SHORTEST_LOG:
        raise LogError(
            f"log: its columns have {max(end - begin, 0.0):.2f} s in common; allowed: {_SHORTEST_LOG:g} s or more"
        )
    return begin + np.arange(int((end - begin) * RATE + 1e-6) + 1) / RATE


def without_faults(wrench: Series) -> tuple[Series, str]:
    """Wrench without samples that measure nothing, and what was left out, in words; empty where nothing was.

    These are rows of six zeros, which drivers report where a frame is lost, and single spikes: a component far from
    the medians of `BESIDE` samples before and after it, which agree.

    Raises:
        LogError: all are zeros, or more than `MOST_LEFT_OUT` of them measure nothing.
    """
    time, values = wrench
    zero = (values == 0).all(axis=1)
    if zero.all():
        raise LogError(f"sensor: all {len(zero)} samples are zeros; allowed: a sensor that measures")
    inside = np.flatnonzero(~zero)
    spikes = np.zeros(values.shape, dtype=bool)
    for k, smallest in enumerate(SMALLEST_SPIKE if len(inside) > 2 * BESIDE else ()):
        near = sliding_window_view(values[inside, k], 2 * BESIDE + 1)
        before, after = (np.median(side, axis=1) for side in (near[:, :BESIDE], near[:, BESIDE + 1 :]))
        off = np.abs(near[:, BESIDE] - (before + after) / 2)
        limit = max(SPIKE * 1.4826 * float(np.median(off)), smallest)
        spikes[inside[BESIDE:-BESIDE], k] = (off > limit) & (np.abs(after - before) < off / SPIKE)  # an impact stays
    left_out = zero | spikes.any(axis=1)
    if left_out.mean() > MOST_LEFT_OUT:
        raise LogError(
            f"sensor: {left_out.sum()} of {len(zero)} samples are zeros or spikes; allowed: {100 * MOST_LEFT_OUT:g} %"
        )
    parts = [f"{zero.sum()} samples of six zeros"] * bool(zero.any())
    for name, found in zip(COMPONENTS, spikes.T, strict=True):
        if found.any():
            times = [f"{t:.2f}" for t in time[found][:MOST_NAMED] - time[0]] + ["..."] * int(found.sum() > MOST_NAMED)
            parts.append(f"{found.sum()} spike{'s' * int(found.sum() > 1)} of {name} at {', '.join(times)} s")
    return Series(time[~left_out], values[~left_out]), "; ".join(parts)


def check_sensor_alive(wrench: Series, moved: Float[np.ndarray, "2"], measured: Sequence[bool]) -> None:
    """Check that no component of the wrench is stuck, in the whole log or while the object moves.

    Args:
        wrench: as logged.
        moved: begin and end of the motion, by the log's clock [s].
        measured: False for components that the mapping gives as constants.

    Raises:
        LogError: a component with one value in all samples, or for longer in motion than its noise explains.
    """
    inside = (wrench.time_s >= moved[0]) & (wrench.time_s <= moved[1])
    time = wrench.time_s[inside]
    for name, column, counts in zip(COMPONENTS, wrench.values.T, measured, strict=True):
        if not counts:
            continue
        levels = np.unique(column)
        if len(levels) == 1:
            raise LogError(f"sensor: {name} is {column[0]:g} in all samples; allowed: a component that is measured")
        steps = np.abs(np.diff(column))
        several_counts = np.median(steps[steps > 0]) > 3 * np.diff(levels).min()
        longest = max((len(run) for run in runs(steps == 0)), default=0)
        equal = ((steps == 0).sum() - longest + 1) / (len(steps) - longest + 1)  # without the longest run
        for run in runs(np.diff(column[inside]) == 0):
            seconds = time[run[-1] + 1] - time[run[0]]
            improbable = several_counts or len(run) * np.log(equal) < np.log(_STUCK_PROBABILITY)
            if seconds > _LONGEST_EQUAL and improbable:
                raise LogError(
                    f"sensor: {name} stays at {column[inside][run[0]]:g} for {seconds:.2g} s from "
                    f"{time[run[0]] - wrench.time_s[0]:.2f} s, in motion; allowed: {_LONGEST_EQUAL:g} s: it was stuck, "
                    "or clipped"
                )


def resampled(series: Series, base: Float[np.ndarray, "T"]) -> Float[np.ndarray, "T K"]:
    """Values at the base's times: averaged over each sample if the series is faster, else interpolated."""
    time, values = series
    if np.median(np.diff(time)) * RATE * _FAST > 1:
        return interpolated(base, time, values)
    # averaging, as a sensor does over its sample, keeps fast signals from aliasing
    total = make_interp_spline(time, values, k=1).antiderivative()
    low, high = (np.clip(base + side / (2 * RATE), time[0], time[-1]) for side in (-1, 1))
    return (total(high) - total(low)) / (high - low)[:, None]


def resampled_rotation(time: Float[np.ndarray, "N"], rotations: Rotation, base: Float[np.ndarray, "T"]) -> Rotation:
    """Orientations at the base's times, along the shortest turns between logged ones."""
    return Slerp(time, rotations)(np.clip(base, time[0], time[-1]))


def phases_from_windows(windows: Sequence[PhaseWindow], time: Float[np.ndarray, "T"], zeroed: bool = False) -> Phases:
    """Phases by the mapping's windows; a zeroed sensor needs no tare, and is not zeroed again by one after the motion.

    Samples between windows are approach before the first steady window, ramp before the end of the last one, and
    release after it.

    Raises:
        LogError: no steady window, no tare before the first one, a tare shorter than `SHORTEST_TARE`, a tare or steady
            window beyond the log's end, or a window without a sample.
    """
    phase, segment = np.full(len(time), Phase.RELEASE), np.full(len(time), -1)
    steady, tares = ([w for w in windows if w.kind == kind] for kind in (Phase.STEADY, Phase.TARE))
    tared = bool(steady) and any(tare.from_s < steady[0].from_s for tare in tares)
    if not (steady and (tared or zeroed)):
        raise LogError('phases: allowed: one or more "steady", after one or more "tare"')
    for tare in tares:
        if tare.to_s - tare.from_s < SHORTEST_TARE - 1e-9:
            given = f"{tare.from_s:g} to {tare.to_s:g} s"
            raise LogError(f"phases: {tare.phase} at {given}; allowed: {SHORTEST_TARE:g} s or more")
    if not tared:
        windows = [w for w in windows if w.kind != Phase.TARE]
    phase[time < steady[-1].to_s] = Phase.RAMP
    phase[time < steady[0].from_s] = Phase.APPROACH
    for window in windows:
        inside = (time >= window.from_s) & (time < window.to_s)
        ends_early = window.to_s > time[-1] + 1.5 / RATE and window.kind in (Phase.TARE, Phase.STEADY)
        if not inside.any() or ends_early:
            given, ends = f"{window.from_s:g} to {window.to_s:g} s", f"{time[0]:.2f} to {time[-1]:.2f} s"
            raise LogError(f"phases: {window.phase} at {given}; allowed: within the log's {ends}")
        phase[inside] = window.kind
    for i, window in enumerate(steady):
        segment[(time >= window.from_s) & (time < window.to_s)] = i
    segment[phase != Phase.STEADY] = -1
    return phase, segment


def phases_from_motion(
    action: Action, height: Float[np.ndarray, "T"], velocity: Float[np.ndarray, "T 6"], zeroed: bool = False
) -> Phases:
    """Phases of a turn, a slide or a push from the tool's motion at 100 Hz.

    The tool is steady at the action's speed. Its rests above the grasp are tares: the last one before the motion, and
    the last one after it.

    Args:
        action: the recorded action.
        height: height of the TCP [m].
        velocity: velocity of the TCP, base axes [m/s, rad/s].
        zeroed: True if the sensor was zeroed before the log, which then needs no tare.

    Raises:
        LogError: an accelerated turn, another number of steady stretches than the action has, or no tare.
    """
    if action.accelerated:
        raise LogError("phases: those of an accelerated turn are not found from motion; give them as [[phases]]")
    smooth = uniform_filter1d(velocity, round(_SMOOTHING * RATE), axis=0)
    rate = _rate(action, smooth)
    if action.turns:
        fast = np.linalg.norm(smooth[:, 3:], axis=1) - abs(action.steady[0].speed)
        _check_upright(smooth[np.abs(fast) < STEADY_WITHIN * abs(action.steady[0].speed), 3:])
    stretches = _steady(action, rate)
    count, first, last = len(rate), int(stretches[0][0]), int(stretches[-1][-1])
    still = np.linalg.norm(smooth[:, :3], axis=1) < STILL[0]
    still &= np.linalg.norm(smooth[:, 3:], axis=1) < STILL[1]
    held = float(np.median(height[np.concatenate(stretches)]))
    tares = [run for run in runs(still & (height > held + ABOVE)) if len(run) >= SHORTEST_TARE * RATE]
    before, after = [t for t in tares if t[-1] < first], [t for t in tares if t[0] > last]
    if not (before or zeroed):
        raise LogError(
            f"phases: no tare: the tool never rests for {SHORTEST_TARE:g} s, {1e3 * ABOVE:.0f} mm or more over where "
            "it holds the object, before it moves it; give [[phases]], or sensor.zeroed = true if it was zeroed before"
        )
    phase, segment = np.full(count, Phase.RELEASE), np.full(count, -1)
    down, starts = (
        int(np.flatnonzero(inside)[-1]) + 1 if inside.any() else 0
        for inside in (height[:first] > held + ABOVE / 5, still[:first])
    )
    stops = last + 1 + int(np.argmax(np.append(still[last + 1 :], True)))
    phase[:down] = Phase.APPROACH
    phase[down:starts] = Phase.SETTLE
    phase[starts:stops] = Phase.RAMP
    for i, stretch in enumerate(stretches):
        phase[stretch], segment[stretch] = Phase.STEADY, i
    for tare in (before[-1], *after[-1:]) if before else ():  # a zeroed sensor is not zeroed again
        phase[tare] = Phase.TARE
    return phase, segment


def check_stretches(action: Action, velocity: Float[np.ndarray, "T 6"], segment: Int[np.ndarray, "T"]) -> None:
    """Check the speed and sense of mapped stretches against the action, and the axis of every turn.

    Args:
        action: the recorded action.
        velocity: velocity of the TCP, base axes [m/s, rad/s].
        segment: steady stretch of every sample, -1 outside.

    Raises:
        LogError: another speed, sense or axis.
    """
    smooth = uniform_filter1d(velocity, round(_SMOOTHING * RATE), axis=0)
    if action.turns:
        _check_upright(smooth[segment >= 0, 3:])
    if action.accelerated or action.pushes:
        return
    rate, wanted = _rate(action, smooth), np.array([stretch.speed for stretch in action.steady])
    measured = np.array([np.median(rate[segment == index]) for index in range(segment.max() + 1)])
    same = len(measured) == len(wanted)  # there and back, else either one
    off = measured - wanted if same else np.abs(measured) - np.abs(wanted[0])
    if (np.abs(off) >= STEADY_WITHIN * np.abs(wanted[0])).any():
        asked, found = (", ".join(_speed_words(float(v), *_unit(action)) for v in each) for each in (wanted, measured))
        raise LogError(f"phases: the action turns or slides at {asked}; the log at {found}; correct the action's speed")


def _check_upright(turning: Float[np.ndarray, "N 3"]) -> None:
    """Check that the hand turns about the vertical, by its angular velocities while it turns [rad/s], base axes."""
    mean = np.abs(turning).mean(axis=0) if len(turning) else np.array([0.0, 0.0, 1.0])
    if mean[2] < _UPRIGHT * np.linalg.norm(mean):
        given = ", ".join(f"{rate:.3g}" for rate in mean)
        raise LogError(
            f"hand: it turns at ({given}) rad/s about x, y and z; allowed: about z, which points up; is the order of "
            "the quaternion another, or another axis of the base vertical (hand.base_wxyz)?"
        )


def _rate(action: Action, velocity: Float[np.ndarray, "T 6"]) -> Float[np.ndarray, "T"]:
    """Turn rate [rad/s], or speed of a slide or a push [m/s], shape (T,)."""
    return velocity[:, 5] if action.turns else np.linalg.norm(velocity[:, :2], axis=1)


def _unit(action: Action) -> tuple[str, float]:
    """Second unit of a speed in errors, and its factor."""
    return ("deg/s", 180 / np.pi) if action.turns else ("mm/s", 1e3)


def _steady(action: Action, rate: np.ndarray) -> list[np.ndarray]:
    """Samples of the stretches at the action's speed, in order, each at least half as long as the action states."""
    speed, _, seconds = action.steady[0]
    if action.pushes:
        near = runs(np.abs(rate - speed) < PUSHED_WITHIN * speed)
        pushed = [
            run[: np.flatnonzero(rate[run] > (1 - STEADY_WITHIN) * speed)[-1] + 1]
            for run in near
            if abs(np.median(rate[run]) - speed) < STEADY_WITHIN * speed
        ]
        stretches = [run for run in pushed if len(run) >= seconds * RATE / 2]
    else:
        close = np.abs(np.abs(rate) - abs(speed)) < STEADY_WITHIN * abs(speed)
        stretches = [run for run in runs(close) if len(run) >= seconds * RATE / 2]
    wanted = [stretch.speed for stretch in action.steady]
    if [np.sign(rate[s].mean()) for s in stretches] == np.sign(wanted).tolist():
        return stretches
    unit, scale = _unit(action)
    asked = ", ".join(_stretch_words(w, seconds, unit, scale) for w in wanted)
    measured = [(float(np.median(rate[s])), len(s) / RATE) for s in stretches] or _constant_speeds(rate)
    fastest, none = float(np.abs(rate).max()), "none: its speed is never constant"
    if fastest < STILL[action.turns]:
        none = f"none: it does not {'turn' if action.turns else 'move'}"
    found = (
        ", ".join(_stretch_words(*one, unit, scale) for one in measured)
        or f"{none}, at most {_speed_words(fastest, unit, scale)}"
    )
    raise LogError(
        f"phases: the action has steady stretches of {asked}; the log has {found}; correct the action's speed and "
        "duration, or give [[phases]]"
    )


def _speed_words(speed: float, unit: str, scale: float) -> str:
    return f"{speed:+.4g} {'rad/s' if unit == 'deg/s' else 'm/s'} ({scale * speed:+.3g} {unit})"


def _stretch_words(speed: float, seconds: float, unit: str, scale: float) -> str:
    return f"{_speed_words(speed, unit, scale)} for {seconds:.1f} s"


def _constant_speeds(rate: np.ndarray) -> list[tuple[float, float]]:
    """Speed and duration [s] of every stretch of at least 0.5 s in which the speed stays near its median."""
    found = []
    for run in runs(np.abs(rate) > STILL[0]):
        speed = float(np.median(rate[run]))
        close = [r for r in runs(np.abs(rate[run] - speed) < STEADY_WITHIN * abs(speed)) if len(r) >= RATE / 2]
        found += [(speed, len(r) / RATE) for r in close]
    return found


def linear_stretches(rate: Float[np.ndarray, "T"]) -> list[tuple[float, np.ndarray]]:
    """Slope and samples of every stretch of constant acceleration of a motion from rest to rest.

    The ramps at its ends, and constant speeds beside them, are left out.

    Args:
        rate: speed at 100 Hz.
    """
    step = round(_GRID * RATE)
    ends = np.arange(0, len(rate) + 1, step)
    time = np.arange(len(rate)) / RATE
    sums = np.vstack([np.zeros(5), np.cumsum([time**0, time, time**2, rate, time * rate], axis=1).T])
    squares = np.concatenate([[0.0], np.cumsum(rate**2)])
    least, best, previous = round(_SHORTEST_STEP / _GRID), np.full(len(ends), np.inf), np.zeros(len(ends), dtype=int)
    best[0], penalty = 0.0, _PENALTY * float((rate**2).max()) * RATE
    for last in range(least, len(ends)):
        first = np.arange(0, last - least + 1)
        n, t, tt, y, ty = (sums[ends[last]] - sums[ends[first]]).T
        yy = squares[ends[last]] - squares[ends[first]]
        spread, along = tt - t**2 / n, ty - t * y / n
        left = best[first] + np.maximum(yy - y**2 / n - along**2 / spread, 0.0) + penalty
        previous[last] = int(np.argmin(left))
        best[last] = left[previous[last]]
    cuts = [len(ends) - 1]
    while cuts[-1] > 0:
        cuts.append(int(previous[cuts[-1]]))
    places = [np.arange(ends[a], ends[b]) for a, b in zip(cuts[:0:-1], cuts[-2::-1], strict=True)]
    found = [(float(np.polyfit(time[place], rate[place], 1)[0]), place) for place in places]
    inner = found[1:-1]
    largest = max((abs(slope) for slope, _ in inner), default=0.0)
    while inner and abs(inner[0][0]) < _LEAST_SLOPE * largest:
        inner = inner[1:]
    while inner and abs(inner[-1][0]) < _LEAST_SLOPE * largest:
        inner = inner[:-1]
    return inner
