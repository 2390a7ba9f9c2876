"""Public measurements, where HEFT_REAL_DATA names a folder that has them: docs/real_data.md says where to get them."""

import os
from pathlib import Path

import numpy as np
import pytest

from bench.real_data import center, poses, read
from estimators.evaluation.statistics import NINETY
from scenarios.cli.main import main

pytestmark = pytest.mark.slow
DATA = Path(os.environ.get("HEFT_REAL_DATA", "real_data"))
PUSHES, POSES = DATA / "mit_push", DATA / "kuka_ft_imu"
needs_pushes = pytest.mark.skipif(
    not PUSHES.is_dir(), reason="needs MIT's pushes: HEFT_REAL_DATA names no folder with mit_push"
)
PLATES = {"ellip3": 7, "hex": 9}
"""Usable pushes of each plate."""


def mapping(folder: Path, plate: str) -> Path:
    """The mapping of docs/real_data.md, of one plate."""
    text = Path("docs/real_data.md").read_text(encoding="utf-8").split('title="hex.toml"\n')[1].split("```")[0]
    path = folder / f"{plate}.toml"
    path.write_text(text.replace("plate.toml", str(PUSHES.absolute() / f"objects/{plate}/{plate}.toml")))
    return path


def found(folder: Path, plate: str) -> Path:
    """Mapping of the pushes that `heft import --find` finds."""
    table = mapping(folder, plate)
    main(["import", str(table), *map(str, sorted((PUSHES / "h5").glob(f"*shape={plate}_*.h5"))), "--find"])
    return table.with_suffix(".found.toml")


@needs_pushes
@pytest.mark.parametrize("plate", PLATES)
def test_all_pushes_of_a_plate_show_its_center(plate: str, tmp_path: Path):
    obj, trials = read(found(tmp_path, plate))
    answer = center(obj, trials)
    assert len(trials) == PLATES[plate] and answer is not None and answer.status == "ok"
    assert np.hypot(*answer.center) < 3 and (np.abs(answer.center) < NINETY * answer.error).all()


LOW = pytest.mark.xfail(strict=True, reason="0.465: the mode of friction's own density is below the joint one, 0.49")


@needs_pushes
@pytest.mark.parametrize("plate", [pytest.param("ellip3", marks=LOW), "hex"])
def test_all_pushes_of_a_plate_show_its_friction(plate: str, tmp_path: Path):
    answer = center(*read(found(tmp_path, plate)))
    assert answer is not None and 0.47 <= answer.friction <= 0.51


@needs_pushes
def test_a_dead_force_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit):
        found(tmp_path, "rect1")
    said = capsys.readouterr().err
    assert said.count("in all samples") == 9 and said.count("it was stuck") == 2


@pytest.mark.skipif(not POSES.is_dir(), reason="needs Skrede's poses: HEFT_REAL_DATA names no folder with kuka_ft_imu")
def test_halves_of_still_poses_agree():
    table = poses(POSES / "0-calibration_fts-accel.csv", POSES / "0-steady-state_wrench.csv")
    assert str(table.caption).startswith("9 of 10 splits")
