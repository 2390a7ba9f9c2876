"""Folders and files of strangers: reading them runs no code, and nothing is read or written outside them."""

import os
from pathlib import Path

import pytest

from estimators.registry import ESTIMATOR
from scenarios.cli.main import main
from scenarios.results.estimates import load_estimate, load_results
from scenarios.results.files import LOCK, exclusive, inside, is_held, read_manifest, write_json
from scenarios.results.store import Store
from scenarios.results.table import rows_of, write_rows
from testbed.errors import HeftError
from testbed.files import write_whole
from testbed.plugins import load_class
from tests.helpers.commands import refusal

MODULE = "open('ran', 'w').close()\nclass Mine:\n    pass\n"
SCENARIO = """
objects = ["I1"]
[policy]
kind = "stranger:Mine"
[simulation]
runner = "stranger:Mine"
[methods.mine]
method = "stranger:Mine"
"""
ROBOT = "[arm]\nmodel = 'stranger:Mine'\n[sensor]\nmodel = 'stranger:Mine'\n[gripper]\nmodel = 'stranger:Mine'\n"


@pytest.fixture
def here(copied, tmp_path, as_user) -> Path:
    """A stranger's folder as the current one: a module, files that name it, and results in `out` that name it."""
    (tmp_path / "s.toml").write_text(SCENARIO, encoding="utf-8")
    (tmp_path / "robot.toml").write_text(ROBOT, encoding="utf-8")
    manifest = read_manifest(copied)
    assert manifest is not None
    manifest["name"] = str(tmp_path / "s.toml")
    manifest["scenario"]["methods"] = {name: {"method": "stranger:Mine"} for name in manifest["scenario"]["methods"]}
    write_json(copied / "manifest.json", manifest)
    write_rows(copied, [row | {"kind": "stranger:Mine"} for row in rows_of(load_results(copied))])
    return as_user(trusted=False, stranger=MODULE)


@pytest.mark.slow
def test_reading_imports_nothing_that_a_file_names(here, capsys):
    key = load_results("out")["key"][0]
    for command in ("status out", "view out --report", "run s.toml --dry-run", f"export out {key}"):
        main(command.split())
    for command, said in (
        ("run s.toml", "--allow-code"),
        ("estimate out --scenario s.toml", "--allow-code"),
        ("robot check", "PYTHONPATH=."),
        (f"export out {key} --draws 5", "an estimate by hidden_states or bayes"),
    ):
        with pytest.raises(SystemExit):
            main(command.split())
        captured = capsys.readouterr()
        assert said in captured.out + captured.err
    assert not (here / "ran").exists()
    assert "Mine has no estimate" in refusal(capsys, "run", "s.toml", "--allow-code") and (here / "ran").exists()


def test_a_class_of_the_current_folder_is_run_where_the_command_line_names_it(here, capsys):
    with pytest.raises(HeftError, match="only one in the current folder: --allow-code"):
        load_class("stranger:Mine", ESTIMATOR, "methods")
    assert not (here / "ran").exists()
    assert "Mine has no estimate" in refusal(capsys, "run", "blocks", "--methods", "stranger:Mine")
    assert (here / "ran").exists()


@pytest.mark.parametrize("kind", ["symlink", "hard link", "pipe"])
def test_a_lock_that_is_no_file_of_heft_is_refused_and_its_target_left(tmp_path, kind):
    target, lock = tmp_path / "target", tmp_path / LOCK
    target.write_text("precious", encoding="utf-8")
    {"symlink": lambda: lock.symlink_to(target), "hard link": lambda: lock.hardlink_to(target)}.get(
        kind, lambda: os.mkfifo(lock)
    )()
    with pytest.raises(HeftError, match="not a file of heft's"):
        is_held(tmp_path)
    with pytest.raises(HeftError, match="not a file of heft's"), exclusive(tmp_path):
        pass
    assert target.read_text(encoding="utf-8") == "precious"


def test_a_link_where_a_file_is_about_to_be_written_is_not_followed(tmp_path):
    target, path = tmp_path / "target", tmp_path / "out" / "report.html"
    target.write_text("precious", encoding="utf-8")
    path.parent.mkdir()
    path.symlink_to(target)
    (path.parent / f".{path.name}.{os.getpid()}.part").symlink_to(target)
    write_whole(path, lambda part: part.write_text("page", encoding="utf-8"))
    assert path.read_text(encoding="utf-8") == "page" and not path.is_symlink()
    assert target.read_text(encoding="utf-8") == "precious"


@pytest.mark.parametrize("name", ["..", "", "a/b", "../../x", "/etc/passwd", "a\0b"])
def test_a_name_that_leads_out_of_a_results_folder_is_refused(tmp_path, name):
    for use in (inside, lambda root, key: inside(root, "trials", key, "trial.json")):
        with pytest.raises(HeftError, match="leads out"):
            use(tmp_path, name)
    with pytest.raises(HeftError, match="leads out"):
        Store(tmp_path).put_error("estimates", name, "text")
    with pytest.raises(HeftError, match="leads out"):
        load_estimate(tmp_path, name)


def test_nothing_is_written_through_a_linked_folder_or_a_name_in_the_table(copied, tmp_path, capsys):
    aside = tmp_path / "aside"
    aside.mkdir()
    for name in ("figures", "recordings", "exports"):
        (copied / name).unlink(missing_ok=True)
        (copied / name).symlink_to(aside)
    rows = [row | {"object": "../../aside/pwn"} for row in rows_of(load_results(copied))]
    key = rows[0]["key"]
    for command in ("view out --figures", f"view out {key} --record", f"export out {key}"):
        words = [str(tmp_path / word) if word == "out" else word for word in command.split()]
        assert "leads out of the folder" in refusal(capsys, *words)
    (copied / "exports").unlink()
    write_rows(copied, rows)
    main(["export", str(copied), key])
    assert [*aside.iterdir()] == [] and len([*(copied / "exports").iterdir()]) == 2
