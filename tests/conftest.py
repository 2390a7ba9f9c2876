"""dm_control looks for a display on import, torch takes every core, hypothesis times its examples, and every run draws
anew, by default."""

import gc
import os
from importlib import import_module

import pytest
from hypothesis import settings

from testbed.parsing import process
from testbed.worlds import seeds

os.environ.setdefault("MUJOCO_GL", "disable")
os.environ.setdefault("OMP_NUM_THREADS", "1")
settings.register_profile("busy", deadline=None)
settings.load_profile("busy")
seeds.token_hex = lambda _: "tests"


def pytest_collection_finish():
    """Modules and tests stay: a tenth of the time went into looking for garbage among them."""
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True)
def parsers_in_this_process(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch):
    """No process for each file of a quick test; `own_process` and slow tests have them as users do."""
    if not any(request.node.get_closest_marker(name) for name in ("slow", "own_process")):
        monkeypatch.setattr(process, "parser_result", _parser_result)


def _parser_result(module: str, words: tuple[str, ...], seconds: int) -> tuple[int, str]:
    reason = process.refusal(import_module(module).main, words)
    return int(bool(reason)), reason
