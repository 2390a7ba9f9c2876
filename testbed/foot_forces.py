"""Forces of the table on the feet of a simulated object: for views of a trial, not for estimators."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
from jaxtyping import Float, Int

from testbed.errors import InvalidValueError
from testbed.files import load_sealed, read_table, write_table
from testbed.validation import freeze_arrays

_AXES = ("fx_N", "fy_N", "fz_N")


@dataclass(frozen=True, eq=False)
class FootForces:
    """Forces on F feet at N samples. No bench can measure them: a record of the real arm has none."""

    time_s: Float[np.ndarray, "N"]
    """Time of each sample [s], on the trajectory's clock."""
    particle: Int[np.ndarray, "F"]
    """Particle over each foot."""
    force: Float[np.ndarray, "N F 3"]
    """Force of the table on the object [N], world axes: friction, and the normal load along z."""

    def __post_init__(self) -> None:
        particle = np.array(self.particle)
        if particle.ndim != 1 or not np.issubdtype(particle.dtype, np.integer):
            raise InvalidValueError("FootForces.particle", f"{particle.dtype} of shape {particle.shape}", "integers")
        freeze_arrays(self, time_s=(None,))
        object.__setattr__(self, "particle", particle)
        freeze_arrays(self, force=(len(self.time_s), len(particle), 3))


def save_foot_forces(feet: FootForces, path: Path) -> None:
    """Write foot forces as Parquet in single precision, with a list of feet per sample, atomically."""
    count = len(feet.particle)
    lists = {
        axis: pa.FixedSizeListArray.from_arrays(pa.array(feet.force[:, :, i].astype(np.float32).ravel()), count)
        for i, axis in enumerate(_AXES)
    }
    table = pa.table({"time_s": feet.time_s} | lists)
    particle = ",".join(map(str, feet.particle))
    split = {name: "BYTE_STREAM_SPLIT" for name in ("time_s", *(f"{axis}.list.element" for axis in _AXES))}
    write_table(path, table, {"particle": particle}, use_dictionary=False, column_encoding=split)


def load_foot_forces(path: Path) -> FootForces:
    """Read foot forces back.

    Raises:
        DamagedFileError: a file that is missing or damaged.
    """

    def parsed(data: bytes) -> FootForces:
        table = read_table(data)
        particle = np.array((table.schema.metadata or {})[b"particle"].decode().split(","), dtype=np.int64)
        axes = [table.column(a).combine_chunks().flatten().to_numpy(zero_copy_only=False) for a in _AXES]
        force = np.stack([axis.reshape(table.num_rows, len(particle)) for axis in axes], axis=-1)
        return FootForces(table.column("time_s").to_numpy(), particle, force)

    return load_sealed(path, "file of foot forces", parsed)
