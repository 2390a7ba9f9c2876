"""The learned posterior as an estimator, and the comparison of its inputs with its training."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from jaxtyping import Float

from estimators.base import Estimate, weighed
from estimators.identifiability.report import hardly_known
from estimators.learned.checkpoint import COMMAND, FALSE_ALARM, LEAST_FREEDOM, Checkpoint, default_path
from estimators.learned.examples import Examples, fixed_axes
from estimators.learned.question import MISFIT, SUMMARY, Question, ask
from estimators.particles.misfit import NEXT
from estimators.particles.observe import HAS_HINGES, ONE_BODY
from estimators.posterior.scale import Weighing
from estimators.wrench.support import ASSUMPTION, ERRORS
from testbed.errors import InvalidValueError
from testbed.objects.model import MassDistribution, ObjectShape
from testbed.trajectory import Trajectory
from testbed.validation import check_integer
from testbed.worlds.setup_errors import EXACT_SETUP, PARAMETERS, SetupErrors

if TYPE_CHECKING:
    from estimators.learned.network import Network

AXES = 8
"""Number of rotated frames in which the network is evaluated; the draws are divided among them."""
SLACK = 0.05
"""Tolerance of the range of the examples, as a part of that range."""
LARGER = 1.25
"""Largest ratio of a stated error of the setup to the one of the training."""
NOT_LEARNED = ("scale", "tool_mass", "tool_com")
"""Errors without a limit: the weighing's is added to the draws, and the tare removes the tool's weight."""


@dataclass(frozen=True)
class Learned:
    """Posterior that a network has learned from simulated trials (`heft learn`); needs the extra `learned`.

    It covers joined blocks on their own weight with one friction, turns there and back and accelerated turns, in a lab.
    Other inputs get the status `assumption_violated`.
    """

    checkpoint: str = ""
    """File that `heft learn` has written; if empty, heft/learned.pt in the user's cache folder."""
    draws: int = 1024
    """Draws of the posterior."""

    def __post_init__(self) -> None:
        if not isinstance(self.checkpoint, str):
            raise InvalidValueError("Learned.checkpoint", self.checkpoint, "the path of a file, as text")
        check_integer("Learned.draws", self.draws, AXES)

    @property
    def path(self) -> Path:
        """The checkpoint's file."""
        return Path(self.checkpoint).expanduser() if self.checkpoint else default_path()

    def check_installed(self) -> None:
        """Check that package and checkpoint exist.

        Raises:
            InvalidValueError: the extra is not installed, or no checkpoint.
            DamagedFileError: a damaged checkpoint, or one of another format.
        """
        self.check_package()
        self._loaded()

    @staticmethod
    def check_package() -> None:
        """Raise InvalidValueError where the extra is not installed."""
        if find_spec("zuko") is None:
            raise InvalidValueError("learned", "no package zuko", "pip install 'heft-testbed[learned]'")

    def fingerprint(self) -> str:
        """Identity of the checkpoint: time of change and size of its file; empty without one."""
        try:
            found = self.path.stat()
        except OSError:
            return ""
        return f"{found.st_mtime_ns}:{found.st_size}"

    def estimate(
        self, shape: ObjectShape, weight: float | None, trajectories: Sequence[Trajectory], seed: int
    ) -> Estimate:
        """Mean of draws of the posterior; `seed` draws them.

        Raises:
            InvalidValueError: no weight, no checkpoint, or a grasp that the shape does not have.
            DamagedFileError: a damaged checkpoint.
        """
        begin = time.perf_counter()
        weight = weighed(shape, weight)
        self.check_installed()
        network, learned = self._loaded()
        if why := _unlike(shape, trajectories, learned):
            return Estimate(None, "assumption_violated", why, seconds=time.perf_counter() - begin)
        question = ask(shape, weight, trajectories)
        if isinstance(question, str):
            return Estimate(None, "no_data", question, seconds=time.perf_counter() - begin)
        scale = Weighing.of(shape, ERRORS["own_weight"].weight_error, question.setup)
        mass, friction = _draws(network, question, weight, scale.error, self.draws, seed)
        per_group, misfit = shape.particles_per_group, question.first.misfit((mass.mean(0) / weight) * friction.mean())
        covariance = np.atleast_2d(np.cov(mass / per_group, rowvar=False))
        at = MassDistribution(mass.mean(0) / per_group, np.array([friction.mean()]))
        answer = Estimate(
            at,
            "ok",
            "",
            covariance,
            diagnostics={**misfit.diagnostics, "friction_0_std": float(friction.std())},
            assumes=ASSUMPTION["own_weight"],
        )
        status, why = misfit.status, misfit.reason
        if far := _outside(question, learned):
            status, why = "assumption_violated", far
        elif misfit.explains and (large_misfit := _misfitting(question, learned)):
            status, why = "unexplained", large_misfit
        elif misfit.explains and (undetermined := _undetermined(answer, shape, question.rank)):
            status, why = "underdetermined", undetermined
        return replace(answer, status=status, message=why, seconds=time.perf_counter() - begin)

    def _loaded(self) -> tuple[Network, Checkpoint]:
        """Network and checkpoint of the file."""
        if not self.path.is_file():
            raise InvalidValueError("Learned.checkpoint", str(self.path), f"a file that `{COMMAND}` has written")
        return _load(self.path, self.fingerprint())


