"""Figures as SVG inside HTML: no namespaces, no metadata, identifiers that do not clash, a title for screen readers."""

from __future__ import annotations

import io
import re
import warnings
from xml.etree import ElementTree

import matplotlib as mpl
from markupsafe import Markup
from matplotlib.figure import Figure

from viz.style import STYLE

_REFERENCE = re.compile(r"(?:url\(#|^#)([^)]+)")
_CONTROL = re.compile(rb"[\x00-\x08\x0b\x0c\x0e-\x1f]")
"""Characters that XML cannot hold."""
_DROPPED = ("metadata", "style")


def inline_svg(figure: Figure, title: str, prefix: str) -> Markup:
    """A figure as an <svg> element.

    Args:
        figure: matplotlib's figure.
        title: its alternative text.
        prefix: of its identifiers; one of its own for each figure of a page.
    """
    file = io.BytesIO()
    with mpl.rc_context(STYLE), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing")  # the reader's own fonts draw the text
        figure.savefig(file, format="svg", dpi=130, transparent=True)
    root = ElementTree.fromstring(_CONTROL.sub(b"", file.getvalue()))
    _forget_namespaces(root)
    used = {name for e in root.iter() for value in e.attrib.values() for name in _REFERENCE.findall(value)}
    for element in root.iter():
        for key, value in list(element.attrib.items()):
            if key == "id":
                del element.attrib[key]
                if value in used:
                    element.set("id", f"{prefix}-{value}")
            elif _REFERENCE.search(value) and key in ("href", "clip-path", "style", "fill", "stroke"):
                element.set(key, _REFERENCE.sub(lambda m: m.group(0).replace("#", f"#{prefix}-"), value))
    for key in ("width", "height", "version"):
        root.attrib.pop(key, None)
    root.set("role", "img")
    root.set("aria-label", title)
    return Markup(ElementTree.tostring(root, encoding="unicode"))  # ElementTree has escaped every text


def _forget_namespaces(root: ElementTree.Element) -> None:
    """Drop namespaces: HTML knows svg and href by their bare names."""
    for parent in list(root.iter()):
        for child in list(parent):
            if child.tag.split("}")[-1] in _DROPPED:
                parent.remove(child)
    for element in root.iter():
        element.tag = element.tag.split("}")[-1]
        for key in list(element.attrib):
            if "}" in key:
                element.set(key.split("}")[-1], element.attrib.pop(key))
