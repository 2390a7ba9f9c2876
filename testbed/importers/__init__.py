"""Import of logs from other robots, tables, MCAP or ROS 2 bags, by a mapping of their columns and units."""
