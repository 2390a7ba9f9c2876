"""Masses in a setup with a bias, a grasp offset or anisotropic friction: python bench/nuisance.py WHERE.

exact      in the tests' world of exact Coulomb friction, with white noise of 0.07 N and 0.007 N m a sample
simulated  in the simulated scene, with an FT-300S's errors; the anisotropy is MuJoCo's own elliptic friction

Each flaw of the setup against Algorithm 1 as it is and with unknowns of the setup: NAD over objects (mean and median,
%), error over claimed error (root mean square of all masses), and for how many objects there is an answer where not for
all. Objects are I2, L2, F2 and layouts drawn by seed. Options: --drawn N (12), --seed (0), --duration of a turn each
way, s (9).
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.console import Console
from rich.table import Table

import testbed.simulation.runner as simulation
from estimators.action_selection.rank import RankDriven
from estimators.evaluation.metrics import normalized_absolute_difference
from estimators.hidden_states.estimator import HiddenStates
from estimators.hidden_states.nuisance import UNKNOWNS
from testbed.actions.accelerate import Accelerate
from testbed.actions.base import Action
from testbed.actions.rotate import Rotate
from testbed.actions.slide import Slide
from testbed.objects.files import load_object
from testbed.objects.model import ObjectModel
from testbed.objects.random import Family
from testbed.sensing.noise import draw_sensing
from testbed.sensing.presets import preset
from testbed.simulation.runner import SimulationRunner
from testbed.simulation.scene import Scene
from testbed.trajectory import Trajectory
from testbed.trial import Trial

sys.path.insert(0, str(Path(__file__).parents[1]))
from tests.fakes.flawed_bench import biased, held_beside, on_anisotropic_table  # pyright: ignore[reportMissingImports]

BIAS = np.repeat([0.2, 0.01], 3)
"""Left after the tare, one standard deviation, N and N m."""
STATED = np.repeat([0.05, 0.003], 3)
"""Stated by the sensor."""
OFFSET = 0.002
"""Offset of the grasp, any way [m]."""
RATIO = 0.8
"""Least over most friction."""
NOISE = 0.07
METHODS: dict[str, tuple[str, ...]] = {
    "as it is": (),
    "bias": ("bias",),
    "grasp_offset": ("grasp_offset",),
    "anisotropy": ("anisotropy",),
    "all three": UNKNOWNS,
}


@dataclass(frozen=True)
class Flaws:
    """Flaws of the setup."""

    name: str
    bias: float = 0.0
    """In units of BIAS."""
    stated: float = 1.0
    """In units of STATED."""
    offset: float = 0.0
    """m."""
    ratio: float = 1.0
    back: bool = True


WRONG = (
    Flaws("none"),
    Flaws("bias, one way", bias=1, back=False),
    Flaws("the same, size stated", bias=1, stated=float(BIAS[0] / STATED[0]), back=False),
    Flaws("bias, there and back", bias=1),
    Flaws("the same, size stated", bias=1, stated=float(BIAS[0] / STATED[0])),
    Flaws("offset", offset=OFFSET),
    Flaws("anisotropy", ratio=RATIO),
    Flaws("all three", bias=1, offset=OFFSET, ratio=RATIO),
)

World = Callable[[ObjectModel, Action, Flaws, np.random.Generator, float, int], Trajectory]
"""Record of an action in a setup with flaws, drawn by a generator; the direction of most friction, and a seed."""


def exact(
    obj: ObjectModel, action: Action, flaws: Flaws, rng: np.random.Generator, direction: float, seed: int
) -> Trajectory:
    """In the world of exact Coulomb friction."""
    assert isinstance(action, Rotate | Accelerate | Slide)
    offset, bias = _offset(flaws, rng), flaws.bias * BIAS * rng.standard_normal(6)
    trial = held_beside(obj, action, offset, noise=NOISE, seed=seed)
    if flaws.ratio < 1:
        trial = on_anisotropic_table(obj, trial, flaws.ratio, direction, offset)
    return biased(trial, bias, flaws.stated * STATED)


def simulated(
    obj: ObjectModel, action: Action, flaws: Flaws, rng: np.random.Generator, direction: float, seed: int
) -> Trajectory:
    """In the simulated scene, with most friction along a world axis: MuJoCo's contact frame takes y first, then x."""
    assert isinstance(action, Rotate | Accelerate | Slide)
    clean = _physics(obj, action, tuple(_offset(flaws, rng).tolist()), flaws.ratio)
    force, torque = flaws.bias * BIAS[[0, 3]]
    trial = draw_sensing(clean, replace(preset("ft300s"), force_bias=force, torque_bias=torque), seed)
    return replace(trial, sensor_bias_std=flaws.stated * STATED)


