"""Tests of pushes as actions, and of the faces that they meet."""

import json
import math

import numpy as np
import pytest

from testbed.actions import Push, action_from_dict
from testbed.actions.push import GAP
from testbed.errors import InvalidValueError
from testbed.objects.faces import faces
from testbed.objects.files import load_object

L2 = load_object("L2").shape


def test_faces_close_the_outline():
    every = faces(L2)
    assert sum(face.length * face.normal for face in every) == pytest.approx(0, abs=1e-12)
    # the area, by the divergence theorem, is that of all cells
    area = sum(face.length * face.normal @ (face.begin + face.end) / 4 for face in every)
    assert area == pytest.approx(len(L2.particles) * L2.cell**2)
    assert all(
        L2.mass_group[np.linalg.norm(L2.particles - (f.begin + f.end) / 2, axis=1).argmin()] == f.group for f in every
    )


def test_the_path_meets_the_point_and_bends():
    face = faces(L2)[0]
    point, inwards = (face.begin + face.end) / 2, math.atan2(-face.normal[1], -face.normal[0])
    for bend in (0.0, 3.0, -3.0):
        push = Push((float(point[0]), float(point[1])), inwards, bend, length=0.1)
        way = np.linspace(0.0, GAP + 0.1, 200)
        path = push.path(L2, way)
        assert np.linalg.norm(np.diff(path, axis=0), axis=1).sum() == pytest.approx(GAP + 0.1, rel=1e-5)
        contact = push.path(L2, np.array([GAP]))[0] - push.radius * face.normal
        assert contact == pytest.approx(point)
        ends = [np.arctan2(*np.diff(path[part], axis=0)[0][::-1]) for part in (slice(0, 2), slice(-2, None))]
        assert math.remainder(ends[1] - ends[0] - bend * 0.1, 2 * math.pi) == pytest.approx(0, abs=2e-3)
        assert push.seconds > (GAP + 0.1) / push.speed
        assert action_from_dict(json.loads(json.dumps(push.to_dict()))) == push
        assert push.grasp is None and "push at" in push.describe(L2)


@pytest.mark.parametrize("change", [{"speed": 0.3}, {"length": 0.0}, {"curvature": math.nan}, {"point": (1.0,)}])
def test_what_is_no_push_is_refused(change):
    with pytest.raises(InvalidValueError):
        Push(**{"point": (0.0, 0.0), "direction": 0.0} | change)


def test_a_push_needs_a_face_before_it():
    face = faces(L2)[0]
    x, y = ((face.begin + face.end) / 2).tolist()
    outwards = math.atan2(face.normal[1], face.normal[0])
    for push in (Push((x, y), outwards), Push((x, y), outwards + math.pi / 2), Push((9.0, 9.0), 0.0)):
        with pytest.raises(InvalidValueError):
            push.face(L2)
