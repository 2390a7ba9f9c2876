"""Results on disk: a folder per trial and per estimate, each file written whole; existing ones are done.

results/<scenario>/manifest.json
                   trials/<key>/trajectory.parquet, trial.json    one physical trial, shared by every draw and method
                                foot_forces.parquet               the table's force on each foot, where simulated
                   estimates/<key>/estimate.npz                   mass, friction, covariance, and every trace
                                   result.json                    one answer, with its error against the truth
                                   error.txt                      or why there is none
                   objects/<key>/<name>.toml                      drawn objects
                   notes/<key>.json                               values that are slow to compute
                         marks.parquet                            files that were read whole, until they change
                         <method>.log                             what a method of another package printed
                   results.parquet                                table of the estimates
"""

from __future__ import annotations

import hashlib
import json
import zipfile
from collections.abc import Collection, Iterable
from dataclasses import asdict, dataclass, fields
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from estimators.base import Estimate
from scenarios.results.files import errors_left, inside, read_json, read_manifest, write_json
from scenarios.results.marks import ESTIMATE, Marks, mark_of
from testbed.files import UNSEALED, load_sealed, remove_leftovers, unless_damaged, write_sealed, write_text
from testbed.foot_forces import FootForces, save_foot_forces
from testbed.objects.files import ObjectFile, asset_folder
from testbed.objects.model import Grasp, ObjectModel, ObjectShape, Solid
from testbed.toml import toml_text
from testbed.trajectory import SCHEMA_VERSION, Trajectory, load_trajectory, save_trajectory
from testbed.trial import Trial

if TYPE_CHECKING:  # it needs MuJoCo, which needs a display
    from scenarios.runners import RunnerSettings

_FOLDERS = ("trials", "estimates", "objects", "notes", "figures", "recordings", "exports")
_TRIAL_FILES = ("trial.json", "trajectory.parquet", "foot_forces.parquet")


def key_of(request: dict[str, Any]) -> str:
    """Content key: a hash of canonical JSON."""
    return _digest(_canonical(request).encode())


def keys_of_seeds(request: dict[str, Any], seeds: Iterable[int]) -> list[str]:
    """Content keys of a request with each seed, equal to `key_of` of each."""
    mark = "\0seed\0"
    begin, end = _canonical(request | {"seed": mark}).split(json.dumps(mark))
    return [_digest(f"{begin}{seed}{end}".encode()) for seed in seeds]


def _canonical(request: dict[str, Any]) -> str:
    return json.dumps(request, sort_keys=True, separators=(",", ":"))


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:20]


def trial_request(trial: Trial, settings: RunnerSettings) -> dict[str, Any]:
    """All that determines a physical trial, as plain data, without the sensing, which is drawn afterwards."""
    if trial.world is not None:
        drawn: dict[str, Any] = {"world": trial.world.request(trial.object)}
    else:
        drawn = {"seed": trial.seed} if trial.seed else {}
    return drawn | {
        "schema": SCHEMA_VERSION,
        "assets": _asset_hash(),
        "object": object_request(trial.object),
        "action": trial.action.to_dict(),
        "support": trial.support.name,
        "simulation": asdict(settings),
    }


def record_request(trial: Trial) -> dict[str, Any]:
    """Request of a trial that the simulator did not make, as plain data, without its origin."""
    return {
        "schema": SCHEMA_VERSION,
        "object": object_request(trial.object),
        "action": trial.action.to_dict(),
        "support": trial.support.name,
    }


def object_request(model: ObjectModel) -> dict[str, Any]:
    """All that determines the behaviour of an object, as plain data."""
    shape, truth = model.shape, model.truth
    more: dict[str, Any] = {} if (shape.fill == 1).all() else {"fill": shape.fill.tolist()}
    if not model.masses_known:
        more["masses"] = "unknown"
    if shape.stands_on_feet:
        more["feet"] = "known"
    if shape.chain is not None:
        hinges = {"link": shape.chain.link.tolist(), "hinges": shape.chain.hinges.tolist()}
        more["chain"] = hinges | {"friction": list(model.hinge_friction)}
    return more | {
        "particles": shape.particles.tolist(),
        "mass_group": shape.mass_group.tolist(),
        "friction_group": shape.friction_group.tolist(),
        "cell": shape.cell,
        "height": shape.height,
        "grasps": [_grasp_request(grasp) for grasp in shape.grasps],
        "solids": [_solid_hash(solid) for solid in model.solids],
        "mass": truth.mass.tolist(),
        "friction": truth.friction.tolist(),
    }


