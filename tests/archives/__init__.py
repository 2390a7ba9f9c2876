"""Golden folders of every stored format, one a version; `make` writes that of the present one."""
