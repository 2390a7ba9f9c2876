"""Export: an estimated mass distribution as boxes and a rigid body, in MJCF, URDF, SDF, an object file, and JSON."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from jaxtyping import Float

from testbed.errors import InvalidValueError
from testbed.objects.model import MassDistribution, ObjectShape
from testbed.toml import toml_text
from testbed.validation import freeze_arrays


@dataclass(frozen=True, eq=False)
class Box:
    """A box of even density, its sides along the object's axes."""

    name: str
    """Name of the block, with a number if it has several boxes."""
    center: Float[np.ndarray, "3"]
    """Center [m], object frame, z from the table."""
    size: Float[np.ndarray, "3"]
    """Sides [m]."""
    mass: float
    """Mass [kg]."""
    group: int
    """Mass group."""
    friction: float | None
    """Friction coefficient under it; None if it does not touch the table."""


@dataclass(frozen=True, eq=False)
class RigidBody:
    """Mass properties of a rigid body, object frame, z from the table."""

    mass: float
    """Mass [kg]."""
    center: Float[np.ndarray, "3"]
    """Center of mass [m]."""
    inertia: Float[np.ndarray, "3 3"]
    """Inertia about the center of mass [kg m^2]."""

    def __post_init__(self) -> None:
        freeze_arrays(self, center=(3,), inertia=(3, 3))

    @staticmethod
    def of(boxes: Sequence[Box]) -> RigidBody:
        """Rigid body of all boxes."""
        mass = np.array([box.mass for box in boxes])
        centers = np.array([box.center for box in boxes])
        total = float(mass.sum())
        center = mass @ centers / total
        inertia = np.zeros((3, 3))
        for box in boxes:
            sides, off = box.size**2, box.center - center
            own = np.diag(sides.sum() - sides) / 12
            inertia += box.mass * (own + off @ off * np.eye(3) - np.outer(off, off))
        return RigidBody(total, center, inertia)

    @property
    def pseudo_inertia(self) -> Float[np.ndarray, "4 4"]:
        """Positive definite for every body that can exist (Wensing, Kim and Slotine 2018)."""
        second = np.trace(self.inertia) / 2 * np.eye(3) - self.inertia + self.mass * np.outer(self.center, self.center)
        first = self.mass * self.center
        return np.block([[second, first[:, None]], [first[None], np.array([[self.mass]])]])


AIR = 0.001
"""Height over the table of boxes that do not touch it [m], that no simulator has them rub; a tenth of a flat object."""


def boxes_of(shape: ObjectShape, distribution: MassDistribution) -> list[Box]:
    """A box a mass group where its cells, all alike, fill a rectangle of one friction; else a box a cell."""
    if shape.chain is not None:
        raise InvalidValueError("object", "one with hinges", "a rigid object: exports have no hinges yet")
    boxes, air = [], min(AIR, shape.height / 10)
    for group, name in enumerate(shape.group_names):
        inside = np.flatnonzero(shape.mass_group == group)
        low, high = shape.particles[inside].min(axis=0), shape.particles[inside].max(axis=0)
        cells = np.rint((high - low) / shape.cell) + 1
        frictions = set(shape.friction_group[inside].tolist())
        even = len(frictions) == 1 and (shape.fill[inside] == 1).all()
        parts = [inside] if even and int(cells.prod()) == len(inside) else list(inside[:, None])
        for index, part in enumerate(parts):
            low, high = shape.particles[part].min(axis=0), shape.particles[part].max(axis=0)
            under = int(shape.friction_group[part[0]])
            bottom = air if under < 0 else 0.0
            boxes.append(
                Box(
                    name if len(parts) == 1 else f"{name}_{index}",
                    np.array([*(low + high) / 2, (shape.height + bottom) / 2]),
                    np.array([*(high - low + shape.cell), shape.height - bottom]),
                    float(distribution.mass[group] * shape.fill[part].sum()),
                    group,
                    None if under < 0 else float(distribution.friction[under]),
                )
            )
    return boxes


