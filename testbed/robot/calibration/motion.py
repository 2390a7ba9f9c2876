"""Checks of trials by their motion: measured centers of rotation against the pivots and grasps of the actions.

The center of a turn follows from the motion of the hand alone, in the frame of TCP and closing direction; it does not
depend on the object's mass. A wrong closing direction turns all centers by one angle, a wrong TCP shifts them by one
vector, and a wrong grasp or pivot affects its own turn only.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from testbed.actions.base import Action
from testbed.errors import InvalidValueError
from testbed.frames import cross_2d, perpendicular, rotation_2d
from testbed.objects.model import ObjectShape
from testbed.robot.calibration.trial import Finding, check_trial, judged
from testbed.sensing.windows import SteadyWindow, steady_windows
from testbed.trajectory import Trajectory
from testbed.worlds.presets import UNSTATED
from testbed.worlds.setup_errors import EXACT_SETUP, PARAMETERS, SetupErrors

LEVER = 0.005
"""Least distance between pivot and grasp at which a turn determines the closing direction [m]."""
CENTER_ALLOWED = 0.003
"""Allowed distance of a turn's center from its stated place [m]."""
CLOSING_ALLOWED, TCP_ALLOWED = np.radians(1.0), 0.001
"""Allowed errors of the closing direction [rad] and of the TCP [m], beside three standard errors of each."""
CLOSING_EXACT, TCP_EXACT = np.radians(0.1), 1e-4
"""Allowed errors of closing direction [rad] and TCP [m] that are stated as exact, by three turns or more, whose scatter
is known."""
LEAST_SPREAD = 1e-4
"""Least standard error of a turn's center along an axis [m], since a few turns can agree by chance; chosen here."""
HEADING_ALLOWED = np.radians(5.0)
"""Allowed angle between a slide and its direction [rad]."""
SURE = 3.0


def check_motion(shape: ObjectShape, trajectories: Sequence[Trajectory]) -> list[Finding]:
    """Findings on closing direction, TCP, the grasp and pivot of every steady turn, and the direction of every slide.

    Args:
        shape: geometry and grasps of the object.
        trajectories: trials of it; failed ones, and actions other than turns and slides, are ignored.
    """
    steady = [t for t in trajectories if t.ok and t.action.turns and not t.action.accelerated]
    turned = [(t.action, windows) for t in steady if (windows := _windows(t))]
    slides = [t for t in trajectories if t.ok and t.action.dragged_steadily and not t.action.turns]
    slid = [_heading(shape, t.action, windows[0]) for t in slides if (windows := _windows(t))]
    if not turned:
        return slid
    named = np.array([_named(shape, action, action.hand(shape)) for action, _ in turned])
    seen = np.array([
        rotation_2d(-action.hand(shape)[1])
        @ np.mean([perpendicular(w.twist[:2]) / w.twist[2] for w in windows], axis=0)
        for action, windows in turned
    ])  # fmt: skip
    largest = SetupErrors.largest([t.setup for t in steady])
    setup, exact, findings = _stated(largest), _exact(largest) if len(turned) > 2 else set[str](), []
    held = np.hypot(setup.grasp_offset, setup.grasp_angle * np.linalg.norm(named, axis=1))
    allowed = CENTER_ALLOWED + SURE * held
    kinds = {"stated": named, "mirrored": named * [1, -1]}
    fits = {kind: _fit(seen, about, _agreeing(seen, about, allowed)) for kind, about in kinds.items()}
    kind = min(fits, key=lambda k: np.median(fits[k][2]) + (0.001 if k == "mirrored" else 0.0))
    if kind == "mirrored" and len(turned) > 1:
        off = float(np.median(fits["stated"][2]))
        text = (
            "the centers of the turns are those of the mirrored object: an axis of the object, or the yaw, is flipped"
        )
        findings.append(Finding("mirrored", False, off, text))
    else:
        kind = "stated"
    angle, offset, left, spread = fits[kind]
    if (left > allowed).sum() > len(left) / 2:  # no common error explains them
        angle, offset, left = 0.0, np.zeros(2), np.linalg.norm(seen - kinds[kind], axis=1)
    else:
        findings += _common(angle, offset, max(spread, LEAST_SPREAD), named, setup, exact)
    for (action, _), at, miss, most in zip(turned, seen, left, allowed, strict=True):
        if miss > most:
            findings.append(_wrong(shape, action, rotation_2d(-angle) @ (at - offset), miss))
    if not any(f.what == "center" for f in findings):
        worst = float(left.max())
        text = f"turns about the points that the actions name, {len(turned)} of them, to {1e3 * worst:.1f} mm"
        findings.append(Finding("center", True, worst, text))
    return [*findings, *(slid if all(f.ok for f in findings) else [])]  # a yaw that is off turns slides too


