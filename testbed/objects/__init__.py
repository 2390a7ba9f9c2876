"""Objects: blocks and meshes, from files or drawn at random, and their export."""