@dataclass(frozen=True, eq=False)
class Exported:
    """Estimate to be written to a file."""

    name: str
    """Name of the object."""
    shape: ObjectShape
    """Geometry of the object."""
    distribution: MassDistribution
    """Estimated masses and frictions."""
    covariance: Float[np.ndarray, "n_m n_m"] | None = None
    """Covariance of the particle masses [kg^2], infinite if unobserved; None if the method gives none."""
    notes: tuple[str, ...] = ()
    """Origin of the estimate, a line each."""

    @property
    def boxes(self) -> list[Box]:
        """The object as boxes."""
        return boxes_of(self.shape, self.distribution)

    @property
    def group_deviation(self) -> list[float] | None:
        """Standard deviation of each group's mass [kg]."""
        if self.covariance is None:
            return None
        return (np.sqrt(np.diag(self.covariance)) * self.shape.particles_per_group).tolist()

    @property
    def comment(self) -> str:
        """Notes, and every group's mass with its standard deviation."""
        mass = self.distribution.mass * self.shape.particles_per_group
        deviation = self.group_deviation or [None] * len(mass)
        lines = [*self.notes, "masses, kg, with one standard deviation:"]
        for name, kg, off in zip(self.shape.group_names, mass, deviation, strict=True):
            lines.append(f"  {name}: {kg:.4g} " + ("(not given)" if off is None else f"+- {off:.2g}"))
        lines.append("friction on the table: " + ", ".join(f"{mu:.4g}" for mu in self.distribution.friction))
        return "\n".join(lines).replace("--", "- -")


def to_mjcf(exported: Exported, *, inertial: bool = False) -> str:
    """A free body of boxes, as MJCF: the text of the file.

    Args:
        exported: the answer.
        inertial: one inertial for the whole, and boxes without mass; else every box has its own.
    """
    root = Element("mujoco", model=exported.name)
    root.append(ElementTree.Comment(f"\n{exported.comment}\n"))
    body = SubElement(SubElement(root, "worldbody"), "body", name=exported.name)
    SubElement(body, "freejoint", name=exported.name)
    if inertial:
        whole = RigidBody.of(exported.boxes)
        SubElement(
            body, "inertial", pos=_row(whole.center), mass=_row([whole.mass]), fullinertia=_row(_six(whole.inertia))
        )
    for box in exported.boxes:
        said = {"name": box.name, "type": "box", "pos": _row(box.center), "size": _row(box.size / 2)}
        if box.friction is not None:
            said["friction"] = _row([box.friction, 0.005, 0.0001])
        SubElement(body, "geom", said, mass=_row([0.0 if inertial else box.mass]))
    return _text(root)


def to_urdf(exported: Exported, *, inertial: bool = False) -> str:
    """A link of boxes, as URDF, which has no friction: that is in its comment.

    Args:
        exported: the answer.
        inertial: one link with one inertial for the whole; else a link a box, fixed to a root without mass.
    """
    robot = Element("robot", name=exported.name)
    robot.append(ElementTree.Comment(f"\n{exported.comment}\n"))
    root, boxes = SubElement(robot, "link", name=exported.name), exported.boxes
    for name, inside in ({exported.name: boxes} if inertial else _links(boxes)).items():
        link = root if inertial else SubElement(robot, "link", name=name)
        _add_inertial(link, RigidBody.of(inside))
        if not inertial:
            joint = SubElement(robot, "joint", name=f"{name}_fixed", type="fixed")
            SubElement(joint, "parent", link=exported.name)
            SubElement(joint, "child", link=name)
        for box in inside:
            for kind in ("visual", "collision"):
                part = SubElement(link, kind, name=f"{box.name}_{kind}")
                SubElement(part, "origin", xyz=_row(box.center), rpy="0 0 0")
                SubElement(SubElement(part, "geometry"), "box", size=_row(box.size))
    return _text(robot)


def to_sdf(exported: Exported, *, inertial: bool = False) -> str:
    """A model of boxes with their friction, as SDFormat 1.9.

    Args:
        exported: the answer.
        inertial: one link with one inertial for the whole; else a link a box, each fixed to the first.
    """
    sdf = Element("sdf", version="1.9")
    sdf.append(ElementTree.Comment(f"\n{exported.comment}\n"))
    model, boxes = SubElement(sdf, "model", name=exported.name), exported.boxes
    parts = {exported.name: boxes} if inertial else _links(boxes)
    for name, inside in parts.items():
        link, body = SubElement(model, "link", name=name), RigidBody.of(inside)
        part = SubElement(link, "inertial")
        _add_texts(part, pose=[*body.center, 0, 0, 0], mass=[body.mass])
        _add_texts(SubElement(part, "inertia"), **{n: [v] for n, v in zip(_SIX, _six(body.inertia), strict=True)})
        for box in inside:
            for kind in ("visual", "collision"):
                part = SubElement(link, kind, name=f"{box.name}_{kind}")
                _add_texts(part, pose=[*box.center, 0, 0, 0])
                _add_texts(SubElement(SubElement(part, "geometry"), "box"), size=box.size)
                if kind == "collision" and box.friction is not None:
                    friction = SubElement(SubElement(part, "surface"), "friction")
                    _add_texts(SubElement(friction, "ode"), mu=[box.friction], mu2=[box.friction])
    first, *rest = parts
    for name in rest:
        joint = SubElement(model, "joint", name=f"{name}_fixed", type="fixed")
        SubElement(joint, "parent").text, SubElement(joint, "child").text = first, name
    return _text(sdf)


