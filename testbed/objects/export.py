"""Export: an estimated object as boxes, one rigid body a link, in MJCF, URDF, SDF, an object file, and JSON."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import trimesh
from jaxtyping import Float

from testbed.errors import InvalidValueError
from testbed.objects.blocks import MOST_ROWS, Cell, layout_of
from testbed.objects.bodies import Box, Link, RigidBody, boxes_of, links_of
from testbed.objects.chain import checked_torques
from testbed.objects.model import MassDistribution, ObjectShape
from testbed.toml import toml_lists, toml_text


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
    hinge_friction: tuple[float, ...] = ()
    """Torque of Coulomb friction of each hinge of the chain [N m]; zeros if left out."""
    hinge_deviation: tuple[float, ...] | None = None
    """Standard deviation of each torque [N m]; None if the method gives none."""

    def __post_init__(self) -> None:
        torques = checked_torques("Exported.hinge_friction", self.hinge_friction, self.shape.chain)
        object.__setattr__(self, "hinge_friction", torques)
        if self.hinge_deviation is not None and len(self.hinge_deviation) != len(torques):
            allowed = f"{len(torques)} numbers, one per hinge, or None"
            raise InvalidValueError("Exported.hinge_deviation", self.hinge_deviation, allowed)

    @property
    def boxes(self) -> list[Box]:
        """The object as boxes, object frame."""
        return boxes_of(self.shape, self.distribution)

    @property
    def links(self) -> list[Link]:
        """Links of the chain in order; a rigid object has one.

        Raises:
            InvalidValueError: a link without mass.
        """
        return links_of(self.name, self.shape, self.distribution, self.hinge_friction)

    @property
    def has_hinges(self) -> bool:
        """True for an object of several links."""
        return self.shape.chain is not None

    @property
    def group_deviation(self) -> list[float] | None:
        """Standard deviation of each group's mass [kg]."""
        if self.covariance is None:
            return None
        return (np.sqrt(np.diag(self.covariance)) * self.shape.particles_per_group).tolist()

    @property
    def comment(self) -> str:
        """Notes, masses and torques of hinges with their standard deviations, and frictions on the table."""
        mass = self.distribution.group_mass(self.shape)
        deviation = self.group_deviation or [None] * len(mass)
        lines = [*self.notes, "masses, kg, with one standard deviation:"]
        for name, kg, off in zip(self.shape.group_names, mass, deviation, strict=True):
            lines.append(f"  {name}: {kg:.4g} " + ("(not given)" if off is None else f"+- {off:.2g}"))
        lines.append("friction on the table: " + ", ".join(f"{mu:.4g}" for mu in self.distribution.friction))
        for index, torque in enumerate(self.hinge_friction):
            off = "" if self.hinge_deviation is None else f" +- {self.hinge_deviation[index]:.2g}"
            lines.append(f"friction of hinge_{index}, N m: {torque:.4g}{off}")
        return re.sub("-(?=-)", "- ", "\n".join(lines))  # no "--" within a comment of XML


_HINGE_SOLVER = {"solreffriction": "0.0001 1", "solimpfriction": "0.999 0.999 0.001 0.5 2"}
"""Solver parameters of hinge friction in MuJoCo that stop a hinge within one step; by default it creeps at up to
0.1 rad/s."""


PAD_PLATE, PAD_FOOT, PAD_RADIUS, PAD_GAP = 1.5, 3.0, 2.0, 0.5
"""Thickness of a printed pad's plate, height of its feet over it, radius of their tips, and gap at its sides, mm."""
OVERLAP = 1e-3
"""Overlap of the cells of a pad, which become one solid, mm."""
_FLOOR = {"name": "floor", "type": "plane", "size": "1 1 0.1", "rgba": "0.75 0.75 0.75 1"}
_LIGHT = {"name": "light", "pos": "0.3 -0.3 1", "dir": "-0.3 0.3 -1"}


