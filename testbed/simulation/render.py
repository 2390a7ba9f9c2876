"""Pictures of a recorded trial, drawn by MuJoCo without a display."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from copy import copy

import mujoco
import numpy as np
from jaxtyping import UInt8

from testbed.simulation.graphics import offscreen_renderer
from testbed.simulation.playback import Playback
from testbed.simulation.views import VIEWS, ViewName, camera, hide

MOST_LOOKS = 40
"""Samples of a motion at which the camera makes sure that everything is in the picture."""


@contextmanager
def drawing(
    playback: Playback, view: ViewName, width: int, height: int
) -> Iterator[Callable[[int], UInt8[np.ndarray, "H W 3"]]]:
    """What draws a record at a sample; its camera stands still and has the whole record's motion in the picture.

    Args:
        playback: the record on its bench.
        view: a name in `VIEWS`.
        width: px.
        height: px.

    Raises:
        NoGraphicsError: the machine cannot draw without a display.
    """
    model, data, chosen = copy(playback.model), playback.data, VIEWS[view]
    hide(model, chosen)
    shown = mujoco.MjvOption()
    shown.sitegroup[:] = 0
    looks = np.unique(np.linspace(0, len(playback.trajectory.time_s) - 1, MOST_LOOKS).astype(int))
    eye = camera(model, data, chosen, width / height, playback.show, looks.tolist())
    with offscreen_renderer(model, width, height) as renderer:

        def draw(sample: int) -> UInt8[np.ndarray, "H W 3"]:
            playback.show(sample)
            renderer.update_scene(data, eye, shown)
            return renderer.render()

        yield draw