@lru_cache(maxsize=2)
def _load(path: Path, fingerprint: str) -> tuple[Network, Checkpoint]:
    """Network of a file, loaded once for each version of it."""
    from estimators.learned.network import Network, Sizes  # noqa: PLC0415  zuko is an optional extra

    learned = Checkpoint.load(path)
    network = Network(Sizes(**learned.sizes))
    network.load_state_dict(learned.weights)
    return network.eval(), learned


def _draws(
    network: Network, question: Question, weight: float, error: float, count: int, seed: int
) -> tuple[Float[np.ndarray, "S G"], Float[np.ndarray, "S"]]:
    """Draws of the groups' masses, kg, and of the friction; `error` is that of the weight, kg."""
    rng, groups = np.random.default_rng(seed), len(question.center)
    angle, mirrored = fixed_axes(AXES)
    inputs = Examples.of([question] * AXES)
    noise = torch.tensor(rng.standard_normal((-(-count // AXES), AXES, groups)))
    with torch.no_grad():
        drawn = network.draw(inputs.turned(angle, mirrored), noise)
    load = torch.empty_like(drawn).scatter_(2, inputs.order(angle).expand_as(drawn), drawn).reshape(-1, groups)
    whole = np.maximum(weight + error * rng.standard_normal(len(load)), weight / 2)
    friction = load.exp().sum(1).numpy() * weight / whole
    return torch.softmax(load, 1).numpy() * whole[:, None], friction


def _unlike(shape: ObjectShape, trajectories: Sequence[Trajectory], learned: Checkpoint) -> str:
    """Properties of object, trials or stated errors outside the training, in words; empty if there are none."""
    (fewest, most), trained = learned.origin.blocks, learned.origin.setup
    used = [trial for trial in trajectories if trial.ok and trial.action.moves]
    other = sorted({trial.action.kind for trial in used if not trial.action.turns})
    stated = SetupErrors.largest([EXACT_SETUP, *(trial.setup for trial in used)])
    found = {
        HAS_HINGES: shape.chain is not None,
        ONE_BODY: not shape.stands_in_groups,
        "not learned: feet of known places, and meshes": shape.stands_on_feet or shape.is_uneven,
        f"not learned: {shape.n_mu} frictions, only one": shape.n_mu > 1,
        f"not learned: {shape.n_m} groups, only {fewest} to {most}": not fewest <= shape.n_m <= most,
        f"not learned: {', '.join(other)}, only turns and accelerated turns": bool(other),
    }
    for name in set(PARAMETERS) - set(NOT_LEARNED):
        given, known = getattr(stated, name), getattr(trained, name)
        found[f"not learned: a stated {name} of {given:.3g}, only of {known:.3g}"] = given > LARGER * known
    return "; ".join(sorted(words for words, holds in found.items() if holds))


def _outside(question: Question, learned: Checkpoint) -> str:
    """Number of the question farthest outside the examples, in words; empty if all are inside."""
    span = learned.high - learned.low
    slack = SLACK * span + 1e-3 * (1 + learned.high.abs())
    over = torch.maximum(learned.low - question.summary, question.summary - learned.high) / slack
    worst = int(over.argmax())
    if over[worst] <= 1:
        return ""
    low, high, value = (float(each[worst]) for each in (learned.low, learned.high, question.summary))
    return f"unlike the examples: {SUMMARY[worst]} is {value:.3g}, learned from {low:.3g} to {high:.3g}"


def _misfitting(question: Question, learned: Checkpoint) -> str:
    """Misfit of the first answer, of friction or inertia, above the limit of the examples, in words; else empty.

    The stated errors of a lab are large, so other errors, such as a rigid support, pass the limit of other methods.
    """
    found: dict[str, float] = dict(zip(SUMMARY, question.summary.exp().tolist(), strict=True))
    few = 3 * len(question.edges) - len(question.center) < LEAST_FREEDOM  # as `limits_of` counts
    for name, most in learned.limits.items():
        if found[name] > most and not (name == MISFIT and few):
            what, value = name.split(",")[0], found[name]
            return f"{what} {value:.2g}, where {1 - FALSE_ALARM:.0%} of the examples have at most {most:.2g}; {NEXT}"
    return ""


def _undetermined(answer: Estimate, shape: ObjectShape, rank: int) -> str:
    """Reason why the masses are not determined; empty if they are."""
    if rank < shape.n_m:
        return f"rank(Q) is {rank} and {shape.n_m} friction loads are unknown: turn about more points"
    assert answer.distribution is not None
    assert answer.covariance is not None
    return hardly_known(shape, answer.distribution.mass, answer.covariance)
