"""Freeze the numbers of cases and sweeps, where a change is meant: python -m tests.goldens.make [NAME ...]."""

import json
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from tests.goldens.cases import CASES, SWEEPS, frozen, rows_of

HERE = Path(__file__).parent

if __name__ == "__main__":
    for name in sys.argv[1:] or (*CASES, *SWEEPS):
        if name in CASES:
            np.savez_compressed(HERE / f"{name}.npz", allow_pickle=False, **frozen(CASES[name]()))
        if name in SWEEPS:
            with TemporaryDirectory() as out:
                text = json.dumps(rows_of(name, Path(out)), indent=1)
            (HERE / f"rows_{name}.json").write_text(text + "\n", encoding="utf-8")
