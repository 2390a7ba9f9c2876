"""Reduction of an object's trials to one batch of windows: turns and slides, of links too, and pushes."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache, partial

import numpy as np
import torch

from estimators.particles.links import carried_moment
from estimators.particles.motion import LinkMotion, Motion
from estimators.particles.windows import PLANAR, Observations
from estimators.wrench.model import ModelErrors, ParticleModel
from estimators.wrench.support import load_map, shrunken_load
from testbed.actions.base import Action
from testbed.objects.model import ObjectShape
from testbed.sensing.link_windows import link_windows
from testbed.sensing.push_windows import push_windows
from testbed.sensing.windows import SteadyWindow, check_trials, reduced_trials, steady_windows
from testbed.trajectory import Trajectory
from testbed.worlds.setup_errors import SetupErrors

HAS_HINGES = (
    "an object with hinges, which this method takes for one piece: hidden_states, bayes and least_squares know links"
)
"""Message of a method that takes no articulated object."""
ONE_BODY = "not every mass group has feet of its own to rest on: it is one rigid body, for support_aware"
NO_DATA = "no trajectory with status ok that slides or turns at constant speed, for 1.2 s or more"
NO_DRAG = "every force at constant speed is zero, as of a dead sensor"
NO_LINKS = f"{NO_DATA} while every link moves steadily: grip another link, or move across the links"


def observe(
    shape: ObjectShape, trajectories: Sequence[Trajectory], errors: ModelErrors | None = None
) -> Observations | None:
    """Steady windows of all usable trajectories of one object; None where there is none.

    Weighings, lifts, trials that did not end well and those too short to reduce are left out. Of `errors`, only the
    load of a nulled gripper counts here.

    Raises:
        InvalidValueError: a grasp that the shape does not have, no shape, something other than trajectories, or a
            record of too few samples a second.
    """
    check_trials(shape, trajectories)
    found = _observed(shape, tuple(trajectories), errors or ModelErrors())
    return None if found is None else found.like({name: value.clone() for name, value in found.by_window.items()})


@lru_cache(maxsize=8)
def _observed(shape: ObjectShape, trajectories: tuple[Trajectory, ...], errors: ModelErrors) -> Observations | None:
    """Windows of trials, cached for the methods and misfits that need those of the same trials."""
    windows: list[SteadyWindow] = []
    trial: list[int] = []
    accelerated: list[bool] = []

    def counts(action: Action) -> bool:
        return action.dragged or (action.pushes and shape.chain is None)

    for index, found in reduced_trials(shape, trajectories, counts, partial(_table_windows, shape)).items():
        windows += found
        trial += [index] * len(found)
        accelerated += [trajectories[index].action.accelerated] * len(found)
    if not windows:
        return None
    wrench = np.array([w.wrench for w in windows])
    from_sensor = np.array([w.from_sensor for w in windows])
    std = np.array([trajectories[index].sensor_bias_std for index in trial])
    stated = np.einsum("kij,kj,klj->kil", from_sensor, std**2, from_sensor)
    noise, bias = _pooled(windows, stated, np.array(trial), np.array(accelerated))
    to_load = np.array([load_map(w.tcp_height) for w in windows])
    drift = np.array([w.drift_covariance for w in windows])
    off = bias + np.array([w.since_tare.mean() for w in windows])[:, None, None] * drift
    setup = SetupErrors.largest([trajectories[index].setup for index in set(trial)])
    drag = torch.tensor(np.linalg.norm(wrench[:, :2], axis=1).max())
    likely = shrunken_load(
        np.einsum("kij,kj->ki", to_load, wrench),
        np.einsum("kij,kjl,kil->ki", to_load, off, to_load),
        np.einsum("kij,kjl,kil->ki", to_load, noise, to_load),
        np.array(trial),
        np.array(accelerated),
        errors.nulled,
        np.array([w.grasp is None for w in windows]),
        float(carried_moment(ParticleModel.of(shape), drag, setup)),
        links=shape.chain is not None,
    )
    motion = Motion.of(shape, windows, trial, accelerated)
    values: dict[str, np.ndarray] = {
        "wrench": wrench[:, PLANAR],
        "sensed": np.linalg.solve(from_sensor, wrench[..., None])[..., 0],
        "from_sensor": from_sensor,
        "tool_tilt": np.array([w.tool_tilt for w in windows]),
        "noise": noise,
        "bias": bias,
        "drift": drift,
        "lift": likely.load[:, 0],
        "tilt": likely.load[:, 1:],
        "load_map": to_load,
        "load_kept": likely.kept,
        "load_followed": likely.followed,
        "load_size": likely.size,
        "load_change": likely.change,
    }
    fields = vars(motion) | {name: torch.tensor(value) for name, value in values.items()}
    return Observations(**fields, setup=setup)  # pyright: ignore[reportArgumentType]


def _table_windows(shape: ObjectShape, trajectory: Trajectory) -> list[SteadyWindow]:
    if shape.chain is not None:
        windows = [] if trajectory.action.accelerated else link_windows(trajectory)
        return [window for window in windows if not LinkMotion(shape, window).may_rest]
    return (push_windows if trajectory.action.pushes else steady_windows)(trajectory)


def _pooled(
    windows: list[SteadyWindow], stated: np.ndarray, trial: np.ndarray, accelerated: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Covariance of the means by noise, and of the bias that the tare leaves, (K, 6, 6).

    Accelerated windows are short, and an accelerated arm swings: their noise density is that of the windows of constant
    speed, where there are any. The tares' own noise is averaged over the trials; `stated` is the covariance of each
    window's bias without it, (K, 6, 6).
    """
    length = np.array([np.ptp(w.since_tare) for w in windows])[:, None, None]
    density = np.array([w.covariance for w in windows]) * length
    quiet = accelerated if accelerated.all() else ~accelerated
    pooled = np.where(accelerated[:, None, None], density[quiet].mean(axis=0), density)
    own = np.array([w.bias_covariance for w in windows]) - stated
    first = np.unique(trial, return_index=True)[1]
    return pooled / length, stated + own[first].mean(axis=0)
