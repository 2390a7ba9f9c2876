"""heft identify, heft plan, heft touch: what to touch. Signatures alone, so that --help loads nothing heavy."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console


def identify(
    object_: Annotated[str, tyro.conf.Positional, tyro.conf.arg(name="object", metavar="OBJECT")],
    *,
    sensing: Annotated[str, tyro.conf.arg(metavar="PRESET")] = "ft300s",
    support: Literal["own_weight", "rigid"] = "own_weight",
    pivots: Annotated[int, tyro.conf.arg(metavar="N")] = 6,
    accelerated: Annotated[int, tyro.conf.arg(metavar="N")] = 6,
    slides: Annotated[int, tyro.conf.arg(metavar="N")] = 0,
    lifts: Annotated[int, tyro.conf.arg(metavar="N")] = 0,
    duration: Annotated[float, tyro.conf.arg(metavar="S")] = 18.0,
    grasps: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="NAME ...")] = None,
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
) -> None:
    """Say what trials of an object would show of its masses, before any is made: errors to expect, and what stays open.

    Examples: heft identify L2
              heft identify F2 --support rigid --sensing ideal
              heft identify L2 --support rigid --lifts 1
              heft identify L2 --pivots 0 --slides 6 --out results/L2_slides

    Args:
        object_: name in the library, or path to a TOML file.
        sensing: preset of the sensor.
        support: who carries the weight.
        pivots: turns there and back, as the rank-driven policy draws them; 0 for none, accelerated ones neither.
        accelerated: accelerated turns.
        slides: slides, in directions spread over the circle.
        lifts: lifts, held still and rocked in the air, of the grasps nearest the middle; under rigid support alone.
        duration: of a turn each way, s.
        grasps: grasps that may be used, by name (see heft show); all if left out, whether the arm reaches them or not.
        out: heatmap of the expected errors, written as FILE.pdf and FILE.png.
    """
    from scenarios.identify_run import Wish  # noqa: PLC0415
    from scenarios.identify_run import identify as say  # noqa: PLC0415

    say(Console(), object_, Wish(sensing, support, pivots, accelerated, slides, lifts, duration, grasps, out))


def plan(
    object_: Annotated[str, tyro.conf.Positional, tyro.conf.arg(name="object", metavar="OBJECT")],
    *,
    budget: Annotated[str | None, tyro.conf.arg(metavar="TIME")] = None,
    until: Annotated[str | None, tyro.conf.arg(metavar="PERCENT")] = None,
    policy: Literal["greedy", "batch", "random", "paper"] = "greedy",
    criterion: Literal["I", "A", "D"] = "I",
    sensing: Annotated[str, tyro.conf.arg(metavar="PRESET")] = "ft300s",
    support: Literal["own_weight", "rigid", "either"] = "own_weight",
    lifts: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    friction: Annotated[float, tyro.conf.arg(metavar="MU")] = 0.5,
    most: Annotated[int, tyro.conf.arg(metavar="N")] = 8,
    candidates: Annotated[int, tyro.conf.arg(metavar="N")] = 4000,
    grasps: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="NAME ...")] = None,
    seed: Annotated[int, tyro.conf.arg(metavar="N")] = 0,
    figure: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    record: Annotated[Path | None, tyro.conf.arg(metavar="FILE.rrd")] = None,
) -> None:
    """Plan touches: where to grasp and which way to turn, to know an object's masses in as little robot time as can be.

    Of the object only its shape and its weight are looked at.
    Examples: heft plan L2 --budget 60s
              heft plan L2 --until 2% --policy batch --figure results/L2_plan
              heft plan L2 --support rigid --lifts

    Args:
        object_: name in the library, or path to a TOML file.
        budget: robot time, travel included, as 60s or 2min; no limit if left out.
        until: expected NAD that is good enough, as 5%.
        policy: greedy (the best of each moment), batch (the whole made better by exchange), random, or paper.
        criterion: what is made small: I (the expected NAD), A (trace of the covariance) or D (its volume).
        sensing: preset of the sensor.
        support: who carries the weight; either serves both models, and tells them apart.
        lifts: think of lifts too, held still and rocked in the air; not with support own_weight.
        friction: guessed.
        most: touches at most.
        candidates: actions that are thought of.
        grasps: grasps that may be used, by name (see heft show); all if left out.
        seed: of the candidates.
        figure: the plan as a picture, written as FILE.pdf and FILE.png.
        record: the plan as a Rerun recording: `rerun FILE.rrd` opens it.
    """
    from scenarios.plan_run import Wish  # noqa: PLC0415
    from scenarios.plan_run import plan as say  # noqa: PLC0415

    of_plan = (budget, until, policy, criterion, sensing, support, friction)
    say(Console(), object_, Wish(*of_plan, most, candidates, grasps, seed, figure, record, lifts))


def touch(
    object_: Annotated[str, tyro.conf.Positional, tyro.conf.arg(name="object", metavar="OBJECT")],
    *,
    until: Annotated[str, tyro.conf.arg(metavar="PERCENT")] = "5%",
    budget: Annotated[str | None, tyro.conf.arg(metavar="TIME")] = None,
    sensing: Annotated[str, tyro.conf.arg(metavar="PRESET")] = "ft300s",
    support: Annotated[str, tyro.conf.arg(metavar="SUPPORT")] = "own_weight",
    thought: Literal["own_weight", "rigid", "either"] = "either",
    lifts: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    most: Annotated[int, tyro.conf.arg(metavar="N")] = 20,
    candidates: Annotated[int, tyro.conf.arg(metavar="N")] = 4000,
    grasps: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="NAME ...")] = None,
    seed: Annotated[int, tyro.conf.arg(metavar="N")] = 0,
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    record: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
) -> None:
    """Touch an object in simulation until its masses are known: weigh, plan, touch, estimate, and stop by itself.

    After every touch all that was felt decides the next. What is done is kept: the same command goes on from it.
    Examples: heft touch docs/objects/T.toml --until 5%
              heft touch L2 --until 1% --budget 5min --record --out results/L2_touched

    Args:
        object_: name in the library, or path to a TOML file.
        until: expected NAD that is good enough, as 5%.
        budget: robot time, travel included, as 60s or 2min; no limit if left out.
        sensing: preset of the sensor.
        support: who truly carries the weight: own_weight, rigid, or a stiffness in N/m.
        thought: who may carry it as far as the robot is told; with either it finds out.
        lifts: think of lifts too, held still and rocked in the air; not where own_weight is thought.
        most: touches at most.
        candidates: actions that are thought of before each touch.
        grasps: grasps that may be used, by name (see heft show); all if left out.
        seed: of the sensor's errors and of the candidates.
        out: folder for the results; results/touch_OBJECT if left out.
        record: write a recording of every trial too, into DIR/recordings.
    """
    from scenarios.touch_run import Wish  # noqa: PLC0415
    from scenarios.touch_run import touch as run_it  # noqa: PLC0415

    wish = Wish(until, budget, sensing, support, thought, most, candidates, grasps, seed, out, record, lifts)
    run_it(Console(), object_, wish)