def to_mjcf(exported: Exported, *, inertial: bool = False, scene: bool = False) -> str:
    """Text of an MJCF file: a free body of boxes. Each further link is a body on a hinge of the one before.

    Args:
        exported: the estimate.
        inertial: one inertial for each link, and boxes without mass; else every box has its own.
        scene: True to add a floor, on which the object rests, and a light.

    Raises:
        InvalidValueError: a link without mass.
    """
    root = Element("mujoco", model=exported.name)
    root.append(ElementTree.Comment(f"\n{exported.comment}\n"))
    body, origin = SubElement(root, "worldbody"), np.zeros(3)
    if scene:
        SubElement(body, "geom", _FLOOR)
        SubElement(body, "light", _LIGHT)
    for link in exported.links:
        if not link.hinge:
            body = SubElement(body, "body", name=link.name)
            SubElement(body, "freejoint", name=link.name)
        else:
            body = SubElement(body, "body", name=link.name, pos=_row(link.origin - origin))
            turns = {"name": link.hinge, "type": "hinge", "axis": "0 0 1"}
            SubElement(body, "joint", turns | _HINGE_SOLVER, frictionloss=_row([link.hinge_friction]))
        origin = link.origin
        if inertial:
            pos, mass, full = (_row(v) for v in (link.body.center, [link.body.mass], _six(link.body.inertia)))
            SubElement(body, "inertial", pos=pos, mass=mass, fullinertia=full)
        for box in link.boxes:
            attributes = {"name": box.name, "type": "box", "pos": _row(box.center), "size": _row(box.size / 2)}
            if box.friction is not None:
                # without priority MuJoCo takes the larger friction of two geoms: a floor's 1
                attributes |= {"friction": _row([box.friction, 0.005, 0.0001]), "priority": "1"}
            SubElement(body, "geom", attributes, mass=_row([0.0 if inertial else box.mass]))
    return _text(root)


def to_urdf(exported: Exported, *, inertial: bool = False) -> str:
    """Text of a URDF file of boxes. URDF has no friction of surfaces: the file states it in its comment.

    Args:
        exported: the estimate.
        inertial: one link with one inertial for the whole; else one link per box, fixed to a root without mass. An
            object with hinges always has one link with one inertial for each of its own.

    Raises:
        InvalidValueError: a link without mass, or a block of the object's name, which would be a link of its own.
    """
    robot, links = Element("robot", name=exported.name), exported.links
    robot.append(ElementTree.Comment(f"\n{exported.comment}\n"))
    single = inertial or exported.has_hinges
    if not single and exported.name in {box.name for box in links[0].boxes}:
        raise InvalidValueError(
            "name", exported.name, "another name than a block's, or --inertial: URDF has no two alike"
        )
    for whole in links:
        root = SubElement(robot, "link", name=whole.name)
        for name, inside in _pieces(whole, single).items():
            link = root if single else SubElement(robot, "link", name=name)
            _add_inertial(link, RigidBody.of(inside))
            if not single:
                joint = SubElement(robot, "joint", name=f"{name}_fixed", type="fixed")
                SubElement(joint, "parent", link=whole.name)
                SubElement(joint, "child", link=name)
            for box in inside:
                for kind in ("visual", "collision"):
                    part = SubElement(link, kind, name=f"{box.name}_{kind}")
                    SubElement(part, "origin", xyz=_row(box.center), rpy="0 0 0")
                    SubElement(SubElement(part, "geometry"), "box", size=_row(box.size))
    for near, far in pairwise(links):
        joint = SubElement(robot, "joint", name=far.hinge, type="continuous")
        SubElement(joint, "origin", xyz=_row(far.origin - near.origin), rpy="0 0 0")
        SubElement(joint, "parent", link=near.name)
        SubElement(joint, "child", link=far.name)
        SubElement(joint, "axis", xyz="0 0 1")
        SubElement(joint, "dynamics", damping="0.0", friction=_row([far.hinge_friction]))
    return _text(robot)


def to_sdf(exported: Exported, *, inertial: bool = False) -> str:
    """Text of an SDFormat 1.9 file: a model of boxes with their friction.

    Args:
        exported: the estimate.
        inertial: one link with one inertial for the whole; else one link per box, each fixed to the first. An object
            with hinges always has one link with one inertial for each of its own.

    Raises:
        InvalidValueError: a link without mass.
    """
    sdf, links = Element("sdf", version="1.9"), exported.links
    sdf.append(ElementTree.Comment(f"\n{exported.comment}\n"))
    model = SubElement(sdf, "model", name=exported.name)
    for whole in links:
        first, *rest = pieces = _pieces(whole, inertial or exported.has_hinges)
        for name, inside in pieces.items():
            _add_sdf_link(model, name, whole.origin, inside)
        for name in rest:
            _add_sdf_joint(model, f"{name}_fixed", "fixed", first, name)
    for near, far in pairwise(links):
        joint = _add_sdf_joint(model, far.hinge, "revolute", near.name, far.name)
        axis = SubElement(joint, "axis")
        SubElement(axis, "xyz").text = "0 0 1"
        _add_texts(SubElement(axis, "limit"), lower=[-np.inf], upper=[np.inf])
        _add_texts(SubElement(axis, "dynamics"), damping=[0.0], friction=[far.hinge_friction])
    return _text(sdf)


