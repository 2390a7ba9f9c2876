"""Rates of the support test, and masses known under one rigid body: python bench/support.py COMMAND ...

judge OUT.parquet FOLDER... [--sensing NAME]... [--draws N] [--materials KG]...
        every object in folders of results of `heft run`, under fresh draws of the sensors: the test, and what
        support_aware answers, a row a draw
show OUT.parquet [FIGURE.png]
        rates of false alarms and detection, coverage and assignments; and the curve of one rate against the other
stiffness OUT.parquet FIGURE.png
        the same draws by who carries the weight, from own weight over springs between the blocks to one rigid body
        (judge results of `heft run support`): verdicts and NAD, as a table and a figure
speed   2^16 and more assignments ranked, and the whole of support_aware, in the tests' exact world
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd
import torch
from matplotlib.figure import Figure
from rich import box
from rich.console import Console
from rich.table import Table

from estimators.evaluation.metrics import normalized_absolute_difference
from estimators.hidden_states.estimator import HiddenStates
from estimators.posterior.support import EVIDENCE
from estimators.support_models.estimator import SupportAware
from estimators.support_models.materials import rank_assignments
from estimators.testing.analytic_world import accelerated, turns
from scenarios.results.files import read_json
from scenarios.results.store import Store
from scenarios.results.trials import object_of, sensed_trials
from testbed.files import write_whole
from testbed.objects.files import load_object
from testbed.objects.model import ObjectModel
from testbed.sensing.windows import weight_of
from testbed.trajectory import Trajectory
from testbed.trial import parse_support
from viz.style import PALETTE, STYLE, bare, plain_numbers

CONFIDENCE = 0.9
ERRORS = (1, 2, 3)
OWN_WEIGHT, RIGID = "own_weight", "rigid"
LIBRARY = ("I1", "I2", "L1", "L2", "F1", "F2", "hammer", "wrench")


def cells(folder: Path) -> Iterator[tuple[ObjectModel, str, tuple[str, ...]]]:
    """Every object and support of a results folder, and its trials, the weighing first."""
    for path in sorted((folder / "notes").glob("*.json")):
        keys = (read_json(path) or {}).get("keys") or []
        said = read_json(folder / "trials" / keys[1] / "trial.json") if len(keys) > 1 else None
        if said is not None:
            obj = named(object_of(said["asked"]["object"], said.get("names") or {}))
            yield obj, said["asked"]["support"], tuple(keys)


def named(obj: ObjectModel) -> ObjectModel:
    """By its name in the library where the trial does not say what it was of."""
    for name in LIBRARY if obj.name == "object" else ():
        known = load_object(name)
        if np.array_equal(known.shape.particles, obj.shape.particles) and np.array_equal(
            known.truth.mass, obj.truth.mass
        ):
            return replace(obj, name=name)
    return obj


def judge(out: Path, folders: Sequence[Path], sensing: Sequence[str], draws: int, materials: Sequence[float]) -> None:
    """Ask about every draw and write the rows."""
    rows = []
    for folder in folders:
        for obj, support, keys in cells(folder):
            for name in sensing:
                for seed in range(1 if name == "ideal" else draws):
                    drawn = sensed_trials(Store(folder), keys, name, seed)
                    said = {"folder": folder.name, "object": f"{obj.name} {keys[0][:6]}", "support": support}
                    rows.append(said | {"sensing": name, "seed": seed} | judged(obj, drawn, materials))
            print(len(rows), obj.name, support, flush=True)
            write_whole(out, lambda part: pd.DataFrame(rows).to_parquet(part))


def judged(obj: ObjectModel, drawn: Sequence[Trajectory], materials: Sequence[float]) -> dict[str, object]:
    """One draw's answers against the truth."""
    shape, weight = obj.shape, weight_of(drawn[0])
    count, truth = shape.particles_per_group, obj.group_mass
    plain = HiddenStates().estimate(shape, weight, drawn[1:], 0)
    answer = SupportAware(confidence=CONFIDENCE).estimate(shape, weight, drawn[1:], 0)
    row: dict[str, object] = {"groups": shape.n_m, "status": answer.status, "uneven": float(np.ptp(obj.truth.mass))}
    if answer.distribution is None or plain.distribution is None:
        return row
    row |= {name: answer.diagnostics[name] for name in EVIDENCE}
    row["nad_plain"] = normalized_absolute_difference(shape, plain.distribution, obj.truth)
    row["nad"] = normalized_absolute_difference(shape, answer.distribution, obj.truth)
    if "least_0_kg" in answer.diagnostics:
        ends = np.array([[answer.diagnostics[f"{e}_{g}_kg"] for g in range(shape.n_m)] for e in ("least", "most")])
        inside = (ends[0] - 1e-9 <= truth) & (truth <= ends[1] + 1e-9)
        row |= {
            "inside": float(inside.mean()),
            "all_inside": bool(inside.all()),
            "width_kg": float(np.ptp(ends, 0).mean()),
        }
    if answer.covariance is not None:
        error = np.sqrt(np.diag(answer.covariance)) * count
        row["within_90"] = float((np.abs(answer.distribution.mass * count - truth) <= 1.645 * error).mean())
    with_prior = SupportAware(materials_kg=tuple(materials)).estimate(shape, weight, drawn[1:], 0)
    if with_prior.distribution is not None:
        row["right"] = bool(np.allclose(with_prior.distribution.mass * count, truth, rtol=1e-6))
        row["nad_prior"] = normalized_absolute_difference(shape, with_prior.distribution, obj.truth)
        row["probability"] = with_prior.diagnostics.get("assignment_probability", np.nan)
        row["holding_90"] = with_prior.diagnostics.get("assignments_holding_90", np.nan)
    return row


