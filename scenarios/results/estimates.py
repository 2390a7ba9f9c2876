"""Estimates of a results folder: as a table, as rows, as values.

Columns of the table, a row per estimate (one method, one draw of the sensor's errors):

| column | |
|---|---|
| object, support, sensing, method, seed | the experiment and the draw; `method` is the scenario's label |
| kind | the method behind the label |
| axis.<field> | value of each swept field of the scenario |
| status | ok; underdetermined, unexplained, no_data: stated by the method; failed, infeasible: no answer |
| message | why status is not ok |
| assumes | assumption of the masses that the method does not test; empty if it states none |
| nad | normalized absolute difference: sum of the masses' errors over the true mass, 0 is right |
| mpd_m | mean particle distance at the end of a turn, open loop, as in the paper |
| mpd_open_loop_m, mpd_turn_m | the same after 1 s; over a whole turn, state reset each step |
| mpd_of_truth_m, mpd_open_loop_of_truth_m, mpd_turn_of_truth_m | the same of the true masses; first method only |
| mass_kg, mass_error_kg, true_mass_kg, group_names | of each mass group; its standard error, where a method has one |
| misfit | squared residual over its variance: about 1 or less where the masses explain the trials |
| friction | of each friction group |
| com_error_m, inertia_error, unobserved | of methods with hidden states: distance of c, I_cm over the truth minus 1 |
| hinge_Nm, hinge_error_Nm, true_hinge_Nm | friction of each hinge, its standard error, and the true one |
| hinge_error | mean error of the hinges' friction over its mean |
| weight_kg | M as weighed |
| loss, optimizer | least loss of the search, and the optimizer that found it |
| rollouts | guesses that the search compared with all data; 0 of methods that do not search |
| trials, robot_s | number of trials of the method, and their robot time |
| seconds | computing time of the estimate |
| key | folder of the estimate in estimates/ |
| trial_keys | folders in trials/ of the trials of the method, the weighing first |
| held_out_keys | folders in trials/ of the turns that its prediction is compared with |
"""

from __future__ import annotations

import dataclasses
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from estimators.base import Estimate, HiddenStateEstimate, Trace
from estimators.evaluation.statistics import Row
from estimators.identifiability.report import Identifiability
from scenarios.results.files import (
    STAGES,
    check_unambiguous,
    done_keys,
    errors_left,
    inside,
    read_json,
    some_keys,
    stored,
)
from scenarios.results.store import Store
from scenarios.results.table import has_files, rows_of
from testbed.errors import HeftError, InvalidValueError, short
from testbed.files import MOST_BYTES, DamagedFileError, load_sealed, read_table, unless_damaged
from testbed.objects.model import MassDistribution
from testbed.trajectory import Trajectory

DIAGNOSTICS = "diagnostics."
"""Prefix of the names of an estimate's diagnostics in its file."""

LABELS = ("object", "support", "sensing", "method", "kind", "seed", "status", "message", "nad", "mass_kg", "trial_keys")
"""Columns that every row has."""

MOST_TRACES = 40
"""Estimates of a method whose losses are read."""


def load_results(path: str | Path) -> pd.DataFrame:
    """Table of the estimates of a run, a row each.

    Args:
        path: results folder, or its results.parquet.

    Raises:
        InvalidValueError: there are no results.
        HeftError: the table is damaged.
    """
    file = Path(path) / "results.parquet" if Path(path).is_dir() else Path(path)
    if not file.is_file():
        raise InvalidValueError(
            "path", str(path), "a results folder with a results.parquet, which a finished run leaves"
        )
    return load_sealed(file, "table of results", lambda data: read_table(data).to_pandas())


def load_trajectories(path: str | Path) -> Iterator[tuple[str, Trajectory]]:
    """Key and record of every finished trial of a run, one at a time, without draws of sensor errors.

    Args:
        path: results folder.

    Raises:
        InvalidValueError: not a results folder.
        DamagedFileError: a damaged record.
    """
    folder = Path(path)
    if not (folder / "trials").is_dir():
        raise InvalidValueError("path", str(path), "a results folder, with trials/ in it")
    for key in done_keys(folder, "trials"):
        yield key, Store(folder).trajectory(key)


def load_rows(folder: Path) -> Sequence[Row]:
    """Rows of the finished estimates; in the order of the scenario once the run is finished.

    Raises:
        HeftError: a row of another version of heft.
    """
    if (folder / "results.parquet").is_file():
        rows = rows_of(load_results(folder))
    else:
        rows = [{"key": place.name} | row for place, row in stored(folder, "estimates") if row]
    if missing := {name for row in rows for name in LABELS if name not in row}:
        raise HeftError(f"{folder}: not of this version of heft: an estimate has no {', '.join(sorted(missing))}")
    return rows


def row_of(folder: Path, beginning: str) -> Row:
    """Row of the estimate whose key has this beginning.

    Raises:
        InvalidValueError: no such estimate, or more than one.
    """
    rows = [row for row in load_rows(folder) if row.get("key")]
    found = [row for row in rows if str(row["key"]).startswith(beginning)]
    each = [*dict.fromkeys(str(row["key"]) for row in found)]  # points of a sweep may share an estimate
    check_unambiguous("ESTIMATE", beginning, each)
    if not found:
        there = some_keys([str(row["key"]) for row in rows])
        allowed = f"the beginning of an estimate's key in {folder}: {there or 'none is there'}"
        raise InvalidValueError("ESTIMATE", beginning, allowed)
    return found[0]


