"""Logs of another robot, stored as trials of a results folder."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from scenarios.results.files import exclusive, stored
from scenarios.results.store import Store, key_of, record_request
from testbed.errors import HeftError, InvalidValueError
from testbed.importers.clocks import Delay, pooled_delay
from testbed.importers.importer import delay_of, import_trajectory, object_of
from testbed.importers.logs import LogError, read_all
from testbed.importers.mapping import LogMap, Mapping, moved_as_stored
from testbed.objects.model import ObjectModel
from testbed.robot.runner import read_off
from testbed.toml import load_toml
from testbed.trajectory import Trajectory
from testbed.trial import Trial, parse_support, support_of
from testbed.validation import check_kilograms

LONGEST_NAME = 200
"""Longest beginning of an error that may be the name of a file."""


@dataclass(frozen=True, eq=False)
class ImportedLog:
    """One log as a trial."""

    path: Path
    """Path of the log."""
    place: str
    """Path and stretch of the log."""
    object: ObjectModel
    trajectory: Trajectory
    key: str
    """Key of the trial."""
    source: dict[str, Any]
    """Checksum of the files, and mapping, delay and stretch, as in the trial's request."""
    replaced: list[str] = field(default_factory=list)
    """Keys of the removed earlier trials of the same stretch."""
    alike: list[str] = field(default_factory=list)
    """Keys of earlier trials of the stretch in other files of the same name, which stay."""
    of_others: dict[str, str] = field(default_factory=dict)
    """Name of the other object of each earlier trial of the same stretch, which stays, by the trial's key."""


def import_logs(
    mapping: Path,
    logs: Sequence[Path],
    out: Path,
    support_name: str | None,
    weight: float | None,
    progress: Callable[[str, int, int], None],
) -> list[ImportedLog]:
    """Read all logs, then write all trials.

    Args:
        mapping: TOML file that names the columns.
        logs: tables, .mcap files or ROS 2 bags; default: the logs that the mapping names.
        out: results folder.
        support_name: support of the object, if known; None is the default of `support_of`.
        weight: mass of the object as read from a scale [kg]; None is unknown.
        progress: callback for the number of logs that are read.

    Raises:
        HeftError: unreadable or wrong files; a line for each error, and nothing is written.
    """
    content = load_toml(mapping, Mapping)
    if support_name is not None:
        parse_support(support_name)  # refused before anything is read
    paths = list(dict.fromkeys(logs)) or [mapping.parent / entry.file for entry in content.logs]
    if not paths:
        raise InvalidValueError("LOG", None, f"one log or more, or [[logs]] tables in {mapping}")
    if weight is not None:
        check_kilograms("--weight", weight)
    logged = {path.resolve(): path for path in paths}.values()  # several [[logs]] may name one
    entries = [(path, entry) for path in logged for entry in content.entries(path, mapping.parent)]
    delays = read_all(*(partial(_named, *one, partial(delay_of, one[0], mapping, entry=one[1])) for one in entries))
    delay = pooled_delay([delay for delay in delays if delay is not None])
    reads = [
        partial(_read, *one, mapping, delay, partial(progress, "logs", i, len(entries)))
        for i, one in enumerate(entries, 1)
    ]
    model, *trajectories = read_all(lambda: object_of(content, mapping), *reads)
    support = support_of(model.shape, support_name)
    sources = [_source(path, entry, content, mapping.parent, delay) for path, entry in entries]
    first: dict[str, Path] = {}
    for (path, _), source in zip(entries, sources, strict=True):
        if (same := key_of(source)) in first:
            raise InvalidValueError("LOG", str(path), f"each recording once: {first[same]} is the same")
        first[same] = path
    with exclusive(out):
        store = Store(out.absolute())
        store.remove_leftovers()
        imported = []
        for (path, entry), trajectory, source in zip(entries, trajectories, sources, strict=True):
            named = {"log": path.name} | source
            key = _put(store, Trial(model, trajectory.action, support), trajectory, {"import": named})
            imported.append(ImportedLog(path, _place(path, entry), model, trajectory, key, named))
        _remove_earlier(store, imported)
        if weight is not None:
            read = read_off(weight)
            read = replace(read, provenance=read.provenance | {"runner": "import"})
            _put(store, Trial(model, read.action, support), read, {"weight_kg": weight, "name": model.name})
    return imported


