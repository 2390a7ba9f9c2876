"""Parser of Parquet and HDF5 files: python -m testbed.parsing.tables PATH RESULT.

The result is an npz: the names of all columns of numbers, and the column of each. An item of a list, or a column of an
array, has the name of its list with a dot and its number from 0.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from testbed.parsing.process import run_parser

MOST_ITEMS = 1000
"""Largest number of items of a list, or columns of an array, that are read: images have more."""
MOST_COLUMNS = 10_000
_NUMBERS = "biuf"


def main(path: str, result: str) -> None:
    """Write the columns of a file."""
    found = dict(_parquet(Path(path)) if path.lower().endswith(".parquet") else _hdf5(Path(path)))
    if len(found) > MOST_COLUMNS:
        raise ValueError(f"got {len(found)} columns of numbers; allowed: at most {MOST_COLUMNS}")
    with Path(result).open("wb") as file:
        arrays: dict[str, Any] = {f"column_{i}": values for i, values in enumerate(found.values())}
        np.savez(file, names=np.array(list(found), dtype=str), **arrays)


def _parquet(path: Path) -> Iterator[tuple[str, np.ndarray]]:
    """Columns of numbers and times, and of lists of equally many numbers."""
    file = pq.ParquetFile(path)
    for field in file.schema_arrow:
        if not (_is_number(field.type) or pa.types.is_timestamp(field.type) or _is_list(field.type)):
            continue
        column = file.read([field.name])[field.name]
        if _is_list(field.type):
            yield from _items(field.name, column)
        elif pa.types.is_timestamp(field.type):
            yield field.name, column.cast(pa.timestamp("ns")).to_numpy().astype("datetime64[ns]")
        else:
            yield field.name, _filled(column)


def _is_number(kind: pa.DataType) -> bool:
    return pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind)


def _is_list(kind: pa.DataType) -> bool:
    lists = pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind)
    return lists and _is_number(kind.value_type)


def _filled(column: Any) -> np.ndarray:
    """Column of numbers, NaN where it has none; whole numbers as such."""
    whole = pa.types.is_integer(column.type) and not column.null_count
    return np.asarray(column.cast(pa.int64() if whole else pa.float64()))


def _items(name: str, column: Any) -> Iterator[tuple[str, np.ndarray]]:
    """Items of a column of lists; nothing of lists that differ in length."""
    lists = column.cast(pa.list_(column.type.value_type)).combine_chunks()
    there, inner = np.asarray(lists.is_valid()), lists.drop_null()
    lengths = np.unique(np.asarray(inner.value_lengths()))
    if len(lengths) == 1 and 0 < lengths[0] <= MOST_ITEMS:
        items = np.full((len(there), int(lengths[0])), np.nan)
        items[there] = _filled(inner.flatten()).reshape(-1, int(lengths[0]))
        yield from ((f"{name}.{i}", values) for i, values in enumerate(items.T))


def _hdf5(path: Path) -> Iterator[tuple[str, np.ndarray]]:
    """Arrays of one or two dimensions, and fields of tables; what lies in other files is left out."""
    import h5py  # noqa: PLC0415  an extra, needed by such files alone

    found: list[tuple[str, np.ndarray]] = []

    def visit(name: str, item: Any) -> None:
        if not isinstance(item, h5py.Dataset) or item.is_virtual or item.external:
            return
        if item.dtype.names and item.ndim == 1:
            inner = [field for field in item.dtype.names if item.dtype[field].kind in _NUMBERS]
            found.extend((f"{name}.{field}", item[field]) for field in inner)
        elif item.dtype.kind in _NUMBERS and item.ndim == 1:
            found.append((name, item[()]))
        elif item.dtype.kind in _NUMBERS and item.ndim == 2 and item.shape[1] <= MOST_ITEMS:
            found.extend((f"{name}.{i}", values) for i, values in enumerate(item[()].T))

    with h5py.File(path) as file:
        file.visititems(visit)
    for name, values in found:
        yield name, np.asarray(values, dtype=np.int64 if values.dtype.kind in "iu" else float)


if __name__ == "__main__":
    run_parser(main)
