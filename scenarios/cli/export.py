"""heft export: an estimate as a model for another simulator, with its errors beside it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from testbed.errors import InvalidValueError

if TYPE_CHECKING:
    import pandas as pd

    from estimators.evaluation.statistics import Row
    from testbed.objects.export import Exported

_ENDING = {"mjcf": "xml", "urdf": "urdf", "toml": "toml"}


def export(
    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")],
    what: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="ESTIMATE")],
    *,
    format_: Annotated[Literal["mjcf", "urdf", "toml"], tyro.conf.arg(name="format")] = "mjcf",
    inertial: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    draws: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
) -> None:
    """Write an estimate for another simulator: a box a block. A JSON beside it says how sure every mass is.

    Examples: heft export results/blocks 3f9a
              heft export results/blocks 3f9a --format urdf --inertial --out my_robot/hammer.urdf
              heft export results/blocks 3f9a --draws 500

    Args:
        folder: of a run.
        what: beginning of an estimate's key (see its report).
        format_: mjcf, urdf, or toml: an object file that heft itself can run.
        inertial: one mass, centre and inertia for the whole object instead.
        draws: write N draws of masses and frictions from the posterior too, as CSV; of an estimate by Algorithm 1.
        out: DIR/exports/OBJECT_KEY if left out, with the format's ending.
    """
    from scenarios.results.estimates import row_of
    from testbed.objects.export import to_mjcf, to_object_file, to_sidecar, to_urdf
    from testbed.trajectory import write_whole

    row = row_of(folder, what)
    exported = exported_of(folder, row)
    if format_ == "toml":
        if inertial:
            raise InvalidValueError("--inertial", "--format toml", "mjcf or urdf: heft's objects are blocks")
        text = to_object_file(exported)
    else:
        text = (to_mjcf if format_ == "mjcf" else to_urdf)(exported, inertial=inertial)
    path = out or folder / "exports" / f"{exported.name}_{row['key'][:8]}.{_ENDING[format_]}"
    for file, content in ((path, text), (path.with_suffix(".json"), to_sidecar(exported))):
        write_whole(file, lambda part, content=content: part.write_text(content, encoding="utf-8"))
        print(file)
    if draws is not None:
        table = posterior_table(folder, row, draws)
        write_whole(path.with_suffix(".draws.csv"), lambda part: table.to_csv(part, index=False))
        print(path.with_suffix(".draws.csv"))


def posterior_table(folder: Path, row: Row, count: int) -> pd.DataFrame:
    """Draws from the posterior of a row's trials, one a row: mass of each group [kg], and frictions.

    Raises:
        InvalidValueError: an estimate that is not by Algorithm 1, or a count that the sampler cannot give.
    """
    import numpy as np
    import pandas as pd

    from estimators.hidden_states.estimator import HiddenStates
    from estimators.identifiability.posterior import sample_posterior
    from estimators.registry import build_method
    from scenarios.results.estimates import load_estimate
    from scenarios.results.store import Store, read_json
    from scenarios.results.trials import sensed_trials
    from scenarios.views.estimate import estimate_view
    from testbed.sensing.windows import weight_of

    scenario = (read_json(folder / "manifest.json") or {}).get("scenario", {})
    method = build_method(row["kind"], scenario.get("methods", {}).get(row["method"], {}))
    answer, shape = load_estimate(folder, row["key"]), estimate_view(folder, row).shape
    if not isinstance(method, HiddenStates) or answer.distribution is None:
        raise InvalidValueError("--draws", row["method"], "an estimate by hidden_states that has masses")
    weighing, *trials = sensed_trials(Store(folder), tuple(row["trial_keys"]), row["sensing"], int(row["seed"]))
    likelihood = method.likelihood(shape, weight_of(weighing), trials, answer.distribution)
    posterior = sample_posterior(likelihood, answer.distribution, seed=0, covariance=answer.covariance)
    if not 1 <= count <= len(posterior.mass):
        raise InvalidValueError("--draws", count, f"an integer from 1 to {len(posterior.mass)}")
    chosen = np.random.default_rng(0).choice(len(posterior.mass), count, replace=False)
    frictions = ["friction"] if shape.n_mu == 1 else [f"friction {k}" for k in range(shape.n_mu)]
    table = np.hstack([posterior.mass[chosen], posterior.friction[chosen]])
    return pd.DataFrame(table, columns=[*shape.group_names, *frictions])


def exported_of(folder: Path, row: Row) -> Exported:
    """The masses of a row of the results, as they are exported.

    Raises:
        InvalidValueError: it has none.
    """
    from scenarios.views.estimate import estimate_view
    from testbed.objects.export import Exported

    view = estimate_view(folder, row)
    if view.answer is None:
        why = f"{row['status']}: {row['message']}"
        raise InvalidValueError("ESTIMATE", row["key"], f"one with masses; this one has none, {why}")
    why = f": {row['message']}" if row.get("message") else ""
    notes = (
        f"estimated by heft: {view.title}, draw {row['seed']}",
        f"status {row['status']}{why}",
        f"estimate {row['key']}",
    )
    return Exported(str(row["object"]), view.shape, view.answer, view.covariance, notes)