def _read(path: Path, entry: LogMap, mapping: Path, delay: Delay | None, done: Callable[[], None]) -> Trajectory:
    try:
        return _named(path, entry, partial(import_trajectory, path, mapping, delay=delay, entry=entry))
    finally:
        done()


def _source(path: Path, entry: LogMap, content: Mapping, folder: Path, delay: Delay | None) -> dict[str, Any]:
    """Checksum of a trial's files, and its mapping, delay and stretch: all that its trajectory depends on."""
    table = content.for_entry(entry)
    checksum = _checksum([path, *([folder / table.sensor.file] if table.sensor.file else [])])
    read: dict[str, Any] = {"sha256": checksum, "mapping": table.model_dump(exclude_none=True)}
    parts = table.camera.parts if table.camera else []
    names = (table.sensor.calibration, table.hand.urdf, *(part.file for part in parts))
    beside = [path for name in names if name and (path := folder / name).exists()]  # columns need no URDF
    read |= {"beside": _checksum(beside)} if beside else {}
    read |= {"delay_s": list(delay)} if delay and table.separate else {}
    return read | ({"stretch": entry.stretch} if entry.stretch else {})


def _place(path: Path, entry: LogMap) -> str:
    return ", ".join(filter(None, (str(path), entry.stretch)))


def _named(path: Path, entry: LogMap, read: Callable[[], Any]) -> Any:
    """Result of `read`; every line of its error begins with the log or another file."""
    try:
        return read()
    except HeftError as error:
        raise placed_in(_place(path, entry), error) from None


def placed_in(place: str, error: HeftError) -> LogError:
    """Error whose lines begin with the place of a log, unless they begin with a file."""

    def named(line: str) -> bool:
        file = line.split(": ", maxsplit=1)[0]
        return len(file) < LONGEST_NAME and Path(file).exists()

    return LogError("\n".join(line if named(line) else f"{place}: {line}" for line in str(error).splitlines()))


def _put(store: Store, trial: Trial, trajectory: Trajectory, origin: dict[str, Any]) -> str:
    """Store a trial as simulated ones are stored; return its key."""
    request = record_request(trial) | origin
    key = key_of(request)
    provenance = trajectory.provenance | {"imported": datetime.now(UTC).isoformat()}
    store.put_trial(key, trial, request, replace(trajectory, provenance=provenance))
    return key


def _remove_earlier(store: Store, imported: Sequence[ImportedLog]) -> None:
    """Remove earlier trials of the imported stretches; note those of other files or objects, which stay."""
    keys = {log.key for log in imported}
    for place, known in stored(store.root, "trials", "left as it is"):
        earlier = (known or {}).get("asked", {}).get("import", {})
        if known is None or not earlier or place.name in keys:
            continue
        name, checksum = known["names"]["object"], earlier["sha256"]
        over = [log for log in imported if _overlap(log.source, earlier)]
        same = [log for log in over if log.object.name == name]
        if of_log := [log for log in same if log.source["sha256"] == checksum]:
            shutil.rmtree(place)
            of_log[0].replaced.append(place.name)
        for log in same if not of_log else ():
            if log.source["log"] == earlier["log"]:
                log.alike.append(place.name)
        for log in over if not same else ():
            if log.source["sha256"] == checksum:
                log.of_others[place.name] = name


def _overlap(one: dict[str, Any], other: dict[str, Any]) -> bool:
    """True if two trials are of the same rows of a log, and their motions overlap in time."""
    (begin, end), (start, stop) = moved_as_stored(one), moved_as_stored(other)
    where, others = (source["mapping"].get("where") or {} for source in (one, other))  # an older heft wrote none
    return where == others and begin < stop and start < end


def _checksum(logs: Sequence[Path]) -> str:
    """SHA-256 of the concatenated files of logs; of a bag's folder the files in it."""
    total = hashlib.sha256()
    for log in logs:
        for file in sorted(f for f in log.iterdir() if f.is_file()) if log.is_dir() else [log]:
            total.update(file.read_bytes())
    return total.hexdigest()