def _windows(trial: Trajectory) -> list[SteadyWindow]:
    """Windows of a trial; none of one too short to reduce, which no estimate uses either."""
    try:
        return steady_windows(trial)
    except InvalidValueError:
        return []


def _heading(shape: ObjectShape, action: Action, window: SteadyWindow) -> Finding:
    """Finding on the direction of a slide, in the object's frame."""
    along, seen = action.heading, window.twist[:2]
    off = float(np.arctan2(cross_2d(along, seen), along @ seen))
    text = f"{action.describe(shape)}: it moves {np.degrees(off):+.0f} deg off that direction"
    return judged("heading", abs(off) <= HEADING_ALLOWED, off, text, "correct its direction, rad in the object's frame")


def check_wrenches(shape: ObjectShape, trajectories: Iterable[Trajectory]) -> list[Finding]:
    """Findings of `check_trial` on the windows of every slide and turn at constant speed, of trials that ended well.

    Trailing links deflect the force, and move between the turns there and back: for an object with hinges only the
    sign of the power is checked.
    """
    gripped = [t for t in trajectories if t.action.dragged_steadily]
    found = [finding for t in gripped for finding in check_trial(None, None, _windows(t), setup=_stated(t.setup))]
    return [finding for finding in found if shape.chain is None or finding.what == "friction"]


def wrong_motion(shape: ObjectShape, trajectories: Sequence[Trajectory]) -> list[str]:
    """Significant errors of the trials of an object, in sentences.

    All failed checks of `check_motion`, and one of each kind of `check_trial`, without those of a drag below the noise.
    """
    found = check_wrenches(shape, (t for t in trajectories if t.ok))
    sure = {f.what: f for f in reversed(found) if not f.ok and f.decided}
    return [f.text for f in [*check_motion(shape, trajectories), *sure.values()] if not f.ok]


def _stated(setup: SetupErrors) -> SetupErrors:
    """Stated errors of the setup; one at its default counts as not stated, and is 0."""
    defaults = {name for name in PARAMETERS if getattr(setup, name) == getattr(UNSTATED, name)}
    return replace(setup, **{name: getattr(EXACT_SETUP, name) for name in defaults})


def _exact(setup: SetupErrors) -> set[str]:
    """Names of errors that are stated as 0 and have another default."""
    return {name for name in PARAMETERS if not getattr(setup, name) and getattr(UNSTATED, name)}


def _named(shape: ObjectShape, action: Action, hand: tuple[np.ndarray, float]) -> Float[np.ndarray, "2"]:
    """Pivot of an action relative to a hand at a place [m] and closing direction [rad]; x along that direction [m]."""
    place, angle = hand
    return rotation_2d(-angle) @ (action.center(shape) - place)


def _agreeing(
    seen: Float[np.ndarray, "K 2"], named: Float[np.ndarray, "K 2"], allowed: Float[np.ndarray, "K"]
) -> Bool[np.ndarray, "K"]:
    """Mask of the centers at their stated places if these are the majority, else of all.

    With a majority the other centers have errors of their own.
    """
    agree, far = np.linalg.norm(seen - named, axis=1) <= allowed, np.linalg.norm(named, axis=1) > LEVER
    informative = far if far.any() else np.ones_like(far)  # a turn about the grasp shows no closing direction
    return agree if (agree & informative).sum() > informative.sum() / 2 else np.ones_like(far)


