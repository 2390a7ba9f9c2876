"""Parser of mesh files: python -m testbed.parsing.meshes PATH RESULT.

The result is an npz: vertices in the file's unit, triangles, piece of the file and color of each, and the unit if the
file says it.
"""

from __future__ import annotations

import re
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Int
from trimesh.visual import ColorVisuals

from testbed.files import read_file
from testbed.objects.meshes import check_triangles, joined
from testbed.parsing.process import run_parser

MOST_BYTES, MOST_FACES = 128 * 2**20, 1_000_000
"""Largest file, and largest number of triangles."""


def main(path: str, result: str) -> None:
    """Write the triangles of a mesh file."""
    kind, content = Path(path).suffix.lower().removeprefix("."), read_file(Path(path), MOST_BYTES)
    without_pictures: dict[str, Any] = {"skip_materials": True} if kind == "glb" else {}
    scene = trimesh.load_scene(BytesIO(content), file_type=kind, process=False, **without_pictures)
    pieces = [piece for piece in scene.dump() if isinstance(piece, trimesh.Trimesh) and len(piece.faces)]
    if not pieces:
        raise ValueError("no triangles in it")
    count = sum(len(piece.faces) for piece in pieces)
    if count > MOST_FACES:
        raise ValueError(f"{count} triangles, where {MOST_FACES} are the most")
    for piece in pieces:
        check_triangles(piece)
    labels = np.concatenate([_colors(piece, index) for index, piece in enumerate(pieces)])
    whole = joined(pieces)
    head = content[:4096].decode("ascii", "ignore").lower() if kind in ("ply", "obj") else ""
    said = re.search(r"(?:unit|length)[^\n]*?(millimet|centimet|met|inch)", head)
    with Path(result).open("wb") as file:
        np.savez(
            file,
            vertices=np.asarray(whole.vertices, dtype=float),
            faces=np.asarray(whole.faces),
            labels=np.unique(labels, return_inverse=True, axis=0)[1].ravel(),
            unit=str(scene.units or ("meters" if kind == "glb" else said[1] if said else "")),
        )


def _colors(piece: trimesh.Trimesh, index: int) -> Int[np.ndarray, "F 5"]:
    """Piece of the file and color of each triangle; no colors where it only has vertices'."""
    found = np.zeros((len(piece.faces), 5), dtype=int)
    found[:, 0] = index
    look = piece.visual
    if isinstance(look, ColorVisuals) and look.kind == "face":
        found[:, 1:] = look.face_colors
    elif isinstance(look, ColorVisuals) and look.kind == "vertex":
        found[:, 1:] = np.sort(look.vertex_colors[piece.faces], axis=1)[:, 1]
    return found


if __name__ == "__main__":
    run_parser(main)
