"""Actions: what is done with the object, and the path of the tool that does it."""
