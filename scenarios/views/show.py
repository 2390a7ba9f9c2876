"""`heft.show`: an object, a trajectory, estimates or a results folder in Rerun."""

from __future__ import annotations

import os
import sys
import tempfile
import time
import webbrowser
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from threading import Event

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from estimators.base import Estimate
from scenarios.results.trials import pads_of
from scenarios.views.pages import page_of, page_of_trial
from scenarios.views.values import view_of
from testbed.errors import InvalidValueError
from testbed.objects.model import MassDistribution, ObjectModel, ObjectShape
from testbed.trajectory import Trajectory
from viz.recordings import viewer
from viz.recordings.comparison import comparison_blueprint, log_comparison
from viz.recordings.estimate import estimate_blueprint, log_estimate
from viz.recordings.page import APPLICATION, ITERATION, Page, save, send
from viz.recordings.solid import object_page
from viz.values import EstimateView

HEIGHT = 640
"""Height of a viewer in a notebook [pixels]."""


def show(
    what: ObjectModel | Trajectory | Estimate | Mapping[str, Estimate] | Path | str,
    obj: ObjectModel | ObjectShape | None = None,
    *,
    answer: Estimate | None = None,
    web: bool = False,
    file: Path | str | None = None,
) -> None:
    """Show something in Rerun: inline in a notebook, else in the viewer's window.

    An open window takes further pages; the call does not wait for it. `web` serves a browser until Ctrl-C.

    Args:
        what: an object, a trajectory, an estimate, estimates of one object by the names of their methods, or the folder
            of a run.
        obj: object of a trajectory or of estimates; with its masses, where they are known.
        answer: estimate from which the wrench of a trajectory is predicted; the true masses if left out.
        web: serve the viewer to a browser on this machine.
        file: .rrd file to be written, in place of any viewer.

    Raises:
        InvalidValueError: something that cannot be shown, no object beside it, or a file of another kind.
        ViewerError: no notebook, no display and neither `web` nor `file`.
    """
    if file is not None and Path(file).suffix != ".rrd":
        raise InvalidValueError("file", str(file), "a recording's name: FILE.rrd")
    page = _page(what, obj, answer)
    if file is not None:
        save(page, Path(file))
    elif web:
        with tempfile.TemporaryDirectory(prefix="heft-") as place:
            save(page, Path(place) / "page.rrd")
            serve(Path(place) / "page.rrd")
    elif _in_notebook():
        _inline(page)
    else:
        if not (viewer.listens() or viewer.has_display()):
            raise viewer.ViewerError("no display: web=True serves the viewer to a browser, file= writes a recording")
        send(page, viewer.open_viewer())


def serve(recording: Path, port: int = 0) -> None:
    """Serve a recording to a browser until Ctrl-C; port 0 is a free one."""
    with viewer.served(recording, port) as address:
        print(f"viewer: {address}\nCtrl-C ends it", flush=True)
        if viewer.has_display():
            webbrowser.open(address)
        with suppress(KeyboardInterrupt):
            Event().wait()


def _page(what: object, obj: ObjectModel | ObjectShape | None, answer: Estimate | None) -> Page:
    """Page of an object, a trajectory, estimates or a results folder."""
    if isinstance(what, ObjectModel):
        return object_page(what)
    if isinstance(what, str | Path):
        if not Path(what).is_dir():
            allowed = "a results folder; heft.load_object has an object by its name"
            raise InvalidValueError("what", str(what), allowed)
        return page_of(Path(what), None)
    if isinstance(what, Trajectory):
        return _trial_page(what, _model(what, obj), answer)
    if isinstance(what, Estimate):
        shown = _view(what, _model(what, obj), "estimate")
        layout = estimate_blueprint("estimate", shown)
        return Page(
            shown.title, _identity(what), lambda stream: log_estimate(stream, "estimate", shown), layout, ITERATION
        )
    if isinstance(what, Mapping) and what and all(isinstance(each, Estimate) for each in what.values()):
        model = _model(what, obj)
        views = [_view(each, model, str(name)) for name, each in what.items()]
        layout = rrb.Vertical(comparison_blueprint("comparison", views))
        return Page(
            model.name, _identity(what), lambda stream: log_comparison(stream, "comparison", views), layout, ITERATION
        )
    allowed = "an ObjectModel, a Trajectory, an Estimate, a dict of Estimates by method, or the folder of a run"
    raise InvalidValueError("what", type(what).__name__, allowed)


def _identity(what: object) -> str:
    """Identifier that is unique in time and over processes."""
    return f"{type(what).__name__} {os.getpid()}-{time.time_ns()}"


def _model(what: object, obj: ObjectModel | ObjectShape | None) -> ObjectModel:
    """Model of an object; with unknown masses for a shape."""
    if isinstance(obj, ObjectModel):
        return obj
    if isinstance(obj, ObjectShape):
        placeholder = MassDistribution(np.ones(obj.n_m), np.ones(obj.n_mu))
        return ObjectModel("object", obj, placeholder, masses_known=False)
    raise InvalidValueError("obj", type(obj).__name__, f"the ObjectModel or ObjectShape of this {type(what).__name__}")


def _trial_page(trajectory: Trajectory, obj: ObjectModel, answer: Estimate | None) -> Page:
    """Page of a trajectory, with the wrench predicted from an answer, else from a simulated object's true masses."""
    grasp, known = trajectory.action.grasp, len(obj.shape.grasps)
    if grasp is not None and grasp >= known:
        allowed = f"the object of this trajectory, of grasp {grasp}: this one has {known}"
        raise InvalidValueError("obj", obj.name, allowed)
    masses, name = (obj.truth, "the true masses") if trajectory.simulated and obj.masses_known else (None, "")
    if answer is not None:
        masses, name = answer.distribution, "the estimate"
    pads = pads_of(obj.shape, trajectory.action)
    return page_of_trial(view_of(obj, trajectory, pads, obj.shape, masses, name, {}), _identity(trajectory))


def _view(answer: Estimate, obj: ObjectModel, method: str) -> EstimateView:
    """View of an estimate, with the true masses where they are known."""
    return EstimateView(
        title=f"{obj.name}: {method}",
        shape=obj.shape,
        truth=obj.truth if obj.masses_known else None,
        answer=answer.distribution,
        covariance=answer.covariance,
        traces=answer.traces,
        facts={
            "method": method,
            "object": obj.name,
            "status": answer.status,
            "why": answer.message,
            "assumed, not tested": answer.assumes,
            "computing": f"{answer.seconds:.2g} s",
        },
    )


def _in_notebook() -> bool:
    ipython = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    return hasattr(shell, "kernel")


def _inline(page: Page) -> None:
    """Show a page as the output of a notebook's cell; the viewer is loaded from its package, not from the network."""
    os.environ.setdefault("RERUN_NOTEBOOK_ASSET", "inline")
    from rerun.notebook import Viewer  # noqa: PLC0415  the module reads the variable on import

    stream = rr.RecordingStream(APPLICATION, recording_id=page.identity)
    inline = Viewer(width="auto", height=HEIGHT, recording=stream, blueprint=page.blueprint)
    page.log(stream)
    inline.display()
