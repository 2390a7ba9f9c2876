"""Listings, help, `heft doctor`, the nearest names, and an end without lingering threads."""

import io
import os
import re
import shutil
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest
from rich.console import Console

from estimators.registry import METHODS
from estimators.testing.recorded import load_block
from scenarios.catalog import LIBRARY, purpose, scenario_names
from scenarios.cli.main import COMMANDS, main
from scenarios.results.estimates import load_trajectories
from scenarios.results.files import exclusive, write_json
from scenarios.results.table import write_rows
from testbed.errors import HeftError
from testbed.plugins import settings_of
from tests.fakes.lab_bench import mapping_of, strung, write_csv, write_toml
from tests.helpers.commands import ended, refusal
from tests.helpers.rows import row
from viz.report.tables import Entry, Table
from viz.report.terminal import rich_table

HEAVY = ["torch", "scipy", "pandas", "pyarrow", "mujoco", "matplotlib", "trimesh", "pydantic"]


def folder_of(path: Path, manifest: dict[str, object], trials: int = 2, estimates: int = 3) -> Path:
    """A results folder with no more than `heft status` looks at."""
    for kind, name, count in (("trials", "trial.json", trials), ("estimates", "result.json", estimates)):
        for i in range(count):
            (path / kind / str(i)).mkdir(parents=True)
            (path / kind / str(i) / name).write_text("{}")
    write_json(path / "manifest.json", manifest)
    return path


