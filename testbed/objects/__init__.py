"""Objects: blocks and meshes as particles, from files or drawn at random, and their export.

The names below load their module on first use: meshes are slow to import.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from testbed.objects.blocks import block_object, parse_layout
    from testbed.objects.export import Exported, to_mjcf, to_object_file, to_urdf
    from testbed.objects.files import ObjectFile, load_object, object_names
    from testbed.objects.meshes import mesh_object, read_mesh
    from testbed.objects.model import Grasp, MassDistribution, ObjectModel, ObjectShape, Solid
    from testbed.objects.random import Family

_MODULES = {
    "blocks": ("block_object", "parse_layout"),
    "export": ("Exported", "to_mjcf", "to_object_file", "to_urdf"),
    "files": ("ObjectFile", "load_object", "object_names"),
    "meshes": ("mesh_object", "read_mesh"),
    "model": ("Grasp", "MassDistribution", "ObjectModel", "ObjectShape", "Solid"),
    "random": ("Family",),
}
_MODULE_OF = {name: f"{__name__}.{module}" for module, names in _MODULES.items() for name in names}

__all__ = [
    "Exported",
    "Family",
    "Grasp",
    "MassDistribution",
    "ObjectFile",
    "ObjectModel",
    "ObjectShape",
    "Solid",
    "block_object",
    "load_object",
    "mesh_object",
    "object_names",
    "parse_layout",
    "read_mesh",
    "to_mjcf",
    "to_object_file",
    "to_urdf",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_MODULE_OF[name]), name)
