"""From a mesh as it comes to an object: read and mended, laid on the table, cut into parts, with grasps proposed."""

from testbed.objects.conversion.convert import Converted, convert_mesh, write_object

__all__ = ["Converted", "convert_mesh", "write_object"]
