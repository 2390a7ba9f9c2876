"""Reduction of an object's trials to one batch of windows: turns and slides, of links too, and pushes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from jaxtyping import Float

from estimators.particles.links import carried_moment
from estimators.particles.windows import PLANAR, Observations
from estimators.wrench.model import ModelErrors, ParticleModel
from estimators.wrench.support import likely_load, load_map
from testbed.actions.base import TableAction
from testbed.actions.push import Push
from testbed.objects.chain import speeds
from testbed.objects.model import ObjectShape
from testbed.sensing.link_windows import link_windows
from testbed.sensing.push_windows import push_windows
from testbed.sensing.windows import PARTS, SteadyWindow, reduced_trials, steady_windows
from testbed.trajectory import Trajectory
from testbed.worlds.setup_errors import SetupErrors

ONE_PIECE = "an object with hinges, which this method takes for one piece: hidden_states and least_squares know links"
"""Why a method gives no answer on an articulated object."""
STANDING, MOST_STANDING = 0.002, 0.2
"""Speed below which a particle of a link may stand, m/s, and the part of a link's particles that may: one at which
the link turns counts as an error."""
SUDDEN = 0.8
"""Angular acceleration of a link that starts or stops, rad/s^2: its drag is not Coulomb's of the mean motion."""


def observe(
    shape: ObjectShape, trajectories: Sequence[Trajectory], errors: ModelErrors | None = None
) -> Observations | None:
    """Steady windows of all usable trajectories of one object; None where there is none.

    Weighings, lifts, trials that did not end well and those too short to reduce are left out. Of `errors`, only the
    load of a nulled gripper counts here.

    Raises:
        InvalidValueError: a grasp that the shape does not have.
    """
    errors = errors or ModelErrors()
    windows: list[SteadyWindow] = []
    trial: list[int] = []
    accelerated: list[bool] = []
    kinds = (TableAction, Push) if shape.chain is None else (TableAction,)
    for index, found in reduced_trials(shape, trajectories, kinds, partial(_table_windows, shape)).items():
        windows += found
        trial += [index] * len(found)
        accelerated += [trajectories[index].action.accelerated] * len(found)
    if not windows:
        return None
    wrench = np.array([w.wrench for w in windows])
    noise, bias = _pooled(windows, np.array(trial), np.array(accelerated))
    carries = np.array([load_map(w.tcp_height) for w in windows])
    drift = np.array([w.drift_covariance for w in windows])
    off = bias + np.array([w.since_tare.mean() for w in windows])[:, None, None] * drift
    setup = SetupErrors.largest([trajectories[index].setup for index in set(trial)])
    drag = torch.tensor(np.linalg.norm(wrench[:, :2], axis=1).max())
    load, kept, followed = likely_load(
        np.einsum("kij,kj->ki", carries, wrench),
        np.einsum("kij,kjl,kil->ki", carries, off, carries),
        np.einsum("kij,kjl,kil->ki", carries, noise, carries),
        np.array(trial),
        np.array(accelerated),
        errors.nulled,
        np.array([w.grasp is None for w in windows]),
        float(carried_moment(ParticleModel.of(shape), drag, setup)),
    )
    points, held = zip(*(_place(shape, w) for w in windows), strict=True)
    same = (
        "since_tare",
        "twist",
        "twists",
        "acceleration",
        "spin_square",
        "yaw",
        "poses",
        "from_sensor",
        "seen",
        "tool_tilt",
    )
    values: dict[str, np.ndarray] = {
        name: np.array([getattr(w, name) for w in windows]) for name in (*same, "seen", "tool_tilt")
    }
    values |= {
        "wrench": wrench[:, PLANAR],
        "sensed": np.linalg.solve(values["from_sensor"], wrench[..., None])[..., 0],
        "noise": noise,
        "bias": bias,
        "drift": drift,
        "grasp": np.array(points),
        "lift": load[:, 0],
        "tilt": load[:, 1:],
        "load_map": carries,
        "load_kept": kept,
        "load_followed": followed,
        "held": np.array(held),
        "trial": np.array(trial),
        "accelerated": np.array(accelerated),
        "pushed": np.array([w.grasp is None for w in windows]),
        "links": np.array([LinkMotion.of(shape, w).links() for w in windows]),
        "links_off": np.array([LinkMotion.of(shape, w).links_off() for w in windows]),
    }
    if not values["pushed"].any():
        values["seen"] = values["seen"][..., :0]
    fields = {name: torch.tensor(value) for name, value in values.items()}
    return Observations(**fields, setup=setup)  # pyright: ignore[reportArgumentType]


def _table_windows(shape: ObjectShape, trajectory: Trajectory) -> list[SteadyWindow]:
    if shape.chain is not None:
        windows = [] if trajectory.action.accelerated else link_windows(trajectory)
        return [window for window in windows if not LinkMotion.of(shape, window).stands_or_starts]
    return (push_windows if isinstance(trajectory.action, Push) else steady_windows)(trajectory)


