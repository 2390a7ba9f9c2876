"""Where heft's own data files are, installed or in a checkout, and how names and paths are told apart."""

from __future__ import annotations

import difflib
from pathlib import Path

from testbed.errors import InvalidValueError


def asset_folder(kind: str) -> Path:
    """Folder of assets of one kind: "mjcf" or "objects"."""
    package = Path(__file__).parent
    for root in (package / "assets", package.parent / "assets"):
        if (root / kind).is_dir():
            return root / kind
    raise FileNotFoundError(f"heft's assets/{kind} is neither in {package} nor beside it: reinstall heft")


def find_file(name_or_path: str | Path, library: Path, what: str) -> Path:
    """A library name ("L2") or a path to a TOML file, as a path.

    Raises:
        InvalidValueError: no such name and no such file; the message lists the names and the nearest one.
    """
    text = str(name_or_path)
    if text.endswith(".toml") or "/" in text:
        path = Path(text)
        if not path.is_file():
            raise InvalidValueError(what, text, "a path to an existing .toml file")
        return path
    path = library / f"{text}.toml"
    if path.is_file():
        return path
    names = library_names(library)
    folded = {name.casefold(): name for name in names}
    nearest = difflib.get_close_matches(text.casefold(), folded, n=1, cutoff=0.4)
    hint = f" (nearest: {folded[nearest[0]]})" if nearest else ""
    raise InvalidValueError(what, text, f"one of {', '.join(names)}{hint}, or a path to a .toml file")


def library_names(library: Path) -> list[str]:
    """Names that a library folder offers, sorted."""
    return sorted(path.stem for path in library.glob("*.toml"))
