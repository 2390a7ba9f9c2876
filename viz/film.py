"""Films: pictures as an MP4 or a GIF, or the last one as a PNG, written whole or not at all."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from itertools import chain
from pathlib import Path

import av
import numpy as np
from jaxtyping import UInt8
from PIL import Image, ImageDraw, ImageFont

from testbed.errors import InvalidValueError
from testbed.files import write_whole

KINDS = (".mp4", ".gif", ".png")
MOST_PIXELS = 3840
"""Largest side of a picture [pixels]."""
MOST_FPS = 120.0
_QUALITY = 20
"""x264's constant rate factor: 18 looks lossless, 23 is its default."""

Picture = UInt8[np.ndarray, "H W 3"]


def check_film(path: Path, width: int, height: int, fps: float) -> None:
    """Check a film's settings before anything is drawn.

    Raises:
        InvalidValueError: an unknown kind of file, or a size or rate outside its limits.
    """
    if path.suffix.lower() not in KINDS:
        raise InvalidValueError("--out", str(path), f"a file name that ends in {', '.join(KINDS)}")
    for name, side in (("--width", width), ("--height", height)):
        if not 16 <= side <= MOST_PIXELS or side % 2:
            raise InvalidValueError(name, side, f"an even number of pixels from 16 to {MOST_PIXELS}")
    if not 1 <= fps <= MOST_FPS:
        raise InvalidValueError("--fps", fps, f"pictures a second, from 1 to {MOST_FPS:g}")


def write_film(pictures: Iterable[Picture], path: Path, fps: float) -> None:
    """Write pictures of one size in the format of the file's suffix; a PNG holds the last one.

    Args:
        pictures: iterable, consumed one by one.
        path: file.
        fps: pictures per second; a GIF rounds their times to 10 ms.

    Raises:
        InvalidValueError: no pictures.
    """
    write, rest = {".mp4": _write_mp4, ".gif": _write_gif, ".png": _write_png}[path.suffix.lower()], iter(pictures)
    if (first := next(rest, None)) is None:
        raise InvalidValueError("pictures", "none", "at least one picture")
    write_whole(path, lambda part: write(chain([first], rest), part, fps))


def captioned(picture: Picture, text: str) -> Picture:
    """The picture with a line of text in its lower left corner."""
    image = Image.fromarray(picture)
    size = max(image.height // 28, 10)
    draw = ImageDraw.Draw(image)
    place = (size, image.height - size)
    draw.text(place, text, fill=(40, 44, 52), font=ImageFont.load_default(size), anchor="ls")
    return np.asarray(image)


def _write_mp4(pictures: Iterable[Picture], part: Path, fps: float) -> None:
    """Write H.264 with 4:2:0 colors and the index in front, which every browser plays."""
    with av.open(str(part), "w", format="mp4", options={"movflags": "+faststart"}) as container:
        stream = container.add_stream("libx264", rate=Fraction(fps).limit_denominator(1000))
        stream.pix_fmt, stream.options = "yuv420p", {"crf": str(_QUALITY)}
        for count, picture in enumerate(pictures):
            if count == 0:
                stream.height, stream.width = picture.shape[:2]
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode(None))


def _write_gif(pictures: Iterable[Picture], part: Path, fps: float) -> None:
    """Write all pictures with the palette of the first, so that still parts do not flicker."""
    images = map(Image.fromarray, pictures)
    start = next(images)
    palette = start.quantize(255, method=Image.Quantize.MEDIANCUT)
    first, *rest = (image.quantize(palette=palette, dither=Image.Dither.NONE) for image in chain([start], images))
    ends = np.round(np.arange(len(rest) + 2) * 100 / fps).astype(int) * 10  # ms, on a GIF's clock
    durations = np.diff(ends).tolist()
    first.save(part, format="gif", save_all=True, append_images=rest, duration=durations, loop=0, optimize=False)


def _write_png(pictures: Iterable[Picture], part: Path, _: float) -> None:
    *_rest, last = pictures
    Image.fromarray(last).save(part, format="png", optimize=True)
