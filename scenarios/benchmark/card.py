"""Dataset card of the published folder: README.md, and Croissant metadata with a checksum of each file."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pyarrow.types as kinds

from scenarios.benchmark.dataset import SAMPLES, Problem
from scenarios.benchmark.problems import KINDS, PUBLISHED_SECRET, SENSING, SPLITS, WORLDS
from testbed.files import write_text

NAME, VERSION = "heft-benchmark", "1.0.0"
LICENSE = "https://www.apache.org/licenses/LICENSE-2.0"
ABOUT = (
    "Wrenches at the wrist of a simulated robot arm that turns, pushes, drags and lifts objects, for estimators of how "
    "mass is distributed over an object. The true masses of the test split are hidden."
)
RECORDS = {
    "problems": ("problems.parquet", "An object, its shape, its weight and the errors of the setup as stated."),
    "trials": ("trials.parquet", "A trial: action, status, and all that belongs to the whole record."),
    "samples": (SAMPLES, "A sample of a trial at 100 Hz: wrenches, poses and velocities, SI units."),
    "truth": ("truth.parquet", "Masses of the groups and frictions of train and validation."),
}
"""File and description of each record set."""
_TERMS = ("citeAs", "column", "extract", "field", "fileObject", "fileSet", "format", "includes", "isLiveDataset",
          "jsonPath", "key", "md5", "parentField", "path", "recordSet", "references", "regex", "repeated", "replace",
          "samplingRate", "separator", "source", "subField", "transform", "fileProperty", "equivalentProperty",
          "arrayShape", "isArray", "containedIn")  # fmt: skip
_CONTEXT = {name: f"cr:{name}" for name in _TERMS} | {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "conformsTo": "dct:conformsTo",
    "cr": "http://mlcommons.org/croissant/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "dct": "http://purl.org/dc/terms/",
    "sc": "https://schema.org/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "description": {"@container": "@language"},
    "name": {"@container": "@language"},
}
"""JSON-LD context of Croissant 1.1."""
_TYPES = ((kinds.is_floating, "sc:Float"), (kinds.is_integer, "sc:Integer"), (kinds.is_string, "sc:Text"))
_FORMATS = {".parquet": "application/x-parquet", ".json": "application/json", ".stl": "model/stl"}
_README = """---
license: apache-2.0
pretty_name: {name}
tags: [robotics, force-torque, mass distribution, system identification, LeRobot]
configs:
  - {{config_name: samples, data_files: {samples}}}
  - {{config_name: problems, data_files: problems.parquet}}
  - {{config_name: trials, data_files: trials.parquet}}
  - {{config_name: truth, data_files: truth.parquet}}
---

# {name} {version}

{about}

A problem is an object of known shape, cut into mass groups, with its weight and some trials. The answer is the mass of
each group [kg] with its standard error. No two problems share an object.

{counts}

{kinds}

In the world `ideal` the physics is the model of the estimators; `lab` and `rough` add contact points, uneven friction,
grasp, TCP and sensor errors, whose standard deviations `setup` states. The sensor is an `{sensing}` in all of them.

`problems.parquet` has a row per problem: `shape` is an object file as JSON without masses and frictions, `setup` the
stated errors. `trials.parquet` has a row per trial: its `header` is JSON of action, tool and stated errors. A trial is
an episode of `{samples}`, which with `meta/` is a LeRobot dataset of version 3.0. `truth.parquet` has masses [kg],
frictions and hinge frictions [N m] of train and validation, in the order of `groups`.

Train and validation are drawn from the secret `{secret}`, test from one that is not published. SHA-256 of the file with
the masses of test, which holds a salt: `{truth}`.

Answers are a CSV file with the columns `problem,group,mass_kg,error_kg,status`; `heft score ANSWERS.csv --benchmark
DIR` scores them.
"""


def write_card(folder: Path, problems: Sequence[Problem], truth_sha256: str) -> None:
    """Write README.md, then croissant.json, which holds the checksums of all other files."""
    count = Counter((each.kind, each.world, each.split) for each in problems)
    head = f"| problems | {' | '.join(SPLITS)} |\n|---|{'---|' * len(SPLITS)}\n"
    rows = [
        f"| `{kind}`, `{world}` | {' | '.join(str(count[kind, world, split]) for split in SPLITS)} |"
        for kind in KINDS
        for world in WORLDS
    ]
    text = _README.format(
        name=NAME,
        version=VERSION,
        about=ABOUT,
        samples=SAMPLES,
        counts=head + "\n".join(rows),
        kinds="\n".join(f"* `{name}`: {kind.line}" for name, kind in KINDS.items()),
        sensing=SENSING,
        secret=PUBLISHED_SECRET,
        truth=truth_sha256,
    )
    write_text(folder / "README.md", text)
    write_text(folder / "croissant.json", json.dumps(croissant(folder), indent=1) + "\n")


def croissant(folder: Path) -> dict[str, Any]:
    """Croissant 1.1 metadata of a published folder: its files with their SHA-256, and the fields of its tables."""
    own = {"croissant.json", "benchmark.json"}
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path.name not in own)
    distribution = [_file(folder, path) for path in files if not path.name.startswith(".")]
    return {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.1",
        "name": NAME,
        "description": ABOUT,
        "version": VERSION,
        "license": LICENSE,
        "distribution": distribution,
        "recordSet": [
            _record_set(name, file, line, pq.read_schema(folder / file)) for name, (file, line) in RECORDS.items()
        ],
    }


def _file(folder: Path, path: Path) -> dict[str, Any]:
    name = str(path.relative_to(folder))
    return {
        "@type": "cr:FileObject",
        "@id": name,
        "name": name,
        "contentUrl": name,
        "contentSize": f"{path.stat().st_size} B",
        "encodingFormat": _FORMATS.get(path.suffix, "text/markdown"),
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
    }


def _record_set(name: str, file: str, line: str, schema: pa.Schema) -> dict[str, Any]:
    fields = []
    for column in schema:
        nested = isinstance(column.type, pa.ListType | pa.FixedSizeListType)
        inner = column.type.value_type if nested else column.type
        size = column.type.list_size if isinstance(column.type, pa.FixedSizeListType) else -1
        fields.append(
            {
                "@type": "cr:Field",
                "@id": f"{name}/{column.name}",
                "name": column.name,
                "dataType": next(said for test, said in _TYPES if test(inner)),
                "source": {"fileObject": {"@id": file}, "extract": {"column": column.name}},
            }
            | ({"isArray": True, "arrayShape": str(size)} if nested else {})
        )
    return {"@type": "cr:RecordSet", "@id": name, "name": name, "description": line, "field": fields}
