"""The examples of the documentation run, and say what they say they do."""

import re
import runpy
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[3] / "docs" / "examples"


@pytest.fixture
def example(tmp_path, monkeypatch, capsys):
    """Runs an example as a script in a folder of its own; what it prints."""
    monkeypatch.chdir(tmp_path)

    def run(name: str, *arguments: str) -> str:
        monkeypatch.setattr(sys, "argv", [name, *arguments])
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
        return capsys.readouterr().out

    return run


def test_every_example_has_its_test():
    assert {path.name for path in EXAMPLES.glob("*.py")} == {
        "first_trial.py",
        "own_estimator.py",
        "own_log.py",
        "own_mesh.py",
        "own_policy.py",
        "own_simulator.py",
        "push.py",
        "read_a_sweep.py",
    }
    assert [path.name for path in EXAMPLES.glob("*.ipynb")] == ["rerun_inline.ipynb"]


def nad(printed: str) -> float:
    """Last NAD in a text, in %."""
    return float(printed.rsplit("NAD ", 1)[1].split(maxsplit=1)[0])


def test_own_estimator(example):
    assert nad(example("own_estimator.py")) < 5


@pytest.mark.slow
def test_first_trial(example):
    there, back = example("first_trial.py").splitlines()
    assert there.startswith("+0.17")
    assert back.startswith("-0.17")


@pytest.mark.slow
def test_own_mesh(example):
    printed = example("own_mesh.py")
    assert "status ok" in printed
    assert nad(printed) < 5


@pytest.mark.slow
def test_push(example):
    status, *blocks = example("push.py").splitlines()
    assert status == "20 pushes: ok" and len(blocks) == 6
    off = [abs(float(line.split()[1]) - float(line.split()[-2])) for line in blocks]
    assert sum(off) < 0.1 * 1.4


@pytest.mark.slow
def test_own_log_and_how_its_results_are_read(example):
    printed = example("own_log.py")
    assert "4 trials of L2 in results/lab, all usable" in printed
    row = re.search(r"^ *hidden_states +([\d.]+)", printed, re.MULTILINE)
    assert row is not None and float(row[1]) < 5
    read = example("read_a_sweep.py", "results/lab")
    assert "worst: L2 by" in read
    assert read.count("least_squares") >= 2


@pytest.mark.slow
def test_the_notebook_shows_viewers_inline():
    nbformat = pytest.importorskip("nbformat", reason="needs the extra notebook")
    nbclient = pytest.importorskip("nbclient", reason="needs the extra notebook")
    for package in ("ipykernel", "rerun_notebook"):
        pytest.importorskip(package, reason="needs the extra notebook")
    notebook = nbformat.read(EXAMPLES / "rerun_inline.ipynb", as_version=4)
    assert not any(cell.get("outputs") for cell in notebook.cells), "it is kept without outputs"
    nbclient.NotebookClient(notebook, timeout=300, kernel_name="python3").execute()
    outputs = {cell["id"]: cell["outputs"] for cell in notebook.cells if cell["cell_type"] == "code"}
    assert outputs["run"][0]["data"]["text/plain"] == "['ok', 'ok', 'ok']"
    assert nad("".join(output.get("text", "") for output in outputs["estimate"])) < 5
    widget = "application/vnd.jupyter.widget-view+json"
    state = notebook["metadata"]["widgets"]["application/vnd.jupyter.widget-state+json"]["state"]
    for cell in ("trial", "shown"):
        shown = next(output["data"][widget]["model_id"] for output in outputs[cell] if widget in output.get("data", {}))
        inside = [state[child.removeprefix("IPY_MODEL_")] for child in state[shown]["state"]["children"]]
        viewer = next(model for model in inside if model["model_module"] == "anywidget")
        assert "app.rerun.io" not in viewer["state"]["_esm"][:200], "the viewer comes from its package"
        assert viewer["state"]["_height"] == 640
