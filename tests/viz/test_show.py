"""`heft`: its public names, and `heft.show` of every type; its refusals are among the typical mistakes."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import estimators
import heft
import scenarios
import testbed
import viz
from scenarios.views import show as module
from tests.helpers.chunks import read_chunks
from viz.recordings.viewer import ViewerError

L2 = heft.load_object("L2")
ANSWER = heft.Estimate(
    L2.truth, "ok", covariance=1e-6 * np.eye(L2.shape.n_m), diagnostics={"friction_0_std": 0.01}, seconds=0.5
)


def test_every_public_name_is_one_of_heft():
    assert sorted(heft.__all__) == sorted({*testbed.__all__, *estimators.__all__, *viz.__all__, *scenarios.__all__})
    assert all(getattr(heft, name) is not None for name in heft.__all__)
    assert {*heft.__all__} <= {*dir(heft)}
    with pytest.raises(AttributeError, match="'heft' has no attribute 'Trail'"):
        _ = heft.Trail  # pyright: ignore[reportAttributeAccessIssue]


def test_importing_heft_loads_no_library():
    code = "import sys, heft; print([name for name in ('numpy', 'torch', 'mujoco', 'rerun') if name in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"


def test_an_estimate_is_a_table_of_groups():
    table = ANSWER.table(L2.shape)
    assert list(table.index) == [*L2.shape.group_names, "friction"]
    assert np.allclose(table.value[:-1], L2.group_mass)
    assert np.allclose(table.error, [*(1e-3 * L2.shape.particles_per_group), 0.01])
    assert table.unit.tolist() == ["kg"] * L2.shape.n_m + [""]
    assert np.isnan(heft.Estimate(L2.truth, "ok").table(L2.shape).error).all()
    assert heft.Estimate(None, "no_data", "nothing moved").table(L2.shape).empty
    assert repr(heft.Estimate(None, "no_data", "no turn")) == (
        "Estimate('no_data', 'no turn', 0 groups: table(shape) lists them)"
    )


@pytest.mark.parametrize(
    ("what", "obj", "shown"),
    [
        (L2, None, "object/parts/A1"),
        (ANSWER, L2, "estimate/true_mass"),
        (ANSWER, L2.shape, "estimate/estimated_mass"),
        ({"mine": ANSWER, "other": heft.Estimate(None, "no_data")}, L2, "comparison/methods/1"),
    ],
    ids=["object", "estimate", "estimate of a shape", "comparison"],
)
def test_an_object_and_estimates_are_shown(what, obj, shown, tmp_path: Path):
    heft.show(what, obj, file=tmp_path / "x.rrd")
    assert [name for name in read_chunks(tmp_path / "x.rrd") if name.startswith(shown)]


@pytest.mark.slow
def test_a_trajectory_is_shown(turn_folder: Path, tmp_path: Path):
    trajectory = next(each for _, each in heft.load_trajectories(turn_folder) if each.action.moves)
    for obj, answer in ((L2, None), (L2.shape, None), (L2.shape, ANSWER)):
        heft.show(trajectory, obj, answer=answer, file=tmp_path / "x.rrd")
        assert any(name.startswith("trial/scene/object") for name in read_chunks(tmp_path / "x.rrd"))


def test_without_a_display_the_other_ways_are_named(monkeypatch):
    monkeypatch.setattr(module.viewer, "has_display", lambda: False)
    monkeypatch.setattr(module.viewer, "listens", lambda: False)
    with pytest.raises(ViewerError, match="web=True serves the viewer to a browser, file= writes a recording"):
        heft.show(L2)
