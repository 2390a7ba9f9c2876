"""The recording of an object: parts, points of contact and grasps, before anything is felt."""

from pathlib import Path

import pytest

from scenarios.cli.main import main
from testbed.objects.files import load_object
from tests.helpers.chunks import read_chunks, verify


@pytest.mark.parametrize("name", ["L2", pytest.param("hammer", marks=pytest.mark.slow)])
def test_parts_contacts_and_grasps_are_recorded(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    file, shape = tmp_path / "object.rrd", load_object(name).shape
    main(["show", name, "--record", str(file)])
    assert f"recording: {file}" in capsys.readouterr().out
    verify(file)
    found = set(read_chunks(file))
    wanted = {f"object/parts/{part}" for part in shape.group_names} | {"object/contacts", "object/center_of_mass"}
    assert wanted | {f"object/grasps/{grasp.name}" for grasp in shape.grasps} <= found