def _grasp_request(grasp: Grasp) -> list[float | None]:
    size = [*grasp.position.tolist(), grasp.angle, grasp.width, grasp.length, grasp.bottom, grasp.top]
    return size if grasp.opening is None else [*size, grasp.opening]


def _solid_hash(solid: Solid) -> str:
    parts = (solid.vertices.tobytes(), solid.faces.astype(np.int64).tobytes(), np.float64(solid.mass).tobytes())
    return _digest(b"".join(parts))


@lru_cache(maxsize=1)
def _asset_hash() -> str:
    files = sorted(asset_folder("mjcf").glob("*.xml"))
    return _digest(b"".join(file.read_bytes() for file in files))


@dataclass(frozen=True)
class Store:
    """A results folder."""

    root: Path
    fresh_secret: str | None = None
    """Secret of a run whose manifest is not yet written; None takes it from the manifest."""

    @cached_property
    def secret(self) -> str:
        """Secret that seeds all draws of the run; empty for measured trials, and for runs of heft 0.1.0.

        Raises:
            DamagedFileError: the manifest is damaged.
        """
        if self.fresh_secret is not None:
            return self.fresh_secret
        return (read_manifest(self.root) or {}).get("secret", "")

    @property
    def draws(self) -> dict[str, str]:
        """Entry of a content key that depends on the run's draws: a digest of the secret."""
        return {"draws": _digest(self.secret.encode())} if self.secret else {}

    def has_trial(self, key: str) -> bool:
        """True if a trial is done."""
        return inside(self.root, "trials", key, "trial.json").is_file()

    def has_sound_trial(self, key: str, marks: Marks | None = None) -> bool:
        """True if a trial is done and its files are whole; a damaged trial is set to not done.

        Files with a valid mark are not read; the marks of the others are added to `marks`.
        """
        if not self.has_trial(key):
            return False
        folder = inside(self.root, "trials", key, "trial.json").parent
        files = [name for name in _TRIAL_FILES if (folder / name).exists() or name == "trajectory.parquet"]
        marks, name, mark = {} if marks is None else marks, f"trials/{key}", mark_of(folder, files)
        if marks.get(name) == mark:
            return True
        if unless_damaged(lambda: [load_sealed(folder / file, "file", len) for file in files], "made again") is None:
            (folder / "trial.json").unlink(missing_ok=True)
            return False
        marks[name] = mark
        return True

    def put_trial(
        self, key: str, trial: Trial, request: dict[str, Any], trajectory: Trajectory, feet: FootForces | None = None
    ) -> None:
        """Write a trial; trial.json comes last and marks it as done."""
        folder, shape = inside(self.root, "trials", key, "trial.json").parent, trial.object.shape
        save_trajectory(trajectory, folder / "trajectory.parquet")
        if feet is not None:
            save_foot_forces(feet, folder / "foot_forces.parquet")
        outcome = {"status": trajectory.status, "reason": trajectory.reason, "figures": trajectory.figures}
        names = {"object": trial.object.name, "groups": shape.group_names, "grasps": [g.name for g in shape.grasps]}
        write_json(folder / "trial.json", outcome | {"names": names, "asked": request})
        (folder / "error.txt").unlink(missing_ok=True)

    def trajectory(self, key: str) -> Trajectory:
        """Read a trial back.

        Raises:
            DamagedFileError: damaged.
        """
        return load_trajectory(inside(self.root, "trials", key, "trajectory.parquet"))

    def note(self, key: str) -> dict[str, Any] | None:
        """Content of a note; None where it is missing or damaged."""
        return unless_damaged(lambda: read_json(inside(self.root, "notes", f"{key}.json")), "worked out again")

    def put_note(self, key: str, data: dict[str, Any]) -> None:
        """Write a note: a value that is slow to compute."""
        write_json(inside(self.root, "notes", f"{key}.json"), data)

    def log(self, method: str) -> Path:
        """File of the output of a method of another package."""
        return inside(self.root, "notes", f"{method}.log")

    def put_object(self, path: Path, file: ObjectFile) -> None:
        """Write a drawn object as a file that a user can take."""
        given = {name: value for name, value in file.model_dump(exclude_none=True).items() if value}
        text = toml_text(given) + f"# {UNSEALED}\n"
        write_sealed(path, lambda part: part.write_text(text, encoding="utf-8"))

    def has_object(self, path: Path) -> bool:
        """True if a drawn object's file is there as it was written."""
        if not path.is_file():
            return False
        return unless_damaged(lambda: load_sealed(path, "object file", len), "made again") is not None

    def result(self, key: str) -> dict[str, Any] | None:
        """A finished estimate's row, or None.

        Raises:
            DamagedFileError: damaged.
        """
        return read_json(inside(self.root, "estimates", key, "result.json"))

    def sound_result(self, key: str, marks: Marks) -> dict[str, Any] | None:
        """A finished estimate's row; None where it is not done, or one of its files is damaged. Adds its mark."""
        folder = inside(self.root, "estimates", key, "result.json").parent
        mark = mark_of(folder, ESTIMATE)

        def checked() -> dict[str, Any] | None:
            row = self.result(key)
            if row is not None:
                load_sealed(folder / "estimate.npz", "estimate", len)
                marks[f"estimates/{key}"] = mark
            return row

        return unless_damaged(checked, "made again")

    def put_estimate(self, key: str, row: dict[str, Any], answer: Estimate, shape: ObjectShape) -> None:
        """Write an estimate: its arrays, then its row, which marks it as done."""
        folder = inside(self.root, "estimates", key, "result.json").parent
        write_arrays(folder / "estimate.npz", _arrays_of(answer, shape))
        write_json(folder / "result.json", row)
        (folder / "error.txt").unlink(missing_ok=True)

    def put_error(self, stage: str, key: str, text: str) -> None:
        """Write the error of one of the "trials" or "estimates", which stays undone for the next run."""
        write_text(inside(self.root, stage, key, "error.txt"), text)

    def remove_errors(self, stage: str, but: Collection[str]) -> None:
        """Remove the errors of "trials" or "estimates" whose keys are not in `but`."""
        for path in errors_left(self.root, stage):
            if path.parent.name not in but:
                inside(self.root, stage, path.parent.name, path.name).unlink()

    def remove_leftovers(self) -> None:
        """Remove the partial files of killed runs in the folders of a run; those of running processes stay."""
        remove_leftovers(self.root)
        for folder in (self.root / name for name in _FOLDERS):
            if not folder.is_symlink():
                remove_leftovers(folder, depth=1)


