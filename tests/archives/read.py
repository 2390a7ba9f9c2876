"""Content of a golden folder, as plain data that can be held against what the version that wrote it read."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from estimators.base import Estimate
from scenarios.results.estimates import load_estimate, load_rows, load_trajectories
from scenarios.results.store import Store
from scenarios.results.trials import measured_records, read_trial, sensed_trials
from testbed.foot_forces import load_foot_forces
from testbed.objects.files import load_object
from testbed.robot.calibration.file import load_calibration
from testbed.trajectory import SERIES, Trajectory

HERE = Path(__file__).parent


def content(folder: Path) -> dict[str, Any]:
    """Content of a golden folder."""
    run, measured, imported = (folder / name for name in ("run", "measured", "imported"))
    return {
        "object": of_object(folder / "pair.toml"),
        "trials": {f"{p.name}/{k}": of_trajectory(t) for p in (run, measured, imported) for k, t in trials(p)},
        "objects of trials": {
            f"{p.name}/{key}": [r.object.name, r.support, r.object.group_mass.tolist(), list(r.pads)]
            for p in (run, measured, imported)
            for key, _ in trials(p)
            for r in [read_trial(p, key)]
        },
        "draws": draws(run),
        "feet": {p.parent.name: digest(load_foot_forces(p).force) for p in sorted(run.glob("trials/*/foot_forces.*"))},
        "rows": {p.name: [of_row(row) for row in load_rows(p)] for p in (run, measured)},
        "estimates": {
            f"{p.name}/{row['key']}": of_estimate(load_estimate(p, row["key"]))
            for p in (run, measured)
            for row in load_rows(p)
        },
        "in order of recording": [record.folder.name for record in measured_records(measured)],
        "calibration": {k: digest(v) for k, v in asdict(load_calibration(folder / "calibration.toml")).items()},
        "raw": {p.name: p.read_text(encoding="utf-8").splitlines()[-1] for p in sorted(measured.glob("raw/*.csv"))},
    }


def trials(folder: Path) -> list[tuple[str, Trajectory]]:
    """Key and record of every trial of a results folder."""
    return list(load_trajectories(folder))


def draws(run: Path) -> dict[str, Any]:
    """Records under the draw of the sensor's errors from which each estimate of a run was made."""
    return {
        f"{row['sensing']} {row['seed']} {key}": of_trajectory(drawn)
        for row in load_rows(run)
        for key, drawn in zip(
            row["trial_keys"],
            sensed_trials(Store(run), tuple(row["trial_keys"]), row["sensing"], int(row["seed"])),
            strict=True,
        )
    }


def of_object(path: Path) -> dict[str, Any]:
    """Shape and masses of an object file."""
    model = load_object(str(path))
    return {"masses": model.group_mass.tolist(), "particles": digest(model.shape.particles), "name": model.name}


def of_trajectory(record: Trajectory) -> dict[str, Any]:
    """All of a trajectory, series by their digests."""
    camera, tool = record.camera, record.tool
    return {
        "action": record.action.to_dict(),
        "status": [record.status, record.reason],
        "series": {name: digest(getattr(record, name)) for name in ("time_s", "phase", "segment", *SERIES)},
        "bias": record.sensor_bias_std.tolist(),
        "drift": record.sensor_drift_std.tolist(),
        "setup": asdict(record.setup),
        "tool": None if tool is None else {name: digest(value) for name, value in asdict(tool).items()},
        "camera": None if camera is None else [digest(camera.time_s), digest(camera.poses), camera.position_std],
        "figures": record.figures,
        "provenance": record.provenance,
    }


def of_row(row: Any) -> dict[str, Any]:
    """A row of results."""
    return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in row.items()}


def of_estimate(answer: Estimate) -> dict[str, Any]:
    """An estimate."""
    found, hidden = answer.distribution, answer.hidden
    return {
        "masses": None if found is None else found.mass.tolist(),
        "friction": None if found is None else found.friction.tolist(),
        "status": [answer.status, answer.message, answer.assumes],
        "covariance": None if answer.covariance is None else digest(answer.covariance),
        "hidden": None if hidden is None else [hidden.center_of_mass.tolist(), hidden.inertia_cm],
        "traces": [[trace.method, digest(np.array(trace.loss))] for trace in answer.traces],
        "diagnostics": answer.diagnostics,
    }


def digest(values: Any) -> list[float | int]:
    """Count, sum of finite values, first and last of an array: enough to tell any change of its meaning."""
    flat = np.asarray(values, dtype=float).ravel()
    kept = flat[np.isfinite(flat)]
    ends = [float(kept[0]), float(kept[-1])] if len(kept) else []
    return [flat.size, len(kept), float(kept.sum()), *ends]
