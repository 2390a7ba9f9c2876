"""MuJoCo's system identification toolbox as a method, on a planar scene of the object."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, get_args

import torch

from estimators.base import Trace
from estimators.baselines.base import LogCoordinates, Peer, SearchResult
from estimators.baselines.problem import Problem
from estimators.particles.misfit import Misfit
from estimators.particles.windows import PLANAR, Observations
from estimators.posterior.scale import Weighing
from estimators.wrench.model import ModelErrors
from estimators.wrench.support import SupportModel
from testbed.errors import InvalidValueError
from testbed.objects.model import MassDistribution, ObjectModel
from testbed.trial import parse_support

if TYPE_CHECKING:  # MuJoCo and its toolbox take a second to import: only this method waits for them
    from testbed.simulation.planar_sysid import PlanarMotion


@dataclass(frozen=True)
class MujocoSysid(Peer):
    """Fits mass and friction by `mujoco.sysid`: rollouts of a planar MuJoCo scene, the toolbox's optimizer "scipy".

    It gets M and the errors' covariance and starts at uniform mass, as every peer. Its covariance is by heft's slopes:
    the feet of a light group shake in its scene, and the toolbox takes that for a slope. Needs the extra `sysid`.
    """

    takes_links: ClassVar[bool] = False
    """It moves the object in one piece."""

    iterations: int = 200
    """Most guesses of the toolbox's optimizer, slopes apart: its default."""
    support: SupportModel = "own_weight"
    """Support in its scene: own_weight, as every baseline assumes, or rigid."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.support not in (supports := get_args(SupportModel)):
            raise InvalidValueError("MujocoSysid.support", self.support, f"one of {', '.join(supports)}")
        if self.weighting != "covariance":
            raise InvalidValueError("MujocoSysid.weighting", self.weighting, "covariance: it fits wrenches")

    def check_installed(self) -> None:
        """Raise InvalidValueError where the toolbox's own dependencies are not installed."""
        from testbed.simulation.planar_sysid import check_toolbox  # noqa: PLC0415  see above

        check_toolbox()

    @property
    def _support(self) -> SupportModel:
        return self.support

    def _search(self, problem: Problem, seed: int) -> SearchResult:
        from testbed.simulation.planar_sysid import PlanarData, identify  # noqa: PLC0415  see above

        self.check_installed()
        shape, windows = problem.shape, problem.windows
        coordinates = LogCoordinates.of(problem, seed)
        first = coordinates.candidates(coordinates.start[None])
        guess = ObjectModel("guess", shape, MassDistribution(first.mass[0].numpy(), first.friction[0].numpy()))
        # of planar wrenches given the others, which show the gripper's load that its rollouts get
        given = problem.sensed.whiten
        planar = (6 * torch.arange(len(windows))[:, None] + torch.tensor(PLANAR)).flatten()
        whiten = torch.linalg.cholesky((given.T @ given)[planar[:, None], planar]).T.numpy()
        wrench = windows.wrench.numpy()
        weighing = Weighing.of(shape, ModelErrors.weight_error, windows.setup)
        measured = PlanarData(motion_of(windows), wrench, whiten, problem.weight, weighing.error)
        found = identify(guess, parse_support(self.support), measured, self.iterations)
        count = shape.particles_per_group
        at = MassDistribution(found.group_mass / count, found.friction)
        trace = Trace("mujoco_sysid", tuple(found.losses), tuple(found.seconds), 0.0, found.masses / count)
        return SearchResult(
            at.mass,
            at.friction,
            float(found.losses[-1]),
            (trace,),
            report=problem.report(at),
            misfit=Misfit(float(found.losses[-1]), 3 * len(windows) - shape.n_m - shape.n_mu),
            rollouts=found.guesses,
        )


def motion_of(windows: Observations) -> PlanarMotion:
    """Motion of the planar scene through the windows; an accelerated window keeps one rate through its parts."""
    from testbed.simulation.planar_sysid import PlanarMotion  # noqa: PLC0415

    rate = windows.spin_square.sqrt()[:, None] / windows.twists[..., 2].abs()
    at_one_rate = torch.where(windows.accelerated[:, None], rate, 1.0)[..., None]
    return PlanarMotion(
        twists=(windows.twists * at_one_rate).numpy(),
        spin_up=torch.where(windows.accelerated, windows.acceleration[:, 2], 0.0).numpy(),
        moment=torch.stack([-windows.tilt[:, 1], windows.tilt[:, 0]], -1).numpy(),
        lift=windows.lift.numpy(),
        held=windows.held.numpy(),
        grasp=windows.grasp.numpy(),
    )
