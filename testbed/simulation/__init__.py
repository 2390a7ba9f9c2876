"""The bench in MuJoCo; the only room that imports it."""