def show(rows: pd.DataFrame, figure: Path | None) -> None:
    """Tables of rates, and the curves."""
    off = []
    for sensing, support in rows[["sensing", "support"]].drop_duplicates().to_numpy():
        part = rows.loc[(rows.sensing == sensing) & (rows.support == support) & rows.rigid_share.notna()]
        apart = ((part.rigid_share - (support == RIGID)).abs() / part.rigid_share_error).to_numpy()
        off.append([sensing, support, str(len(part)), *(percent(apart > error) for error in ERRORS)])
    table(
        "share of a rigid body's loads: % off by more than n errors",
        ["sensor", "support", "draws", *map(str, ERRORS)],
        off,
    )
    rows = rows.assign(group=_group(rows), violated=(rows.status == "assumption_violated").astype(float))
    rows["untested"] = rows.rigid_share.isna()
    rows.loc[rows.untested, "violated"] = np.nan
    rows["open"] = (rows.status == "underdetermined").where(~rows.untested)
    shares = [
        "untested",
        "violated",
        "open",
        "nad",
        "nad_plain",
        "inside",
        "within_90",
        "right",
        "nad_prior",
        "probability",
    ]
    titles = [
        "untested",
        "violated",
        "undecided",
        "NAD",
        "hidden_states",
        "in range",
        "within 90",
        "right",
        "NAD, prior",
        "P best",
    ]
    body = []
    for sensing, support, name in rows[["sensing", "support", "group"]].drop_duplicates().to_numpy():
        part = rows[(rows.sensing == sensing) & (rows.support == support) & (rows.group == name)]
        values = [percent(part[c].dropna().to_numpy(dtype=float)) if c in part else "" for c in shares]
        width = part.width_kg.mean() if "width_kg" in part else np.nan
        factor = f"{part.log10_bayes_factor.min():.1f} to {part.log10_bayes_factor.max():.1f}"
        body.append([sensing, support, name, str(len(part)), factor, *values, f"{width:.2f}"])
    table(
        "support_aware, %; in range: blocks in their ranges of 90 %; within 90: blocks within 1.645 standard errors",
        ["sensor", "support", "object", "draws", "log10 B", *titles, "range kg"],
        body,
    )
    if figure is not None:
        write_whole(figure, lambda part: curves(rows).savefig(part, format="png", dpi=150))


def by_stiffness(rows: pd.DataFrame, figure: Path) -> None:
    """Verdicts and NAD against the stiffness of the springs between blocks, over all objects."""
    rows = rows.loc[rows.sensing == "ft300s"]
    names = sorted(rows.support.unique(), key=_stiffness)
    body = []
    for name in names:
        part = rows.loc[rows.support == name]
        said = [100 * (part.status == s).mean() for s in ("ok", "underdetermined", "assumption_violated")]
        nads = [100 * part[column].mean() for column in ("nad_plain", "nad")]
        factor = part.log10_bayes_factor.median()
        body.append([name, len(part), *said, factor, *nads])
    titles = ["support", "draws", "own weight", "undecided", "violated", "log10 B", "hidden_states", "support_aware"]
    shown = [[str(v) if isinstance(v, (str, int)) else f"{v:.3g}" for v in row] for row in body]
    table("verdicts in % of draws, median Bayes factor, mean NAD in %", titles, shown)
    with mpl.rc_context(STYLE):
        drawn = Figure(figsize=(6.4, 3.2), layout="constrained")
        verdict, error = drawn.subplots(1, 2)
        for index, (axis, column) in enumerate(((verdict, 2), (verdict, 3), (verdict, 4), (error, 6), (error, 7))):
            values = [row[column] for row in body]
            axis.plot(range(len(body)), values, "o-", color=PALETTE[index], label=titles[column])
        for axis, what in ((verdict, "draws, %"), (error, "NAD, %")):
            labels = ["own", *(n.removesuffix(" N/m") for n in names[1:-1]), "rigid"]
            axis.set_xticks(range(len(body)), labels, rotation=45)
            axis.set_xlabel("stiffness between blocks, N/m")
            axis.set_ylabel(what)
            axis.set_ylim(0)
            bare(axis)
            axis.legend(fontsize=8, frameon=False)
        write_whole(figure, lambda part: drawn.savefig(part, format="png", dpi=150))


