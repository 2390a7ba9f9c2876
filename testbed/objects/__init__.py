"""Objects: blocks and meshes as particles, from files or drawn at random, and their export.

The names below load their module on first use: meshes are slow to import.
"""

from typing import TYPE_CHECKING

from testbed.packages import lazy_names

if TYPE_CHECKING:
    from testbed.objects.blocks import block_object, parse_layout
    from testbed.objects.export import Exported, to_mjcf, to_object_file, to_urdf
    from testbed.objects.files import ObjectFile, load_object, object_names
    from testbed.objects.meshes import mesh_object, read_mesh
    from testbed.objects.model import Grasp, MassDistribution, ObjectModel, ObjectShape, Solid
    from testbed.objects.random import Family


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

__getattr__, __dir__ = lazy_names(__name__)
