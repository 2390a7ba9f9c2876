"""Meshes of boxes."""

import trimesh


def box(
    size: tuple[float, float, float], middle: tuple[float, float, float], color: list[int] | None = None
) -> trimesh.Trimesh:
    """Box of a size about its middle [m], in one RGBA color, 0 to 255, if any."""
    made = trimesh.creation.box(size)
    if color is not None:
        made.visual = trimesh.visual.ColorVisuals(made, face_colors=color)
    return made.apply_translation(middle)


def together(*meshes: trimesh.Trimesh) -> trimesh.Trimesh:
    """Several bodies as one mesh."""
    made = trimesh.util.concatenate(list(meshes))
    assert isinstance(made, trimesh.Trimesh)
    return made