def _fit(
    seen: Float[np.ndarray, "K 2"], named: Float[np.ndarray, "K 2"], counted: Bool[np.ndarray, "K"]
) -> tuple[float, Float[np.ndarray, "2"], Float[np.ndarray, "K"], float]:
    """Turn [rad] and shift [m] from stated to measured centers, residual distances [m], and their spread per axis [m].

    Fitted to the `counted` centers by iteratively reweighted least squares, so that outliers have little weight.
    """
    weight = counted.astype(float)
    far = counted & (np.linalg.norm(named, axis=1) > LEVER)
    angle, offset, left = 0.0, np.zeros(2), np.zeros(len(seen))
    for _ in range(30):
        w = weight / weight.sum()
        shifted = counted.sum() > 2 or not far.any()  # two centers show no more than a turn
        a, b = (points - shifted * (w @ points) for points in (named, seen))
        if far.any():
            angle = float(np.arctan2((weight * cross_2d(a, b)).sum(), (weight * (a * b).sum(axis=1)).sum()))
        turned = named @ rotation_2d(angle).T
        offset = w @ (seen - turned) if shifted else np.zeros(2)
        left = np.linalg.norm(seen - turned - offset, axis=1)
        weight = counted / np.maximum(left, 2e-4)
    good = counted & (left <= max(CENTER_ALLOWED, 2 * float(np.median(left[counted]))))
    freedom = max(2 * int(good.sum()) - 3, 1)
    return angle, offset, left, float(np.sqrt((left[good] ** 2).sum() / freedom))


def _common(
    angle: float, offset: np.ndarray, spread: float, named: np.ndarray, setup: SetupErrors, exact: set[str]
) -> list[Finding]:
    """Findings on closing direction and TCP, the errors that all turns share."""
    lever, count = float(np.sqrt(((named - named.mean(axis=0)) ** 2).sum())), len(named)
    findings = []
    if (named**2).sum() > LEVER**2:
        reach = max(lever, float(np.linalg.norm(named[0])) if count < 3 else lever, 1e-3)
        error, held = spread / reach, [setup.grasp_offset / reach, (count < 3) * setup.tcp_offset / reach]
        allowed = CLOSING_EXACT if {"tcp_angle", "grasp_angle"} <= exact else CLOSING_ALLOWED
        ok = abs(angle) <= allowed + SURE * np.linalg.norm([error, setup.tcp_angle, setup.grasp_angle, *held])
        text = f"by the centers of the turns the pads close {np.degrees(angle):+.1f} +- {np.degrees(error):.1f} deg off"
        off = float(np.degrees(angle))  # about the vertical; the hand's z axis points down
        why = f"correct closing_deg by {-off:+.1f} (z axis that points up: {off:+.1f})"
        findings.append(judged("closing direction", ok, angle, text, why))
    if count > 2 or not findings:
        error, far = spread / count**0.5, float(np.linalg.norm(offset))
        allowed = TCP_EXACT if {"tcp_offset", "grasp_offset"} <= exact else TCP_ALLOWED
        ok = far <= allowed + SURE * np.linalg.norm([error, setup.tcp_offset, setup.grasp_offset])
        x, y = 1e3 * offset
        text = f"the centers lie ({x:+.1f}, {y:+.1f}) +- {1e3 * error:.1f} mm off, along the closing direction and left"
        why = f"correct the TCP by ({x:+.1f}, {-y:+.1f}) mm, x as the pads close (z axis that points up: y {y:+.1f})"
        findings.append(judged("TCP", ok, far, text, why))
    return findings


def _wrong(shape: ObjectShape, action: Action, seen: np.ndarray, miss: float) -> Finding:
    """Finding on a turn with a wrong center, with the grasps that fit it."""
    x, y = 1e3 * seen
    others = [grasp for index, grasp in enumerate(shape.grasps) if index != action.grasp]
    named = [_named(shape, action, (grasp.position, grasp.angle)) for grasp in others]
    fitting = [g.name for g, one in zip(others, named, strict=True) if np.linalg.norm(one - seen) < CENTER_ALLOWED]
    would = f"; grasp {' or '.join(fitting)} would fit" if fitting else "; grasp or pivot is another than it says"
    should_x, should_y = 1e3 * _named(shape, action, action.hand(shape))
    text = (
        f"{action.describe(shape)}: from the grasp, along the closing direction and across, its center should be "
        f"({should_x:.0f}, {should_y:.0f}) mm and is ({x:.0f}, {y:.0f}) mm, less what all turns have in common{would}"
    )
    return Finding("center", False, miss, text)