def written(exported: Exported, format_: str, *, inertial: bool = False, scene: bool = False) -> str:
    """Text of a file in a format: mjcf, urdf, sdf or toml; a scene only as MJCF.

    Raises:
        InvalidValueError: an option that the format does not have.
    """
    if scene and format_ != "mjcf":
        raise InvalidValueError("--scene", f"--format {format_}", "mjcf: a floor and a light of MuJoCo's")
    if format_ == "mjcf":
        return to_mjcf(exported, inertial=inertial, scene=scene)
    if format_ != "toml":
        return {"urdf": to_urdf, "sdf": to_sdf}[format_](exported, inertial=inertial)
    if inertial:
        raise InvalidValueError("--inertial", "--format toml", "mjcf, urdf or sdf: heft's objects are blocks")
    return to_object_file(exported)


def to_object_file(exported: Exported) -> str:
    """Object file of heft with the estimated masses and frictions as its true ones.

    Raises:
        InvalidValueError: the object is not of equal square blocks.
    """
    shape, boxes = exported.shape, exported.boxes
    size = float(boxes[0].size[0])
    square = all(np.allclose(box.size[:2], size, rtol=1e-6) for box in boxes)
    if not (square and len(boxes) == shape.n_m):
        allowed = "an object of square blocks alike; of other parts heft needs their meshes: mjcf, urdf or sdf"
        raise InvalidValueError("--format", "toml", allowed)
    corner = np.min([box.center for box in boxes], axis=0)
    places = [Cell(*np.rint((box.center - corner)[:2] / size).astype(int).tolist()) for box in boxes]
    # a layout may begin with empty columns or rows: blocks keep their names
    (column, row), first = places[0], shape.group_names[boxes[0].group]
    shifts = product(range(MOST_ROWS), repeat=2)
    right, up = next((each for each in shifts if Cell(column + each[0], row + each[1]).name == first), (0, 0))
    places = [Cell(place.column + right, place.row + up) for place in places]
    order = sorted(range(len(boxes)), key=lambda i: (places[i].row, places[i].column))
    own = [shape.mass_group == boxes[i].group for i in order]
    blocks = {
        "layout": layout_of(places),
        "mass_kg": [boxes[i].mass for i in order],
        "friction": exported.distribution.friction.tolist(),
        "friction_group": [int(shape.friction_group[each].max()) for each in own],
        "size_m": size,
        "height_m": shape.height,
    }
    hinges = []
    if shape.chain is not None:
        of_box = shape.chain.link[[box.group for box in boxes]]
        for index, (at, torque) in enumerate(zip(shape.chain.hinges, exported.hinge_friction, strict=True)):
            link = [places[i].name for i in order if of_box[i] == index + 1]
            hinges.append({"at_m": at.tolist(), "link": link, "friction_Nm": float(torque)})
    comment = "".join(f"# {line}\n" for line in exported.comment.splitlines())
    content: dict[str, Any] = {"name": exported.name, "blocks": blocks}
    if len(shape.feet):
        under = {box.group: place.name for box, place in zip(boxes, places, strict=True)}
        of = shape.mass_group[shape.feet]
        places_of = {name: shape.particles[shape.feet[of == group]].tolist() for group, name in under.items()}
        content["feet"] = {"under_m": places_of}
    return comment + toml_text(content) + toml_lists(hinges=hinges)


