"""`heft import`: logs of another bench become trials of a results folder."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console

from scenarios.folder_lock import exclusive
from scenarios.progress import show_progress
from scenarios.store import Store, key_of, object_request, read_json
from testbed.actions import action_to_dict
from testbed.arrays import check_positive
from testbed.errors import HeftError, InvalidValueError
from testbed.lab_logs.importer import import_trajectory, object_of
from testbed.lab_logs.logs import LogError, all_of
from testbed.lab_logs.mapping import Mapping
from testbed.object_files import load_toml
from testbed.objects import ObjectModel
from testbed.replay import Recording
from testbed.robot.assembly import read_off
from testbed.trajectory import SCHEMA_VERSION, Trajectory
from testbed.trial import Support, Trial, parse_support


@dataclass(frozen=True)
class Wish:
    """Where the trials go, and what the logs do not say."""

    out: Path
    weight: float | None = None
    support: str = "own_weight"


def import_logs(console: Console, mapping: Path, logs: Sequence[Path], wish: Wish) -> int:
    """Read all logs, then write all trials; 0 where every one is data, else 1.

    Raises:
        HeftError: a file is not what it should be; a line for each error of all files, and nothing is written.
    """
    asked, support = load_toml(mapping, Mapping), parse_support(wish.support)
    paths = list(dict.fromkeys(logs)) or [mapping.parent / entry.file for entry in asked.logs]
    if not paths:
        raise InvalidValueError("LOG", None, f"one .csv or .mcap file or more, or [[logs]] tables in {mapping}")
    if wish.weight is not None:
        check_positive("--weight", wish.weight)
    with show_progress(console) as progress:
        told = partial(progress, "logs", total=len(paths))
        reads = [partial(_read, path, mapping, partial(told, i + 1)) for i, path in enumerate(paths)]
        model, *trajectories = all_of(lambda: object_of(asked, mapping), *reads)
    with exclusive(wish.out):
        store = Store(wish.out.absolute())
        store.remove_leftovers()
        for path, trajectory in zip(paths, trajectories, strict=True):
            key = _stored(store, model, support, trajectory, path, asked.of(path, mapping.parent))
            console.print(_said(path, model, trajectory, key), highlight=False, markup=False, soft_wrap=True)
        if wish.weight is not None:
            _put_weight(store, model, support, wish.weight)
    bad = sum(not trajectory.ok for trajectory in trajectories)
    console.print(
        f"{len(paths)} trial{'s' * (len(paths) > 1)} of {model.name} in {wish.out}, {bad} of them no data; "
        f"heft estimate {wish.out} asks every method"
        + ("" if wish.weight is not None else f", once it knows what {model.name} weighs: --weight KG"),
        highlight=False,
        soft_wrap=True,
    )
    return int(bad > 0)


def _read(path: Path, mapping: Path, told: Callable[[], None]) -> Trajectory:
    """Every line of an error begins with the file that is wrong."""
    try:
        return import_trajectory(path, mapping)
    except HeftError as error:
        lines = str(error).splitlines()
        named = [line if Path(line.split(": ")[0]).is_file() else f"{path}: {line}" for line in lines]
        raise LogError("\n".join(named)) from None
    finally:
        told()


def _stored(
    store: Store, model: ObjectModel, support: Support, trajectory: Trajectory, path: Path, mapping: Mapping
) -> str:
    """Put a trial where simulated ones are kept, in the place of an earlier import of the same log; its key."""
    content = hashlib.sha256(path.read_bytes()).hexdigest()
    imported = {"log": path.name, "sha256": content, "mapping": mapping.model_dump(exclude_none=True)}
    asked = _asked(model, support, trajectory) | {"import": imported}
    key = key_of(asked)
    store.put_trial(key, Trial(model, trajectory.action, support), asked, trajectory)
    for said in store.root.glob("trials/*/trial.json"):
        earlier = (read_json(said) or {}).get("asked", {}).get("import", {}).get("sha256")
        if earlier == content and said.parent.name != key:
            shutil.rmtree(said.parent)
    return key


def _put_weight(store: Store, model: ObjectModel, support: Support, weight: float) -> None:
    """Keep a scale's reading (kg) as a weighing."""
    read = read_off(weight)
    read = replace(read, provenance=read.provenance | {"runner": "import"})
    asked = _asked(model, support, read) | {"weight_kg": weight}
    store.put_trial(key_of(asked), Trial(model, read.action, support), asked, read)


def _asked(model: ObjectModel, support: Support, trajectory: Trajectory) -> dict[str, Any]:
    return {
        "schema": SCHEMA_VERSION,
        "object": object_request(model),
        "action": action_to_dict(trajectory.action),
        "support": support.name,
    }


def _said(path: Path, model: ObjectModel, trajectory: Trajectory, key: str) -> str:
    """What a log was taken for, to be held against what one knows of it."""
    why, said = f": {trajectory.reason}" if trajectory.reason else "", trajectory.provenance
    done = Recording(path, trajectory.action, model.name, None).said
    return (
        f"{trajectory.status:8}{path}: {done}: trial {key[:8]}{why}\n"
        f"        {trajectory.time_s[-1]:.1f} s; phases {said['phases']}; velocity {said['velocity']}; "
        f"joints {said['joints']}\n        drift: {said['drift']}"
    )
