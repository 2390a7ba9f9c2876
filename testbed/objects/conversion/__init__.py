"""From a mesh as it comes to an object: read and mended, laid on the table, cut into parts, with grasps proposed."""

from typing import TYPE_CHECKING

from testbed.packages import lazy_names

if TYPE_CHECKING:
    from testbed.objects.conversion.convert import Converted, convert_mesh, write_object


__all__ = ["Converted", "convert_mesh", "write_object"]

__getattr__, __dir__ = lazy_names(__name__)