def write_arrays(path: Path, arrays: dict[str, Any]) -> None:
    """Write arrays as a packed NumPy file with its checksum in the comment of the archive."""

    def save(part: Path) -> None:
        with open(part, "wb") as file:
            np.savez_compressed(file, **arrays)
        with zipfile.ZipFile(part, "a") as archive:
            archive.comment = UNSEALED.encode()

    write_sealed(path, save)


def _arrays_of(answer: Estimate, shape: ObjectShape) -> dict[str, Any]:
    arrays: dict[str, Any] = {
        "particles": shape.particles,
        "mass_group": shape.mass_group,
        "friction_group": shape.friction_group,
        "cell": shape.cell,
        "fill": shape.fill,
        "stands_on_feet": shape.stands_on_feet,
    }
    if answer.distribution is not None:
        arrays |= {"mass": answer.distribution.mass, "friction": answer.distribution.friction}
    if answer.covariance is not None:
        arrays["covariance"] = answer.covariance
    for trace in answer.traces:
        name = trace.method.replace(" ", "_")
        arrays |= {f"{name}.loss": trace.loss, f"{name}.seconds": trace.seconds, f"{name}.mass": trace.mass}
        arrays[f"{name}.robot_seconds"] = trace.robot_seconds
    for prefix, value in (("hidden", answer.hidden), ("identifiability", answer.identifiability)):
        if value is not None:
            arrays |= {f"{prefix}.{field.name}": getattr(value, field.name) for field in fields(value)}
    return arrays | {f"diagnostics.{name}": value for name, value in answer.diagnostics.items()}
