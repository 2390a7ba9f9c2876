"""heft touch: an active run in simulation, until the masses are known."""

from __future__ import annotations

import math
import shlex
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from scenarios.cli.plan import Search
from testbed.errors import HeftError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from estimators.action_selection.online import Decision
    from estimators.action_selection.plan import Goal
    from scenarios.study.active import ActiveResult
    from testbed.objects.model import ObjectModel
    from testbed.trajectory import Trajectory

MOST_REJECTED = 3
"""Number of refusals that are printed."""


TOUCHED = Search(until="5%", most=20, assumed_support="either")
"""Default options of an active run."""


def touch(
    object_: Annotated[str, tyro.conf.Positional, tyro.conf.arg(name="object", metavar="OBJECT")],
    *,
    search: Annotated[Search, tyro.conf.OmitArgPrefixes] = TOUCHED,
    support: Annotated[str | None, tyro.conf.arg(metavar="SUPPORT")] = None,
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    record: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
) -> None:
    """Explore an object in simulation until its masses are known: weigh, plan, act, estimate, repeat, and stop.

    Each action is planned from all measurements so far. Trials are kept: run the same command again to continue.

    Exit code: 1 without an answer.

    Examples: heft touch docs/objects/T.toml --until 5%
              heft touch L2 --until 1% --budget 5min --record --out results/L2_touched

    Args:
        object_: name in the library, or path to a TOML file.
        search: shared with heft plan.
        support: true support: own_weight, rigid, or a stiffness in N/m; default: rigid for an object with contact
            points, otherwise own_weight.
        out: results folder; default: results/touch_OBJECT.
        record: also write a recording of every trial to DIR/recordings.
    """
    from estimators.action_selection.design import ASSUMED_SUPPORTS
    from scenarios.cli.plan import named_grasps
    from scenarios.cli.run import show_progress
    from scenarios.config import Scenario
    from scenarios.results.files import exclusive, write_json
    from scenarios.results.store import Store
    from scenarios.results.table import write_rows
    from scenarios.study.active import ActiveRun
    from scenarios.study.run import ACTIVE_FIELDS, check_nothing_lost, manifest
    from scenarios.views.pages import record_all, record_results
    from scenarios.views.report import report
    from testbed.objects.files import load_object
    from testbed.sensing.presets import preset
    from testbed.trial import support_of

    def say_trial(number: int, trial: Trajectory, decision: Decision, spent: float) -> None:
        outcome = "" if trial.ok else f" [{trial.status}: {trial.reason}]"
        again = f"; {decision.why}" if decision.action is not None and decision.why else ""
        error = f"{spent:.0f} s of the robot, expected NAD {100 * decision.nad:.3g} %"
        error += "" if decision.answered else ", no answer yet"
        print(f"{number}: {trial.action.describe(model.shape)}{outcome}; {error}{again}", flush=True)

    model, begin = load_object(object_), time.monotonic()
    goal, assumed = search.goal, search.assumed_support or "either"
    family, allowed = search.family(assumed), named_grasps(model, search.grasps)
    carrier = support_of(model.shape, support)
    preset(search.sensing)  # refused before anything is written
    folder = out or Path("results") / f"touch_{model.name}"
    store = Store(folder.absolute(), f"touch/{search.seed}")
    scenario = Scenario(objects=[object_], support=[support or carrier.name], sensing=[search.sensing], seeds=1)
    check_nothing_lost(folder, scenario, store.secret, ACTIVE_FIELDS)
    facts = manifest(scenario, store.secret) | {"name": folder.name, "command": _command(object_, search, support, out)}
    facts["scenario"] = scenario.model_dump(include=ACTIVE_FIELDS)
    with exclusive(folder):
        store.remove_leftovers()
        write_json(folder / "manifest.json", facts | {"finished": False})
        run = ActiveRun(
            model,
            store,
            goal,
            family,
            carrier,
            ASSUMED_SUPPORTS[assumed],
            search.sensing,
            search.candidates,
            allowed,
            search.seed,
        )
        result = run.carry_out(say_trial, lambda weight: print(f"weighed: {weight:.3f} kg", flush=True))
        write_json(folder / "manifest.json", facts | {"wall_s": round(time.monotonic() - begin, 1)})
        write_rows(folder, [result.row])
        for line in _conclusion(model, result, goal):
            print(line)
        if record:
            with show_progress() as progress:
                record_all(folder, progress)
        try:
            print(f"recording: {record_results(folder)}")
        except HeftError as error:
            print(f"no recording: {error}")
        print(f"report: {report(folder)}; results in {folder}/\nview: heft view {folder}")
    if not result.last.answered:
        sys.exit(1)


def _command(object_: str, search: Search, support: str | None, out: Path | None) -> str:
    """Command line that repeats the run: the object, and the options that differ from their defaults."""
    from scenarios.study.run import command_words

    given = {name: value for name, value in vars(search).items() if value != getattr(TOUCHED, name)}
    return shlex.join(command_words("heft", "touch", object_, **given, support=support, out=out))


def _conclusion(model: ObjectModel, result: ActiveResult, goal: Goal) -> Iterator[str]:
    """Lines on the end of the run, the masses, their reliability, and what stays unknown."""
    from estimators.particles.misfit import UNEXPLAINED

    last, row, answer = result.last, result.row, result.last.estimate
    yield f"stopped: {last.why}"
    error = f"expected NAD {100 * (last.nad if last.answered else last.even_nad):.3g} %"
    if not last.answered:
        why = (answer.message if answer is not None else "") or "there are no trials"
        yield f"no answer: {why}"
        yield f"the best available is the weight, {row['weight_kg']:.3f} kg, and even masses: {error}"
    elif goal.until is not None and not goal.met(last.nad):
        yield f"the target of {100 * goal.until:g} % is not reached: {error} is the best achieved"
    if last.answered and math.isfinite(row["nad"]):
        error += f", against the truth {100 * row['nad']:.3g} %"
    yield f"{len(result.keys) - 1} trials, {result.robot_s:.0f} s of the robot; {error}"
    if last.answered:
        misfit = answer.diagnostics.get("misfit", 1.0) if answer is not None else 1.0
        if last.supports == ("own_weight",) and misfit > UNEXPLAINED:
            disagreement = "the trials disagree by more than their errors, which are widened accordingly"
            yield f"{disagreement}: mean squared misfit {misfit:.3g} instead of about 1"
        if row.get("mass_kg") is not None:
            masses = zip(row["group_names"], row["mass_kg"], last.standard_error, strict=True)
            yield ", ".join(f"{group} {mass:.3f} ± {std:.3f}" for group, mass, std in masses) + " kg"
    if answer is not None and answer.identifiability is not None:
        yield from (f"not known: {part}" for part in answer.identifiability.unobservable)
    if last.answered and row.get("message"):
        yield f"{row['status']}: {row['message']}"
    for action, why in last.rejected[:MOST_REJECTED]:
        yield f"not feasible: {action.words(model.shape).name}: {why}"
