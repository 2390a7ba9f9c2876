"""Parts of a surface, each a closed body: by planes, connected bodies, colours, labelled points or width."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh
from manifold3d import Manifold, OpType
from scipy.spatial import KDTree

from testbed.errors import InvalidValueError
from testbed.objects.conversion.surface import FINENESS, SMALL, UNITS, Surface, as_mesh

NODES = 60
"""Nodes of the grid on which labels divide a body, along its longest side."""
MOST_PARTS = 12
"""Parts of an object, at most."""
WAYS = (
    f"1 to {MOST_PARTS} parts, planes as 0.3,0.6, bodies, colours, clusters or clusters:3, or a PLY of labelled points"
)
LABELS = ("segmentation", "label", "labels", "class", "part")
"""Properties of a point that may be its label."""
NEIGHBOURS = 5
"""Nearest points of a label whose mean distance is compared."""
CLUSTERS = 3
"""Clusters where no number is given."""
SLICES = 100
"""Slices along the length in which the width is measured."""
ONE_LABEL = 0.9
"""Share of one label on the surface of a body above which the whole body has it."""


def cut(surface: Surface, how: str) -> tuple[list[Manifold], str]:
    """Parts of a surface that lies along x, from left to right, and the name of the division.

    Overlaps of parts belong to the smaller one.

    Args:
        surface: on the table, its longest side along x.
        how: "3", "0.3,0.6" (planes at parts of its length), "bodies", "colours" (the surface's labels), "clusters:3"
            (where its width changes), or "auto": colours if there are two, else bodies, else three.

    Raises:
        InvalidValueError: another word, or more than `MOST_PARTS`.
    """
    if how == "auto":
        tried = (cut(surface, way) for way in ("colours", "bodies", "3"))
        return next((parts, way) for parts, way in tried if len(parts) > 1)
    if how == "bodies":
        parts = _apart(surface.bodies)
    elif how == "colours":
        parts = _by_labels(surface)
    elif how.startswith("clusters"):
        parts = _by_planes(surface.whole, _clustered(surface, how))
    else:
        parts = _by_planes(surface.whole, _shares(how))
    whole = sum(part.volume() for part in parts)
    parts = [part.simplify(FINENESS) for part in parts if part.volume() > SMALL / 5 * whole]
    if len(parts) > MOST_PARTS:
        raise InvalidValueError("parts", f"{how}: {len(parts)} parts", f"at most {MOST_PARTS}")
    return sorted(parts, key=lambda part: as_mesh(part).center_mass[0]), how


def labelled(surface: Surface, path: Path) -> Surface:
    """The surface with the labels of the points of a PLY file, in the frame of the mesh file.

    The labels are a property beside place and color: `segmentation`, `label`, `class` or `part`. Its unit is the one
    in which the points span what the mesh does.

    Raises:
        InvalidValueError: no such file, a damaged PLY, no labels, or points of another object.
    """
    if not path.is_file():
        raise InvalidValueError("parts", str(path), WAYS)
    try:
        cloud = trimesh.load(path)
    except Exception as error:  # a parser may raise anything
        raise InvalidValueError("parts", path.name, f"a PLY of points with x, y and z; {error!r}") from None
    vertex = cloud.metadata.get("_ply_raw", {}).get("vertex", {})
    data = vertex.get("data")
    names = () if data is None else data if isinstance(data, dict) else data.dtype.names  # of text, of binary files
    name = next((name for name in names if name.lower() in LABELS), None)
    if data is None or name is None:
        raise InvalidValueError("parts", path.name, "a PLY with a property segmentation, label, class or part")
    points = np.column_stack([data[axis] for axis in "xyz"]).astype(float)
    if len(points) != vertex["length"]:
        allowed = f"{vertex['length']} points, as its header states"
        raise InvalidValueError("parts", f"{path.name} of {len(points)} points", allowed)
    span, wanted = np.ptp(points, axis=0).max(), np.ptp(surface.points, axis=0).max()
    scale = next((s for s in UNITS.values() if 0.8 < span * s / wanted < 1.25), None)
    if scale is None:
        raise InvalidValueError(
            "parts", f"points that span {span:.4g}", f"points of the mesh, which spans {wanted:.4g} m"
        )
    labels = np.unique(np.asarray(data[name]).ravel(), return_inverse=True)[1]
    nearest = KDTree(surface.points).query(points * scale)[1]
    return replace(surface, points=points * scale, labels=labels, of_body=surface.of_body[nearest])


def _clustered(surface: Surface, how: str) -> list[float]:
    """Cuts into clusters of even width along the length, as parts of it: the global least sum of squares."""
    given = how.removeprefix("clusters").removeprefix(":") or str(CLUSTERS)
    if not (given.isdecimal() and 2 <= int(given) <= MOST_PARTS):
        raise InvalidValueError("parts", how, f"clusters, or clusters:2 to clusters:{MOST_PARTS}")
    count, along = int(given), surface.points[:, 0]
    edges = np.linspace(along.min(), along.max(), SLICES + 1)
    of_slice = np.clip(np.digitize(along, edges) - 1, 0, SLICES - 1)
    kept = np.unique(of_slice)
    count = min(count, len(kept))
    width = [np.ptp(surface.points[of_slice == i, 1:], axis=0).sum() for i in kept]
    n, sums = len(width), np.cumsum(np.column_stack([width, np.square(width)]), axis=0)
    sums = np.vstack([np.zeros(2), sums])
    size = np.maximum(np.arange(n + 1) - np.arange(n + 1)[:, None], 1)  # of slices begin to end
    total, square = (sums[None, :, k] - sums[:, None, k] for k in (0, 1))
    cost = np.where(np.triu(np.ones((n + 1, n + 1)), 1) > 0, square - total**2 / size, np.inf)
    best, before = cost[0], []
    for _ in range(count - 1):
        tried = best[:, None] + cost
        before.append(tried.argmin(axis=0))
        best = tried.min(axis=0)
    cuts = [n]
    for back in reversed(before):
        cuts.append(int(back[cuts[-1]]))
    low, _, _, high, _, _ = surface.whole.bounding_box()
    # between the last slice of one cluster and the first of the next: those of a gap are empty
    ends = [edges[0] + (edges[1] - edges[0]) * (kept[c - 1] + 1 + kept[c]) / 2 for c in sorted(cuts[1:])]
    return [float((end - low) / (high - low)) for end in ends]


def _shares(how: str) -> list[float]:
    """Positions of the cuts, as parts of the length."""
    try:
        if "," not in how and "." not in how:
            count = int(how)
            shares = [k / count for k in range(1, count)] if 1 <= count <= MOST_PARTS else [-1.0]
        else:
            shares = sorted(float(word) for word in how.split(","))
    except ValueError:
        shares = [-1.0]
    if not all(0 < share < 1 for share in shares):
        raise InvalidValueError("parts", how, WAYS)
    return shares


def _by_planes(whole: Manifold, shares: list[float]) -> list[Manifold]:
    low, _, _, high, _, _ = whole.bounding_box()
    parts = []
    for share in shares:
        whole, left = whole.split_by_plane((1.0, 0.0, 0.0), low + share * (high - low))
        parts.append(left)
    return [*parts, whole]


def _apart(bodies: Sequence[Manifold]) -> list[Manifold]:
    """Bodies, the largest first, without overlaps, which belong to the smaller one."""
    parts, taken = [], Manifold()
    for body in reversed(bodies):
        parts.append(body - taken)
        taken += body
    return parts[::-1]


def _by_labels(surface: Surface) -> list[Manifold]:
    """Material of each label: a body of one label as a whole, others divided by the nearest label."""
    of_label: dict[int, list[Manifold]] = {}
    for index, whole in enumerate(_apart(surface.bodies)):
        rest, own = whole, surface.of_body == index
        share = np.bincount(surface.labels[own], minlength=1) / max(own.sum(), 1)
        present = np.flatnonzero(share > 1 - ONE_LABEL)
        trees = {label: KDTree(surface.points[own & (surface.labels == label)]) for label in present.tolist()}
        largest, *others = sorted(trees, key=lambda label: -share[label]) or [0]
        for label in others:
            nearer = rest ^ _region(whole, [trees[label], *(trees[other] for other in trees if other != label)])
            of_label.setdefault(label, []).append(nearer)
            rest -= nearer
        of_label.setdefault(largest, []).append(rest)
    return [Manifold.batch_boolean(bodies, OpType.Add) for _, bodies in sorted(of_label.items())]


def _region(body: Manifold, trees: list[KDTree]) -> Manifold:
    """Region around a body in which the points of the first tree are nearer than those of all others."""
    low, high = np.reshape(body.bounding_box(), (2, 3))
    step = float((high - low).max()) / NODES
    low, high = low - 2 * step, high + 2 * step
    axes = [np.arange(a, b + step, step) for a, b in zip(low, high, strict=True)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    far = [
        tree.query(nodes, k=min(NEIGHBOURS, tree.n))[0].reshape(*nodes.shape[:3], -1).mean(axis=-1) for tree in trees
    ]
    field = (np.min(far[1:], axis=0) - far[0]).tolist()
    x0, y0, z0 = low.tolist()
    a, b, c = (len(axis) - 2 for axis in axes)

    def nearer(x: float, y: float, z: float) -> float:
        """Trilinear interpolation in plain Python, since it is called a hundred thousand times for one point each."""
        x, y, z = (x - x0) / step, (y - y0) / step, (z - z0) / step
        i, j, k = min(max(int(x), 0), a), min(max(int(y), 0), b), min(max(int(z), 0), c)
        x, y, z = x - i, y - j, z - k
        left, right = field[i], field[i + 1]
        near = (left[j][k] * (1 - z) + left[j][k + 1] * z) * (1 - y) + (
            left[j + 1][k] * (1 - z) + left[j + 1][k + 1] * z
        ) * y
        far = (right[j][k] * (1 - z) + right[j][k + 1] * z) * (1 - y) + (
            right[j + 1][k] * (1 - z) + right[j + 1][k + 1] * z
        ) * y
        return near * (1 - x) + far * x

    return Manifold.level_set(nearer, [*low + step / 2, *high - step / 2], step)
