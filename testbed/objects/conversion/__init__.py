"""From a mesh as it comes to an object: read and mended, laid on the table, cut into parts, with grasps proposed."""