def _stiffness(name: str) -> float:
    support = parse_support(name.removesuffix(" N/m"))
    return support.stiffness


def _group(rows: pd.DataFrame) -> pd.Series:
    """Library objects by name; drawn ones by their family."""
    named = rows.object.str.split(" ").str[0]
    return named.str.replace(r"_\d+$", "", regex=True)


def curves(rows: pd.DataFrame) -> Figure:
    """Detection against false alarms as the Bayes factor's threshold moves, a line a sensor."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(4.6, 3.2), layout="constrained")
        axis = figure.subplots()
        for index, sensing in enumerate(rows.sensing.unique()):
            part = rows[rows.sensing == sensing]
            own, rigid = (part.log10_bayes_factor[part.support == s].dropna().to_numpy() for s in (OWN_WEIGHT, RIGID))
            if not (len(own) and len(rigid)):
                continue
            limits = np.sort(np.concatenate([own, rigid]))
            false, found = ([float((values <= limit).mean()) for limit in limits] for values in (own, rigid))
            axis.plot(false, found, color=PALETTE[index % len(PALETTE)], label=str(sensing), drawstyle="steps-post")
        axis.set_xscale("symlog", linthresh=1e-2)
        axis.set_xlim(0, 1)
        plain_numbers(axis.xaxis)
        axis.set_xlabel("false alarms on own weight")
        axis.set_ylabel("rigid bodies detected")
        bare(axis)
        axis.legend(fontsize=8, frameon=False, loc="lower right")
    return figure


def speed() -> None:
    """Times of one call, the median of five."""
    rng = np.random.default_rng(0)
    body = []
    for count, kinds in ((6, 2), (16, 2), (20, 2), (12, 3), (16, 3)):
        rows = np.vstack([1e3 * np.ones(count), 60 * rng.standard_normal((3, count))])
        options = np.tile(np.linspace(0.1, 0.4, kinds), (count, 1))
        values = rows @ options[np.arange(count), rng.integers(0, kinds, count)]
        body.append(
            [
                f"{kinds}^{count} assignments",
                f"{1e3 * timed(lambda r=rows, v=values, o=options: rank_assignments(r, v, o)):.0f}",
            ]
        )
    obj = load_object("F2")
    for rigid in (False, True):
        trials = turns(obj, rigid=rigid, noise=0.02) + accelerated(obj, rigid=rigid, noise=0.02)
        for method in (HiddenStates(), SupportAware(), SupportAware(materials_kg=(0.1, 0.4))):
            name = f"{type(method).__name__}{' of materials' if getattr(method, 'materials_kg', ()) else ''}"
            spent = timed(lambda m=method, t=trials: m.estimate(obj.shape, obj.total_mass, t, 0))
            body.append([f"{name}, F2 {RIGID if rigid else OWN_WEIGHT}", f"{1e3 * spent:.0f}"])
    table("ms, one core", ["", "ms"], body)


def timed(call: Callable[[], object]) -> float:
    """Median of five, s."""
    spent = []
    for _ in range(5):
        begin = time.perf_counter()
        call()
        spent.append(time.perf_counter() - begin)
    return float(np.median(spent))


def percent(values: np.ndarray) -> str:
    """A mean share as a percentage; empty where there is none."""
    return f"{100 * values.mean():.3g}" if len(values) else ""


def table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A table on the screen."""
    shown = Table(*columns, title=title, box=box.SIMPLE_HEAD, title_justify="left")
    for row in rows:
        shown.add_row(*row)
    Console(width=180).print(shown)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    judging = commands.add_parser("judge")
    judging.add_argument("out", type=Path)
    judging.add_argument("folders", type=Path, nargs="+")
    judging.add_argument("--sensing", nargs="+", default=["ideal", "ft300s"])
    judging.add_argument("--draws", type=int, default=4)
    judging.add_argument("--materials", type=float, nargs="+", default=[0.1, 0.4])
    showing = commands.add_parser("show")
    showing.add_argument("out", type=Path)
    showing.add_argument("figure", type=Path, nargs="?")
    stiff = commands.add_parser("stiffness")
    stiff.add_argument("out", type=Path)
    stiff.add_argument("figure", type=Path)
    commands.add_parser("speed")
    asked = parser.parse_args()
    torch.set_num_threads(1)
    if asked.command == "judge":
        judge(asked.out, asked.folders, asked.sensing, asked.draws, asked.materials)
    elif asked.command == "show":
        show(pd.read_parquet(asked.out), asked.figure)
    elif asked.command == "stiffness":
        by_stiffness(pd.read_parquet(asked.out), asked.figure)
    else:
        speed()


if __name__ == "__main__":
    main()