@dataclass(frozen=True, eq=False)
class LinkMotion:
    """Motion of the links in one window of an articulated object, measured or predicted."""

    shape: ObjectShape
    """Geometry; a rigid one has no links."""
    grasp: int | None
    """Grasp by which one is held."""
    twists: Float[np.ndarray, "S 3"]
    """Twists [m/s, rad/s], as `SteadyWindow.twists`."""
    acceleration: Float[np.ndarray, "3"]
    """Acceleration [m/s^2, rad/s^2], as `SteadyWindow.acceleration`."""
    turned: Float[np.ndarray, "S L 3"]
    """Yaw [rad], rate and slope of every link, as `SteadyWindow.turned`."""
    turned_errors: Float[np.ndarray, "L 3 4"]
    """Errors of `turned`, as `SteadyWindow.turned_errors`."""

    @staticmethod
    def of(shape: ObjectShape, window: SteadyWindow) -> LinkMotion:
        """Motion in a measured window."""
        return LinkMotion(shape, window.grasp, window.twists, window.acceleration, window.turned, window.turned_errors)

    @property
    def stands_or_starts(self) -> bool:
        """True if part of a link stands, where what holds it is anything up to its friction, or starts or stops."""
        chain = self.shape.chain
        assert chain is not None and self.grasp is not None
        sure = 2 * np.linalg.norm(self.turned_errors[:, 2], axis=1)
        if (np.abs(self.turned[..., 2]) - sure > SUDDEN).any():
            return True
        links, offsets = self.links(), self.shape.particles - self.shape.grasps[self.grasp].position
        of = chain.link[self.shape.mass_group]
        return any((speeds(links, k, offsets[of == k]) < STANDING).mean() > MOST_STANDING for k in range(chain.links))

    def links(self) -> Float[np.ndarray, "S L 9"]:
        """Motion of every link as `Chain.moved`."""
        return self._moved(self.turned)

    def links_off(self) -> Float[np.ndarray, "E S L 9"]:
        """`links` after each error of the camera: three of each link's own, and its delay's of all."""
        errors = self.turned_errors
        links = np.eye(len(errors))[:, :, None]
        own = [link * errors[index, :, each] for index, link in enumerate(links) for each in range(3)]
        off = np.array([*own, errors[:, :, 3]])[:, None]
        return self._moved((self.turned + off).reshape(len(off) * PARTS, *self.turned.shape[1:])).reshape(
            len(off), *self.turned.shape[:2], 9
        )

    def _moved(self, turned: Float[np.ndarray, "R L 3"]) -> Float[np.ndarray, "R L 9"]:
        """Motion of every link by yaw, rate and slope, in rows of S parts each."""
        chain = self.shape.chain
        if chain is None or self.grasp is None:
            return np.zeros((len(turned), 0, 9))
        grasp = self.shape.grasps[self.grasp]
        held = int(chain.link[self.shape.pressed(grasp)[0]])
        turned = turned - turned[:, held, None] * [1, 0, 0]  # the hand knows where it is; links show each other
        twists = np.tile(self.twists, (len(turned) // PARTS, 1))
        return chain.moved(held, grasp.position, twists, self.acceleration, turned)


def _place(shape: ObjectShape, window: SteadyWindow) -> tuple[np.ndarray, tuple[int, int]]:
    """Point about which moments are, and the mass groups that the pads or the fingertip press on."""
    if window.grasp is not None:
        return shape.grasps[window.grasp].position, shape.pressed(shape.grasps[window.grasp])
    assert window.point is not None
    return window.point, touched(shape, window.point)


def touched(shape: ObjectShape, point: np.ndarray) -> tuple[int, int]:
    """Mass group that a fingertip touches at a point [m, object frame], twice: as if under two pads."""
    group = int(shape.mass_group[np.linalg.norm(shape.particles - point, axis=1).argmin()])
    return group, group


def _pooled(windows: list[SteadyWindow], trial: np.ndarray, accelerated: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Covariance of the means of noise, and of the tare's bias, (K, 6, 6).

    A short window's scatter tells its noise badly, and an accelerating arm swings: its noise a second is taken from the
    windows of constant speed, where there are any. Tares are alike in all trials.
    """
    length = np.array([np.ptp(w.since_tare) for w in windows])[:, None, None]
    density = np.array([w.covariance for w in windows]) * length
    quiet = accelerated if accelerated.all() else ~accelerated
    pooled = np.where(accelerated[:, None, None], density[quiet].mean(axis=0), density)
    noise, bias = pooled / length, np.array([w.bias_covariance for w in windows])
    first = np.unique(trial, return_index=True)[1]
    return noise, np.broadcast_to(bias[first].mean(axis=0), bias.shape)