def test_what_only_looks_loads_nothing_heavy(tmp_path):
    folder = folder_of(tmp_path, {"finished": True})
    code = f"""
import re
import sys
from scenarios.cli.main import COMMANDS, main
main(["scenarios"]); main(["status", {str(folder)!r}])
print("loaded:", *sorted({{*sys.modules}} & {{*{HEAVY!r}}}))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "loaded:"


EXPECTED = {"trials": 4, "estimates": 3}


@pytest.mark.parametrize(
    ("manifest", "state", "trials"),
    [
        ({"finished": True}, "finished", "2 done, 0 failed"),
        ({"finished": False, "expected": EXPECTED}, "stopped early", "2 done of about 4, 0 failed"),
        ({"finished": False, "expected": {"trials": 1, "estimates": 1}}, "stopped early", "2 done, 0 failed"),
        ({}, "nothing is running here", "2 done, 0 failed"),  # of an earlier version
    ],
)
def test_status_says_whether_a_run_is_over(tmp_path, capsys, manifest, state, trials):
    main(["status", str(folder_of(tmp_path, manifest))])
    first, second = capsys.readouterr().out.splitlines()
    assert state in first
    assert second == f"trials: {trials}; estimates: 3 done, 0 failed"


def test_status_sees_a_run_and_writes_nothing(tmp_path, capsys):
    folder = folder_of(tmp_path, {"finished": False, "expected": EXPECTED})
    before = sorted(folder.rglob("*"))
    main(["status", str(folder)])
    assert sorted(folder.rglob("*")) == before
    with exclusive(folder):
        main(["status", str(folder)])
    assert "a run is writing here now" in capsys.readouterr().out


@pytest.mark.parametrize("width", [60, 200])
def test_every_scenario_is_described_to_the_end_of_its_sentence(capsys, monkeypatch, width):
    monkeypatch.setenv("COLUMNS", str(width))
    main(["scenarios"])
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= width
    shown = " ".join(" ".join(lines).split())
    for name in scenario_names():
        assert purpose(name).endswith(".")
        assert f"{name} {purpose(name)}" in shown
        assert LIBRARY.joinpath(f"{name}.toml").read_text(encoding="utf-8").startswith("# ")


def test_every_method_is_listed_with_its_settings(capsys, monkeypatch, install):
    install(estimators="mine = tests.fakes.misbehaving:Misbehaving, lost = no_such_module:Lost")
    monkeypatch.setenv("COLUMNS", "400")
    main(["methods"])
    lines = {line.split()[0]: line for line in capsys.readouterr().out.splitlines() if not line.startswith(" ")}
    assert [*lines] == [*METHODS, "lost", "mine"]
    assert all(len(line.split()) > 3 for name, line in lines.items() if name in METHODS)
    assert "cannot be used: methods (lost): got 'no_such_module:Lost'" in lines["lost"]


def test_settings_are_written_as_in_a_scenario():
    def kind(known, count=3, share=0.5, names=("a", "b"), flag=False, **more): ...

    assert settings_of(kind) == ["known", "count = 3", "share = 0.5", 'names = ["a", "b"]', "flag = false"]


def test_the_version_is_one_line(capsys):
    main(["--version"])
    assert capsys.readouterr().out == f"heft {version('heft-testbed')}\n"


@pytest.mark.parametrize(("words", "unbuffered"), [(["--help"], ""), (["--help"], "1"), (["run", "--help"], "1")])
def test_a_reader_that_has_read_enough_gets_no_traceback(words, unbuffered):
    """End of `heft --help | head`: code 0, and nothing on stderr."""
    program = [sys.executable, "-c", "from scenarios.cli.main import command; command()", *words]
    read, write = os.pipe()
    os.close(read)
    ended = subprocess.run(
        program, stdout=write, stderr=subprocess.PIPE, env=os.environ | {"PYTHONUNBUFFERED": unbuffered}, check=False
    )
    os.close(write)
    assert (ended.returncode, ended.stderr) == (0, b"")


@pytest.mark.parametrize("command", COMMANDS)
def test_help_shows_no_default_that_is_nothing_and_examples_on_lines_of_their_own(capsys, command):
    with pytest.raises(SystemExit, match="0"):
        main([*command.split(), "--help"])
    said = capsys.readouterr().out
    assert "None" not in said and "default: False" not in said
    assert all(line.lstrip().startswith("Example") for line in said.splitlines() if re.search(r"Examples?:", line))


@pytest.mark.parametrize("words", [[], ["robot"]])
def test_no_command_prints_the_help(capsys, words):
    with pytest.raises(SystemExit) as ended:
        main(words)
    said = capsys.readouterr()
    assert ended.value.code in (0, None)
    assert "--help" in said.out
    assert not said.err


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (HeftError("no such arm"), "heft: no such arm"),
        (ModuleNotFoundError("No module named 'av'"), "heft: this installation is incomplete: No module named 'av'; "),
        (PermissionError(13, "Permission denied", "/x"), "heft: Permission denied: /x"),
    ],
)
def test_an_error_in_a_command_as_it_is_loaded_is_one_line(capsys, monkeypatch, error, line):
    def refused(path):
        raise error

    monkeypatch.setattr("scenarios.cli.main.load", refused)
    assert refusal(capsys, "objects").startswith(line)


@pytest.mark.parametrize("width", [50, 80, 300])
def test_a_table_too_wide_for_the_terminal_goes_on_below(width):
    cells = tuple(Entry(f"{i}.00±0.01") for i in range(9))
    wide = Table("NAD", tuple(f"object_{i}" for i in range(9)), ((("hidden_states",), cells), (("other",), cells)))
    console = Console(width=width, record=True, file=io.StringIO())
    console.print(rich_table(wide))
    said = console.export_text()
    assert "…" not in said
    assert all(said.count(f"object_{i}") == 1 and said.count(f"{i}.00±0.01") == 2 for i in range(9))
    assert ("continued" in said) == (width < 300)
    assert max(map(len, said.splitlines())) <= width


def test_an_object_in_links_is_shown_with_its_hinges(capsys):
    main(["show", "folding_rule"])
    lines = [line.split() for line in capsys.readouterr().out.splitlines() if " | leg_" in line]
    assert [line[-2] for line in lines] == ["6", "4"] and ["leg_2", "|", "leg_3"] == lines[1][-6:-3]


@pytest.mark.slow
def test_doctor_prints_misfit_causes_and_trials_and_draws_them(longer, tmp_path, capsys):
    main(["doctor", str(results := shutil.copytree(longer.out, tmp_path / "out"))])
    said = " ".join(capsys.readouterr().out.split())
    assert said.count("trials that fit least") == said.count("figure: ") == 4  # two supports under two sensors
    assert "the trials agree within the errors stated" in said
    assert "rigid, ideal: misfit" in said and "as under one rigid body" in said
    assert len(list((results / "figures").glob("doctor_pair_*.png"))) == 4


def test_doctor_names_estimates_an_object_or_a_draw_that_are_not_there(tmp_path, capsys):
    assert "DIR: got " in refusal(capsys, "doctor", str(tmp_path))
    write_rows(tmp_path, [row("a", seed, 0.1) for seed in (0, 1)])
    assert "OBJECT: got 'I1'; allowed: one of L2" in refusal(capsys, "doctor", str(tmp_path), "I1")
    draws = "--draw: got 9; allowed: a draw that the folder has estimates of: 0, 1"
    assert draws in refusal(capsys, "doctor", str(tmp_path), "L2", "--draw", "9")


def test_a_recording_is_found_and_imported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "120")
    trials = load_block("L2-own_weight").trials("ft300s")[2:4]
    recording = strung(trials, 1e-5)
    write_csv(tmp_path / "day.csv", recording)
    write_toml(tmp_path / "lab.toml", mapping_of(recording, action=None, joints=None))
    assert "heft import --find" in refusal(capsys, "import", "lab.toml", "day.csv", "--out", "lab")
    assert ended("import", "lab.toml", "day.csv", "--find", "--grasps", "A3") == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "accelerated turn left 8 steps 140 deg (0, 0) A3 0.0" in said
    assert "turn left and back 10.0 deg/s 41 deg (8, 8) A4 14.1" in said
    assert "lab.found.toml: review and correct it" in said
    assert ended("import", "lab.found.toml", "--out", "lab") == 0
    said = capsys.readouterr().out
    assert "ok      day.csv, 0 s to 14.12 s: L2: accelerate (grasp 3" in said
    assert "2 trials of L2 in lab, all usable" in said
    stored = [t for _, t in load_trajectories("lab")]
    assert sorted(t.provenance["stretch"] for t in stored) == ["0 s to 14.12 s", "14.12 s to 28.01 s"]
    assert ended("import", "lab.found.toml", "--out", "lab") == 0  # the same again takes the same place
    assert len(list(load_trajectories("lab"))) == 2
    text = Path("lab.found.toml").read_text(encoding="utf-8")
    Path("lab.found.toml").write_text(text.replace("from_s = 14.12\n", "from_s = 4.0\n"), encoding="utf-8")
    assert ended("import", "lab.found.toml", "--out", "lab") == 2
    error = capsys.readouterr().err
    assert "logs.file: got 'day.csv, 0 s to 14.12 s'; allowed: each stretch" in error
    assert "another [[logs]] has 4 s to 28.01 s" in error
    said = refusal(capsys, "import", "lab.found.toml", "--find")
    assert "--find: got 'lab.found.toml'; allowed: a mapping without [[logs]]" in said
    said = refusal(capsys, "import", "lab.toml", "day.csv", "--find", "--grasps", "A3")
    assert "--find: got 'lab.found.toml'; allowed: no such file yet" in said
    assert Path("lab.found.toml").read_text(encoding="utf-8") != text  # as it was edited


ENDLESS = """
import sys, threading
from scenarios.cli.main import command
threading.Thread(target=threading.Event().wait, name="endless").start()
sys.argv = ["heft", WORDS]
command()
"""


@pytest.mark.parametrize(
    ("words", "code"), [pytest.param("--version", 0, marks=pytest.mark.slow), ("no_such_command", 2)]
)
def test_a_thread_that_never_ends_is_named_and_left(words: str, code: int):
    program = ENDLESS.replace("WORDS", repr(words))
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == code
    assert "threads of a plug-in still running: endless" in ended.stderr
