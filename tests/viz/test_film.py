"""Films: read back as drawn, in their time."""

from pathlib import Path

import av
import numpy as np
import pytest
from numpy.testing import assert_allclose
from PIL import Image

from testbed.errors import InvalidValueError
from viz.film import KINDS, captioned, check_film, write_film

SIZE = (64, 48)
EDGES = [2 * i for i in range(20)]


def pictures(count: int) -> list[np.ndarray]:
    """A white square that moves right by 2 px a picture."""
    drawn = np.full((count, *SIZE[::-1], 3), 40, dtype=np.uint8)
    for i, picture in enumerate(drawn):
        picture[10:20, 2 * i : 2 * i + 10] = 255
    return list(drawn)


def left_edge(picture: np.ndarray) -> int:
    return int((picture[15, :, 0] > 150).argmax())


def test_an_mp4_reads_back(tmp_path):
    write_film(pictures(20), tmp_path / "film.mp4", 12.5)
    with av.open(tmp_path / "film.mp4") as film:
        stream = film.streams.video[0]
        assert (stream.codec_context.name, stream.codec_context.pix_fmt) == ("h264", "yuv420p")
        assert (stream.width, stream.height, stream.average_rate) == (*SIZE, 12.5)
        assert stream.duration is not None and stream.time_base is not None
        assert_allclose(float(stream.duration * stream.time_base), 20 / 12.5)
        assert [left_edge(frame.to_ndarray(format="rgb24")) for frame in film.decode(stream)] == EDGES


@pytest.mark.parametrize("fps", [12.5, 29.97])
def test_a_gif_reads_back_and_keeps_time(tmp_path, fps):
    write_film(pictures(20), tmp_path / "film.gif", fps)
    with Image.open(tmp_path / "film.gif") as film:
        frames, total = [], 0
        for i in range(film.n_frames):  # pyright: ignore[reportAttributeAccessIssue]
            film.seek(i)
            assert film.size == SIZE
            frames.append(np.asarray(film.convert("RGB")))
            total += film.info["duration"]
            assert_allclose(total, (i + 1) * 1000 / fps, atol=5.01)
    assert [left_edge(frame) for frame in frames] == EDGES


def test_a_png_and_a_picture_of_one_colour_are_exact(tmp_path):
    drawn = pictures(3)
    write_film(drawn, tmp_path / "one.png", 25.0)
    assert np.array_equal(np.asarray(Image.open(tmp_path / "one.png")), drawn[-1])
    write_film([np.full((48, 64, 3), 200, dtype=np.uint8)] * 4, tmp_path / "film.gif", 10.0)
    with Image.open(tmp_path / "film.gif") as film:
        assert_allclose(np.asarray(film.convert("RGB")), 200, atol=4)


@pytest.mark.parametrize(
    ("name", "width", "height", "fps", "field"),
    [
        ("film.avi", 64, 48, 25.0, "--out"),
        ("film", 64, 48, 25.0, "--out"),
        ("film.mp4", 63, 48, 25.0, "--width"),
        ("film.mp4", 64, 0, 25.0, "--height"),
        ("film.mp4", 64, 100_000, 25.0, "--height"),
        ("film.mp4", 64, 48, 0.0, "--fps"),
        ("film.mp4", 64, 48, float("nan"), "--fps"),
        ("film.mp4", 64, 48, 1000.0, "--fps"),
    ],
)
def test_impossible_films_are_refused(name, width, height, fps, field):
    with pytest.raises(InvalidValueError, match=f"^{field}: got"):
        check_film(Path(name), width, height, fps)
    check_film(Path("film.GIF"), 64, 48, 25.0)


@pytest.mark.parametrize("kind", KINDS)
def test_a_film_without_pictures_is_refused(tmp_path, kind):
    with pytest.raises(InvalidValueError, match=r"^pictures: got"):
        write_film(iter([]), tmp_path / f"film{kind}", 25.0)
    assert not list(tmp_path.iterdir())


def test_a_caption_stands_in_the_lower_left_corner():
    plain = np.full((320, 480, 3), 200, dtype=np.uint8)
    rows, columns = np.nonzero((captioned(plain, "L2, rotate 0.0 s") != plain).any(axis=-1))
    assert 200 < rows.min() and rows.max() < 320 and columns.min() < 40 and columns.max() < 240
    assert plain.min() == 200
