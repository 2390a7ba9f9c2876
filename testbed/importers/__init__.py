"""Import of logs from other robots, tables, MCAP or ROS 2 bags, by a mapping of their columns and units."""

from testbed.importers.importer import import_trajectory
from testbed.importers.logs import LogError
from testbed.importers.mapping import Mapping

__all__ = ["LogError", "Mapping", "import_trajectory"]
