"""The bench in MuJoCo; the only package that imports it."""
