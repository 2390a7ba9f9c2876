"""The stream's parser and clock: every whole frame is found, no other, whatever comes between and however it is cut."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

pytest.importorskip("pymodbus")
from testbed.robot.robotiq.stream import FRAME_BYTES, HEADER, FrameClock, FrameParser, checksum

COUNTS = st.lists(st.integers(-(2**15), 2**15 - 1), min_size=6, max_size=6)
GARBAGE = st.one_of(
    st.binary(max_size=40),
    st.lists(st.sampled_from([HEADER, HEADER[:1], HEADER[1:], b"\xff", b"\x00"]), max_size=30).map(b"".join),
)
"""Bytes that may look like the beginning of a frame."""


def raw_frame(counts: list[int]) -> bytes:
    data = HEADER + np.array(counts, "<i2").tobytes()
    return data + checksum(data)


def in_newtons(counts: list[int]) -> list[float]:
    return [c / (100 if i < 3 else 1000) for i, c in enumerate(counts)]


def places(stream: bytes) -> list[int]:
    """Wherever 16 bytes pass for a frame."""
    windows = [stream[i : i + FRAME_BYTES] for i in range(len(stream) - FRAME_BYTES + 1)]
    return [i for i, w in enumerate(windows) if w.startswith(HEADER) and checksum(w[:-2]) == w[-2:]]


@st.composite
def streams(draw: st.DrawFn) -> tuple[bytes, list[list[int]], list[int]]:
    """Bytes, what their frames say, and where the frames begin; nothing else in it passes for a frame."""
    said = draw(st.lists(COUNTS, max_size=6))
    stream, begins = draw(GARBAGE), []
    for counts in said:
        begins.append(len(stream))
        stream += raw_frame(counts) + draw(GARBAGE)
    assume(places(stream) == begins)  # chance is 2^-16 a header
    return stream, said, begins


@given(streams())
def test_every_frame_is_found_whatever_lies_between(drawn):
    stream, said, _ = drawn
    found = FrameParser().feed(stream)
    assert [f.wrench.tolist() for f in found] == [in_newtons(counts) for counts in said]


@pytest.mark.slow
@given(streams(), st.lists(st.integers(1, 40), min_size=1, max_size=20))
def test_how_the_bytes_are_cut_makes_no_difference(drawn, cuts):
    stream, said, _ = drawn
    whole, cut, found, at = FrameParser(), FrameParser(), [], 0
    whole.feed(stream)
    for i in range(len(stream)):
        if at >= len(stream):
            break
        step = cuts[i % len(cuts)]
        found += cut.feed(stream[at : at + step])
        at += step
    assert [f.wrench.tolist() for f in found] == [in_newtons(counts) for counts in said]
    assert (cut.crc_errors, cut.resyncs) == (whole.crc_errors, whole.resyncs)


@given(
    st.lists(COUNTS, min_size=3, max_size=5), st.integers(0, 2), st.integers(0, FRAME_BYTES - 1), st.integers(0, 255)
)
def test_a_damaged_or_lost_byte_costs_its_own_frame_alone(said, which, place, flip):
    """Lost: `flip` is 0."""
    stream, at = bytearray(b"".join(raw_frame(counts) for counts in said)), which * FRAME_BYTES + place
    if flip:
        stream[at] ^= flip
    else:
        del stream[at]
    rest = said[:which] + said[which + 1 :]
    assume(len(places(bytes(stream))) == len(rest))
    parser = FrameParser()
    assert [f.wrench.tolist() for f in parser.feed(bytes(stream))] == [in_newtons(counts) for counts in rest]
    assert not flip or parser.resyncs == (1 if which > 0 else 0)


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1))
def test_noise_alone_makes_next_to_no_frame(seed):
    noise = np.random.default_rng(seed).bytes(20_000)
    assert FrameParser().feed(noise) == []  # one in 2^32 windows: one run in 10,000 of this test


@given(COUNTS, st.binary(max_size=15).filter(lambda tail: HEADER not in tail))
def test_a_frame_knows_what_came_behind_it(counts, tail):
    (frame,) = FrameParser().feed(raw_frame(counts) + tail)
    assert frame.behind == len(tail)


def times(count: int, period: float = 0.01) -> np.ndarray:
    return np.arange(count) * period


def lost(arrivals: np.ndarray) -> int:
    clock = FrameClock()
    for t in arrivals:
        clock.arrived(float(t))
    return clock.lost


@pytest.mark.parametrize(
    ("arrivals", "missing"),
    [
        *((np.delete(times(140), slice(30, 30 + n)), n) for n in (1, 2, 7, 40)),
        (np.delete(times(1000), np.arange(25, 900, 50)), 18),
        (times(5000, 0.0098), 0),
        (times(5000, 0.0102), 0),
    ],
    ids=["1", "2", "7", "40", "here and there", "a fast sensor", "a slow sensor"],
)
def test_frames_that_never_come_are_counted(arrivals: np.ndarray, missing: int):
    assert lost(arrivals) == missing


@given(st.integers(0, 2**32 - 1))
def test_late_frames_are_not_lost(seed):
    rng = np.random.default_rng(seed)
    sent = times(400)
    kept_waiting = np.arange(0, 400, 40) + rng.integers(0, 40, 10)  # not throughout a block of frames
    arrivals = sent + rng.uniform(0, 0.004, 400)
    for i in kept_waiting:  # the reader sleeps up to 80 ms, and reads all that came meanwhile at once
        awake = sent[i] + rng.uniform(0, 0.08)
        arrivals = np.where((sent >= sent[i]) & (arrivals < awake), awake, arrivals)
    assert lost(np.maximum.accumulate(arrivals)) == 0
