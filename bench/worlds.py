"""What each quantity of a world does to an answer: python bench/worlds.py [--draws 4] [--duration 6] [--world NAME].

NAD of `hidden_states` (mean and median over objects and draws, %), root mean square of its errors over those that it
claims, and answers with status ok: in the worlds, and with each quantity of `lab` alone. I2, L2 and F2 on their own
weight with an FT-300S; turns of the default policy, of --duration s each way. Quantities of arm and sensor share the
ideal world's trials, since they act on the record alone.
"""

from __future__ import annotations

import argparse
import zlib
from dataclasses import replace
from functools import cache

import numpy as np
from rich.console import Console
from rich.table import Table

from estimators.action_selection.rank import RANK_DRIVEN
from estimators.evaluation.metrics import normalized_absolute_difference
from estimators.hidden_states.estimator import HiddenStates
from testbed.actions.base import Action
from testbed.actions.weigh import Weigh
from testbed.objects.files import load_object
from testbed.objects.model import ObjectModel
from testbed.sensing.noise import draw_sensing
from testbed.sensing.presets import preset
from testbed.sensing.windows import weight_of
from testbed.simulation.runner import SimulationRunner
from testbed.trajectory import Trajectory
from testbed.trial import Trial
from testbed.worlds.draw import WorldDraw
from testbed.worlds.presets import QUANTITIES, WORLDS, World

OBJECTS = [load_object(name) for name in ("I2", "L2", "F2")]
ON_ARM = ("TCP", "encoders, delay", "gain", "cross-talk", "mounting", "filter, steps, zero", "tool, scale")
ON_TABLE = [name for name, each in QUANTITIES.items() if each.source not in ON_ARM]
"""Quantities of table, object and grasp: the trials themselves change with them."""


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=4)
    parser.add_argument("--duration", type=float, default=6.0)
    parser.add_argument("--world", choices=[*WORLDS, *QUANTITIES], nargs="*", default=[*WORLDS, *QUANTITIES])
    options = parser.parse_args()
    table = Table(title=f"hidden_states, {options.draws} draws, turns of {options.duration:g} s")
    for column in ("world", "NAD, %", "median, %", "error / claimed", "ok"):
        table.add_column(column, justify="left" if column == "world" else "right")
    for name in options.world:
        world = WORLDS[name] if name in WORLDS else replace(World(name=name), **{name: getattr(WORLDS["lab"], name)})
        found = [answer(model, world, seed, options.duration) for model in OBJECTS for seed in range(options.draws)]
        given = [each for each in found if each is not None]
        nad = [100 * each[0] for each in given]
        off = np.concatenate([each[1] for each in given])
        ok = sum(each[2] for each in given)
        row = (f"{np.mean(nad):.1f}", f"{np.median(nad):.1f}", f"{np.sqrt(np.mean(off**2)):.1f}", f"{ok}/{len(found)}")
        print(name, *row, flush=True)
        table.add_row(name, *row)
    Console().print(table)


def answer(model: ObjectModel, world: World, seed: int, duration: float) -> tuple[float, np.ndarray, bool] | None:
    """NAD, errors of the masses over those claimed, and whether the status is ok; None without an answer."""
    draw = WorldDraw.of(world, model, seed, "bench")
    policy = replace(RANK_DRIVEN["reversed_pairs"], duration=duration)
    actions = [Weigh(), *policy.predicted_actions(model.shape)]
    drawn = [sensed(clean(model, action, draw), seed, index) for index, action in enumerate(actions)]
    found = HiddenStates().estimate(model.shape, weight_of(drawn[0]), drawn[1:], seed)
    if found.distribution is None or found.covariance is None or not np.isfinite(found.covariance).all():
        return None
    nad = normalized_absolute_difference(model.shape, found.distribution, model.truth)
    off = (found.distribution.mass - model.truth.mass) / np.sqrt(np.diagonal(found.covariance))
    return nad, off, found.status == "ok"


def clean(model: ObjectModel, action: Action, draw: WorldDraw) -> Trajectory:
    """Record of a perfect sensor, of the ideal world's trial where only arm and sensor err."""
    nowhere = replace(draw.world, **{name: 0 for name in ON_TABLE})
    if nowhere != draw.world:
        return SimulationRunner().run_clean(Trial(model, action, world=draw))
    made = _ideal(model, action)
    return replace(made, provenance=made.provenance | draw.provenance, setup=draw.world.stated)


@cache
def _ideal(model: ObjectModel, action: Action) -> Trajectory:
    return SimulationRunner().run_clean(Trial(model, action))


def sensed(record: Trajectory, seed: int, index: int) -> Trajectory:
    """The record with a draw of the sensor's errors, as a method is given it."""
    return draw_sensing(record, preset("ft300s"), zlib.crc32(f"{seed}/{index}".encode())).blinded()


if __name__ == "__main__":
    main()