def _offset(flaws: Flaws, rng: np.random.Generator) -> np.ndarray:
    way = rng.uniform(0, 2 * math.pi)
    return flaws.offset * np.array([math.cos(way), math.sin(way)])


@cache
def _physics(
    obj: ObjectModel, action: Rotate | Accelerate | Slide, offset: tuple[float, float], ratio: float
) -> Trajectory:
    """The simulated record, with a perfect sensor."""
    grasps = tuple(replace(g, position=g.position + offset) for g in obj.shape.grasps)
    moved = replace(obj, shape=replace(obj.shape, grasps=grasps))
    if isinstance(action, Rotate) and action.pivot is not None:
        action = replace(action, pivot=(action.pivot[0] + offset[0], action.pivot[1] + offset[1]))
    plain = simulation.build_scene

    def anisotropic(*given: Any, **how: Any) -> Scene:
        scene = plain(*given, **how)
        for i in range(scene.model.npair):
            if scene.model.pair(i).name.startswith("foot_"):
                scene.model.pair_friction[i, :2] *= [ratio**0.5, ratio**-0.5]
        return scene

    simulation.build_scene = anisotropic
    try:
        return SimulationRunner().run_clean(Trial(moved, action))
    finally:
        simulation.build_scene = plain


def trials(obj: ObjectModel, world: World, flaws: Flaws, duration: float, seed: int) -> list[Trajectory]:
    """Trials of the paper's policy in a setup with such flaws."""
    rng = np.random.default_rng([seed, 7])
    direction = float(rng.uniform(0, math.pi)) if world is exact else 0.0
    policy, made = RankDriven(duration=duration, seed=seed), []
    while (action := policy.next(obj.shape, made)) is not None:
        if isinstance(action, Rotate):
            action = replace(action, back=flaws.back)
        trial = world(obj, action, flaws, rng, direction, 1000 * seed + len(made))
        made.append(replace(trial, action=action))
    return made


def objects(drawn: int) -> list[ObjectModel]:
    """I2, L2, F2, and drawn layouts whose trials in the exact world show all masses."""
    found = [load_object(name) for name in ("I2", "L2", "F2")]
    family = Family(count=1000, seed=11)
    for index in range(1000):
        if len(found) == 3 + drawn:
            break
        obj = family.draw(index, 0).build(3, Path())
        if obj.shape.grasps:
            answer = answered(obj, trials(obj, exact, WRONG[0], 3.0, 0), ())
            if answer is not None:
                found.append(obj)
    return found


def answered(obj: ObjectModel, made: list[Trajectory], unknown: tuple[str, ...]) -> tuple[float, np.ndarray] | None:
    """NAD and errors over claimed errors; None where there is no answer, or part of it is open."""
    answer = HiddenStates(unknown=unknown).estimate(obj.shape, obj.total_mass, made, 0)
    if answer.distribution is None or answer.covariance is None or not np.isfinite(answer.covariance).all():
        return None
    off = (answer.distribution.mass - obj.truth.mass) / np.sqrt(np.diagonal(answer.covariance))
    return 100 * normalized_absolute_difference(obj.shape, answer.distribution, obj.truth), off


def main() -> None:
    """Print the table."""
    torch.set_num_threads(1)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("where", choices=("exact", "simulated"))
    parser.add_argument("--drawn", type=int, default=12)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--duration", type=float, default=9.0)
    options = parser.parse_args()
    world = exact if options.where == "exact" else simulated
    those = objects(options.drawn)
    table = Table(
        title=f"{options.where}, {len(those)} objects, turns of {options.duration:g} s: NAD mean, median; error"
    )
    for column in ("flaw", *METHODS):
        table.add_column(column, justify="left" if column == "flaw" else "right")
    for flaws in WRONG:
        made = [trials(obj, world, flaws, options.duration, options.seed) for obj in those]
        cells = []
        for unknown in METHODS.values():
            found = [answered(obj, each, unknown) for obj, each in zip(those, made, strict=True)]
            good = [each for each in found if each is not None]
            if not good:
                cells.append("no answer")
                continue
            nads = [nad for nad, _ in good]
            z = math.sqrt(np.mean(np.concatenate([off for _, off in good]) ** 2))
            few = f" ({len(good)})" if len(good) < len(those) else ""
            cells.append(f"{np.mean(nads):.2f}, {np.median(nads):.2f}; {z:.1f}{few}")
        table.add_row(flaws.name, *cells)
        print(flaws.name, cells, flush=True)
    Console(width=160).print(table)


if __name__ == "__main__":
    main()
