"""Random changes to files: of bytes, of plain data, of sealed content."""

import json
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from scenarios.results.files import read_json, write_json
from scenarios.results.store import write_arrays
from testbed.files import UNSEALED, write_sealed
from testbed.toml import toml_text

SEALED = (".json", ".npz", ".parquet")
"""Endings of stored files."""
EXTREME: list[Any] = [None, True, -1, 0, 1e300, -1e-300, 10**30, "", "x" * 5000, "../../x", [], {}, [[[[1]]]]]
WORDS = [b"-1", b"1e308", b"nan", b"inf", b"9" * 400, b"[", b"{", b"'", b"\xff", b"\n", b"a" * 3000, b"\0\0\0\xff"]


def turned(data: bytes, rng: np.random.Generator) -> bytes:
    """Bytes with one to four changes."""
    new = bytearray(data)
    for _ in range(int(rng.integers(1, 5))):
        at, end = sorted(int(i) for i in rng.integers(0, len(new) + 1, 2))
        word = WORDS[rng.integers(len(WORDS))]
        ways = [(at + 1, word[:1]), (end, b""), (at, new[at : min(end, at + 4000)]), (at + 3, word)]
        cut, put = ways[rng.integers(len(ways))]
        new[at:cut] = put
    return bytes(new)


def changed(value: Any, rng: np.random.Generator) -> Any:
    """Plain data with one entry removed or replaced by an extreme value."""
    if not isinstance(value, dict | list) or not value or rng.random() < 0.1:
        return EXTREME[rng.integers(len(EXTREME))]
    copy: Any = value.copy()
    at = list(copy)[rng.integers(len(copy))] if isinstance(copy, dict) else int(rng.integers(len(copy)))
    if rng.random() < 0.2:
        del copy[at]
    else:
        copy[at] = changed(copy[at], rng)
    return copy


def restated(data: bytes, rng: np.random.Generator) -> bytes:
    """Content of a TOML file with one entry removed or replaced by an extreme value."""
    return toml_text(changed(tomllib.loads(data.decode()), rng)).encode()


def resealed(path: Path, rng: np.random.Generator) -> None:
    """Change the content of a stored file, and seal it again."""
    if path.suffix == ".json":
        data = changed(read_json(path), rng)
        write_json(path, data if isinstance(data, dict) else {"x": data})
    elif path.suffix == ".npz":
        with np.load(path) as file:
            arrays = dict(file)
        name = list(arrays)[rng.integers(len(arrays))]
        shape = arrays[name].shape
        odd = [np.zeros(0), arrays[name][..., None], np.full(shape, np.nan), np.array("x"), np.zeros((9, 9))]
        write_arrays(path, arrays | {name: odd[rng.integers(len(odd))]})
    else:
        table = pq.read_table(path)
        meta = {key: value for key, value in (table.schema.metadata or {}).items() if key != b"checksum"}
        if b"heft" in meta and rng.random() < 0.6:
            meta[b"heft"] = json.dumps(changed(json.loads(meta[b"heft"]), rng)).encode()
        else:
            column, odd = int(rng.integers(table.num_columns)), EXTREME[int(rng.choice([0, 2, 4, 8]))]
            table = table.set_column(column, table.column_names[column], pa.array([odd] * table.num_rows))
        table = table.replace_schema_metadata({**meta, b"checksum": UNSEALED.encode()})
        write_sealed(path, lambda part: pq.write_table(table, part))