def load_estimate(folder: str | Path, key: str) -> Estimate:
    """Estimate as `Store.put_estimate` wrote it, the trace of the answer's optimizer first.

    Args:
        folder: results folder.
        key: whole key of the estimate.

    Raises:
        HeftError: no such estimate, or a file of it is damaged.
    """
    place = inside(Path(folder), "estimates", key, "result.json").parent
    row = read_json(place / "result.json")
    if row is None:
        raise HeftError(f"{place}: no result.json")
    arrays = load_arrays(folder, key)
    led = str(row.get("optimizer") or "").replace(" ", "_")
    traces = [name.removesuffix(".seconds") for name in arrays if name.endswith(".seconds")]
    with this_version(place):
        return Estimate(
            MassDistribution(arrays["mass"], arrays["friction"]) if "mass" in arrays else None,
            row["status"],
            row.get("message") or "",
            arrays.get("covariance"),
            _value(Identifiability, "identifiability", arrays),
            _value(HiddenStateEstimate, "hidden", arrays),
            tuple(_trace(name, arrays) for name in sorted(traces, key=lambda name: name != led)),
            row.get("seconds") or 0.0,
            {key.removeprefix(DIAGNOSTICS): float(v) for key, v in arrays.items() if key.startswith(DIAGNOSTICS)},
            row.get("assumes") or "",
        )


@contextmanager
def this_version(place: Path) -> Iterator[None]:
    """Turn errors over missing or odd arrays and fields into a DamagedFileError that names `place`."""
    try:
        yield
    except KeyError as error:
        raise DamagedFileError(f"{place}: not of this version of heft: it has no {error.args[0]}") from None
    except (TypeError, ValueError, IndexError, AttributeError) as error:  # values of other kinds and shapes
        raise DamagedFileError(f"{place}: not of this version of heft: {short(error, str)}") from None


def _trace(name: str, arrays: dict[str, np.ndarray]) -> Trace:
    return Trace(
        name.replace("_", " "),
        tuple(arrays[f"{name}.loss"].tolist()),
        tuple(arrays[f"{name}.seconds"].tolist()),
        float(arrays[f"{name}.robot_seconds"]),
        arrays[f"{name}.mass"],
    )


def _value(kind: type[Any], prefix: str, arrays: dict[str, np.ndarray]) -> Any:
    """Dataclass from the arrays of its fields; None where one is missing."""
    fields = {f.name: arrays.get(f"{prefix}.{f.name}") for f in dataclasses.fields(kind)}
    if any(array is None for array in fields.values()):
        return None
    annotations = {f.name: str(f.type) for f in dataclasses.fields(kind)}
    return kind(**{name: _plain(array, annotations[name]) for name, array in fields.items() if array is not None})


def _plain(array: np.ndarray, annotation: str) -> Any:
    if annotation.startswith("tuple"):
        return tuple(tuple(item) if isinstance(item, list) else item for item in array.tolist())
    return array.item() if annotation in ("float", "int", "str") else array


def load_arrays(folder: str | Path, key: str, ends: str = "") -> dict[str, np.ndarray]:
    """Arrays of an estimate's file whose names end in `ends`.

    Raises:
        DamagedFileError: the file is missing or damaged.
    """

    def parsed(data: bytes) -> dict[str, np.ndarray]:
        with zipfile.ZipFile(BytesIO(data)) as packed:
            if (size := sum(entry.file_size for entry in packed.infolist())) > MOST_BYTES:
                raise ValueError(f"{size} bytes unpacked, more than the {MOST_BYTES} that are read")
        with np.load(BytesIO(data), allow_pickle=False) as file:
            return {name: file[name] for name in file if name.endswith(ends)}

    path = inside(Path(folder), "estimates", key, "estimate.npz")
    return load_sealed(path, "estimate", parsed)


def load_losses(folder: Path, rows: Sequence[Row]) -> dict[str, dict[str, list[np.ndarray]]]:
    """Losses, (I,) each, by method and optimizer; an even choice of at most MOST_TRACES estimates of a method."""
    keys: dict[str, list[str]] = {}
    for row in rows:
        if has_files(row):
            keys.setdefault(row["method"], []).append(row["key"])
    losses: dict[str, dict[str, list[np.ndarray]]] = {}
    for method, of_method in keys.items():
        for index in np.unique(np.linspace(0, len(of_method) - 1, MOST_TRACES).astype(int)):
            key = of_method[index]
            arrays = unless_damaged(lambda key=key: load_arrays(folder, key, ".loss"), "left out")
            for name, loss in (arrays or {}).items():
                if not name.startswith(DIAGNOSTICS):
                    losses.setdefault(method, {}).setdefault(name.removesuffix(".loss"), []).append(loss)
    return losses


def load_tracebacks(folder: Path) -> dict[str, str]:
    """Tracebacks of the failed trials and estimates that are not done since, by path."""
    errors = [path for stage in STAGES for path in errors_left(folder, stage)]
    return {str(path.relative_to(folder)): path.read_text(encoding="utf-8", errors="replace") for path in errors}
