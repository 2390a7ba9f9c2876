"""An object in Rerun, in its pose on the table: parts, points of contact, grasps and center of mass."""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from testbed.frames import rotation_2d
from testbed.objects.colors import group_color
from testbed.objects.model import Grasp, ObjectModel
from viz.recordings.page import ITERATION, Node, Page, log_facts
from viz.style import rgb

PAD = np.array([0.007, 0.022, 0.022])
"""Sides of a pad's box [m]: along the closing direction, across, and up."""


def object_page(model: ObjectModel) -> Page:
    """Page of an object, for approval before any trial."""

    def log(stream: rr.RecordingStream) -> None:
        node = Node(stream, "object")
        _log_parts(node, model)
        shape = model.shape
        if len(feet := np.flatnonzero(shape.friction_group >= 0)):
            on_table = np.column_stack([shape.particles[feet], np.zeros(len(feet))])
            (node / "contacts").log(rr.Points3D(on_table, colors=[[250, 250, 250]], radii=0.003))
        if shape.chain is not None:
            tops = np.insert(shape.chain.hinges, 2, shape.height, axis=1)
            names = [f"hinge {hinge}" for hinge in range(len(tops))]
            (node / "hinges").log(rr.Points3D(tops, colors=[[0, 0, 0]], radii=0.003, labels=names, show_labels=True))
        for grasp in shape.grasps:
            _log_grasp(node / f"grasps/{grasp.name}", grasp)
        facts = {"mass groups": ", ".join(shape.group_names), "points of contact": str(len(feet))}
        facts["grasps"] = ", ".join(grasp.name for grasp in shape.grasps) or "none"
        if model.masses_known:
            (node / "center_of_mass").log(
                rr.Points3D([[*model.center_of_mass, shape.height / 2]], colors=[[200, 0, 0]], radii=0.004)
            )
            facts["mass"] = f"{model.total_mass:.3f} kg"
        log_facts(node / "facts", model.name, "object", facts)

    layout = rrb.Horizontal(
        rrb.Spatial3DView(origin="object", name="on the table: parts, points of contact, pads"),
        rrb.TextDocumentView(origin="object/facts", name="object"),
        column_shares=[3, 1],
        name=model.name,
    )
    return Page(model.name, f"object {model.name}", log, layout, ITERATION)


def _log_parts(node: Node, model: ObjectModel) -> None:
    shape = model.shape
    for group, name in enumerate(shape.group_names):
        place, color = node / f"parts/{name}", rgb(group_color(group))
        if model.solids:
            solid = model.solids[group]
            corners = solid.vertices[solid.faces]
            normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
            triangles = np.arange(3 * len(corners)).reshape(-1, 3)  # no shared corners: flat shading
            place.log(
                rr.Mesh3D(
                    vertex_positions=corners.reshape(-1, 3),
                    triangle_indices=triangles,
                    vertex_normals=np.repeat(normals, 3, axis=0),
                    albedo_factor=color,
                )
            )
            continue
        own = shape.particles[shape.cells_of(group)]
        centers = np.column_stack([own, np.full(len(own), shape.height / 2)])
        half = np.array([shape.cell, shape.cell, shape.height]) / 2
        place.log(rr.Boxes3D(centers=centers, half_sizes=half, colors=[color], fill_mode="solid"))


def _log_grasp(node: Node, grasp: Grasp) -> None:
    """Log the two pads of a grasp, outside the faces that they press."""
    closing = rotation_2d(grasp.angle)[:, 0]
    top = grasp.bottom + PAD[2] if grasp.top is None else grasp.top
    height = (max(grasp.bottom, 0.0) + top) / 2
    centers = [[*(grasp.position + side * (grasp.width + PAD[0]) / 2 * closing), height] for side in (-1, 1)]
    turn = rr.Quaternion(xyzw=[0, 0, np.sin(grasp.angle / 2), np.cos(grasp.angle / 2)])
    node.log(
        rr.Boxes3D(
            centers=centers,
            half_sizes=PAD / 2,
            quaternions=[turn, turn],
            colors=[[230, 130, 80]],
            labels=[grasp.name],
            show_labels=True,
        )
    )
