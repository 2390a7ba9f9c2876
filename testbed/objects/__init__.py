"""Objects: blocks and meshes as particles, from files or drawn at random, and their export."""
