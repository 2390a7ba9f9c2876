"""Colors of mass groups: told apart by everybody, and the same in the simulation and in the recordings."""

import numpy as np
import pytest
from matplotlib.colors import to_rgba

from testbed.objects.colors import GROUP_COLORS, group_color, group_rgba
from testbed.objects.files import load_object
from testbed.simulation.scene import build_scene
from testbed.simulation.settings import SimulationSettings
from testbed.trial import OWN_WEIGHT

SEEN_BY = {
    "all cones": np.eye(3),
    "no red cones": [[0.152, 1.053, -0.205], [0.115, 0.786, 0.099], [-0.004, -0.048, 1.052]],
    "no green cones": [[0.367, 0.861, -0.228], [0.280, 0.673, 0.047], [-0.012, 0.043, 0.969]],
    "no blue cones": [[1.256, -0.077, -0.179], [-0.078, 0.931, 0.148], [0.005, 0.691, 0.304]],
}
"""Linear RGB as it looks to eyes without a kind of cone (Machado 2009)."""
LEAST = 0.08
"""Least distance in OKLab at which two patches are told apart with ease; from black to white it is 1."""


def oklab(linear: np.ndarray) -> np.ndarray:
    """OKLab coordinates of linear RGB colors, (N, 3)."""
    cones = np.array([[0.4122, 0.5363, 0.0514], [0.2119, 0.6807, 0.1074], [0.0883, 0.2817, 0.6300]])
    parts = np.array([[0.2105, 0.7936, -0.0041], [1.9780, -2.4286, 0.4506], [0.0259, 0.7828, -0.8087]])
    return np.cbrt(linear @ cones.T) @ parts.T


@pytest.mark.parametrize("eyes", SEEN_BY)
def test_twelve_groups_are_told_apart(eyes: str):
    rgb = np.array([group_rgba(group)[:3] for group in range(12)])
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    seen = oklab(np.clip(linear @ np.array(SEEN_BY[eyes]).T, 0, 1))
    apart = np.linalg.norm(seen[:, None] - seen[None], axis=-1)
    assert apart[np.triu_indices(12, 1)].min() > LEAST


def test_a_colour_is_the_same_in_both_spellings_and_comes_again():
    assert group_rgba(4) == pytest.approx(to_rgba(group_color(4)))
    assert group_color(len(GROUP_COLORS)) == group_color(0)


@pytest.mark.parametrize("name", ["L2", "F2", "wrench"])
def test_every_group_of_an_object_has_its_colour_in_the_scene(name: str):
    obj = load_object(name)
    model = build_scene(obj, OWN_WEIGHT, None, SimulationSettings()).model
    looks: dict[int, list[np.ndarray]] = {}
    for geom in range(model.ngeom):
        part, _, number = model.geom(geom).name.partition("_")
        if part in ("cell", "solid"):
            group = int(obj.shape.mass_group[int(number)]) if part == "cell" else int(number)
            looks.setdefault(group, []).append(model.geom_rgba[geom])
    assert sorted(looks) == list(range(obj.shape.n_m))
    for group, found in looks.items():
        np.testing.assert_allclose(np.unique(found, axis=0), [group_rgba(group)], atol=1e-6)