def to_sidecar(exported: Exported) -> str:
    """JSON of the estimate with its uncertainties, null for unobserved and missing ones."""
    shape, whole = exported.shape, RigidBody.of(exported.boxes)
    count = shape.particles_per_group
    covariance = None if exported.covariance is None else exported.covariance * np.outer(count, count)
    content = {
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
    if shape.chain is not None:
        content |= {
            "link": shape.chain.link.tolist(),
            "hinge_at_m": shape.chain.hinges.tolist(),
            "hinge_friction_Nm": list(exported.hinge_friction),
            "hinge_friction_std_Nm": _finite(exported.hinge_deviation),
        }
    return json.dumps(content, indent=1) + "\n"


@dataclass(frozen=True)
class Pad:
    """Pad to be printed and glued under a mass group, which then stands on feet of known places."""

    cells: tuple[tuple[float, float], ...]
    """Places of the group's cells from its middle, mm, seen from below: x to the left."""
    feet: tuple[tuple[float, float], ...]
    """Places of its feet, likewise."""
    cell: float
    """Side of a cell, mm."""

    @staticmethod
    def of(shape: ObjectShape, group: int) -> Pad:
        """Pad of a group.

        Raises:
            InvalidValueError: a group without feet of known places.
        """
        feet = shape.feet[shape.mass_group[shape.feet] == group]
        if len(feet) == 0:
            raise InvalidValueError("feet", "none", f"feet of known places under {shape.group_names[group]}: [feet]")
        below = [
            sorted((-x + 0.0, y) for x, y in np.round((places - shape.middle_of(group)) * 1e3, 6).tolist())
            for places in (shape.particles[shape.cells_of(group)], shape.particles[feet])
        ]
        return Pad(tuple(below[0]), tuple(below[1]), shape.cell * 1e3)

    def mesh(self) -> trimesh.Trimesh:
        """Solid as it lies on the bed of a printer, mm: a plate with its round-tipped feet up.

        The plate is `PAD_GAP` smaller than the outline of the group on each side.
        """
        cells, parts = np.array(self.cells), []
        for cell in cells:
            ends = []
            for way in ([-1, 0], [1, 0], [0, -1], [0, 1]):
                beside = np.linalg.norm(cells - cell - self.cell * np.array(way), axis=1).min() < 0.1 * self.cell
                ends.append(self.cell / 2 - (-OVERLAP if beside else PAD_GAP))
            low, high = np.array([ends[0], ends[2]]), np.array([ends[1], ends[3]])
            box = trimesh.creation.box((*(low + high), PAD_PLATE))
            parts.append(box.apply_translation([*(cell + (high - low) / 2), PAD_PLATE / 2]))
        for x, y in self.feet:
            top = PAD_PLATE + PAD_FOOT - PAD_RADIUS
            stem = trimesh.creation.cylinder(PAD_RADIUS, top, sections=32).apply_translation([x, y, top / 2])
            parts += [stem, trimesh.creation.uv_sphere(PAD_RADIUS, (32, 32)).apply_translation([x, y, top])]
        return trimesh.boolean.union(parts)


def _pieces(link: Link, single: bool) -> dict[str, list[Box]]:
    """Boxes of a link by piece: one piece, or one per box with mass; boxes without mass belong to the first."""
    if single:
        return {link.name: list(link.boxes)}
    pieces = {box.name: [box] for box in link.boxes if box.mass > 0}
    next(iter(pieces.values())).extend(box for box in link.boxes if box.mass == 0)
    return pieces


def _add_inertial(link: Element, body: RigidBody) -> None:
    part = SubElement(link, "inertial")
    SubElement(part, "origin", xyz=_row(body.center), rpy="0 0 0")
    SubElement(part, "mass", value=_row([body.mass]))
    SubElement(part, "inertia", {n: _row([v]) for n, v in zip(_SIX, _six(body.inertia), strict=True)})


def _add_sdf_link(model: Element, name: str, origin: np.ndarray, boxes: Sequence[Box]) -> None:
    link, body = SubElement(model, "link", name=name), RigidBody.of(boxes)
    if origin.any():
        _add_texts(link, pose=[*origin, 0, 0, 0])
    part = SubElement(link, "inertial")
    _add_texts(part, pose=[*body.center, 0, 0, 0], mass=[body.mass])
    _add_texts(SubElement(part, "inertia"), **{n: [v] for n, v in zip(_SIX, _six(body.inertia), strict=True)})
    for box in boxes:
        for kind in ("visual", "collision"):
            part = SubElement(link, kind, name=f"{box.name}_{kind}")
            _add_texts(part, pose=[*box.center, 0, 0, 0])
            _add_texts(SubElement(SubElement(part, "geometry"), "box"), size=box.size)
            if kind == "collision" and box.friction is not None:
                friction = SubElement(SubElement(part, "surface"), "friction")
                _add_texts(SubElement(friction, "ode"), mu=[box.friction], mu2=[box.friction])


def _add_sdf_joint(model: Element, name: str, kind: str, parent: str, child: str) -> Element:
    joint = SubElement(model, "joint", name=name, type=kind)
    SubElement(joint, "parent").text, SubElement(joint, "child").text = parent, child
    return joint


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