def written(exported: Exported, format_: str, *, inertial: bool = False) -> str:
    """The text of a file of some format: mjcf, urdf, sdf or toml.

    Raises:
        InvalidValueError: a format that cannot say it.
    """
    if format_ != "toml":
        return {"mjcf": to_mjcf, "urdf": to_urdf, "sdf": to_sdf}[format_](exported, inertial=inertial)
    if inertial:
        raise InvalidValueError("--inertial", "--format toml", "mjcf, urdf or sdf: heft's objects are blocks")
    return to_object_file(exported)


def to_object_file(exported: Exported) -> str:
    """An object file of heft, with what was estimated as its truth.

    Raises:
        InvalidValueError: the object is not of square blocks alike.
    """
    shape, boxes = exported.shape, exported.boxes
    size = float(boxes[0].size[0])
    square = all(np.allclose(box.size[:2], size, rtol=1e-6) for box in boxes)
    if not (square and len(boxes) == shape.n_m):
        allowed = "an object of square blocks alike; of other parts heft needs their meshes: mjcf, urdf or sdf"
        raise InvalidValueError("--format", "toml", allowed)
    corner = np.min([box.center for box in boxes], axis=0)
    places = [tuple(np.rint((box.center - corner)[:2] / size).astype(int).tolist()) for box in boxes]
    order = sorted(range(len(boxes)), key=lambda i: (places[i][1], places[i][0]))
    columns, rows = (max(place[axis] for place in places) + 1 for axis in (0, 1))
    layout = ["".join("10"[(c, r) not in places] for c in range(columns)) for r in reversed(range(rows))]
    first = [int(np.flatnonzero(shape.mass_group == boxes[i].group)[0]) for i in order]
    blocks = {
        "layout": layout,
        "mass_kg": [boxes[i].mass for i in order],
        "friction": exported.distribution.friction.tolist(),
        "friction_group": [int(shape.friction_group[particle]) for particle in first],
        "size_m": size,
        "height_m": shape.height,
    }
    comment = "".join(f"# {line}\n" for line in exported.comment.splitlines())
    return comment + toml_text({"name": exported.name, "blocks": blocks})


def to_sidecar(exported: Exported) -> str:
    """JSON of the estimate with its uncertainty; null if unobserved or not given."""
    shape, whole = exported.shape, RigidBody.of(exported.boxes)
    count = shape.particles_per_group
    covariance = None if exported.covariance is None else exported.covariance * np.outer(count, count)
    said = {
        "name": exported.name,
        "notes": list(exported.notes),
        "groups": list(shape.group_names),
        "mass_kg": (exported.distribution.mass * count).tolist(),
        "mass_std_kg": _finite(exported.group_deviation),
        "mass_covariance_kg2": None if covariance is None else [_finite(row) for row in covariance.tolist()],
        "friction": exported.distribution.friction.tolist(),
        "total_mass_kg": whole.mass,
        "center_of_mass_m": whole.center.tolist(),
        "inertia_about_center_kg_m2": whole.inertia.tolist(),
    }
    return json.dumps(said, indent=1) + "\n"


def _links(boxes: Sequence[Box]) -> dict[str, list[Box]]:
    """A link a box; one without mass, as a point of contact, is part of the first that has some."""
    links = {box.name: [box] for box in boxes if box.mass > 0}
    next(iter(links.values())).extend(box for box in boxes if box.mass == 0)
    return links


def _add_inertial(link: Element, body: RigidBody) -> None:
    part = SubElement(link, "inertial")
    SubElement(part, "origin", xyz=_row(body.center), rpy="0 0 0")
    SubElement(part, "mass", value=_row([body.mass]))
    SubElement(part, "inertia", {n: _row([v]) for n, v in zip(_SIX, _six(body.inertia), strict=True)})


def _add_texts(parent: Element, **values: Iterable[float]) -> None:
    for name, numbers in values.items():
        SubElement(parent, name).text = _row(numbers)


_SIX = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")


def _six(inertia: np.ndarray) -> list[float]:
    return [float(inertia[i, j]) for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]


def _row(values: Iterable[float]) -> str:
    return " ".join(repr(float(value)) for value in values)


def _text(root: Element) -> str:
    ElementTree.indent(root)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _finite(values: Sequence[float] | None) -> list[float | None] | None:
    return None if values is None else [value if np.isfinite(value) else None for value in values]
