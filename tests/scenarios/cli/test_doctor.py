"""heft doctor on simulated trials: on own weight they agree, one rigid body is found out."""

import pytest

from scenarios.cli.main import main
from scenarios.config import load_scenario
from scenarios.study.run import run_scenario
from tests.helpers.runs import quiet, small_scenario

METHODS = "\n[methods.hidden_states]\n"


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    folder = tmp_path_factory.mktemp("doctor")
    file = small_scenario(folder, more=METHODS)
    run_scenario(load_scenario(str(file))[1], folder / "out", 0, quiet)
    return folder / "out"


@pytest.mark.slow
def test_it_tells_misfit_causes_and_trials_and_draws_them(results, capsys):
    main(["doctor", str(results)])
    said = " ".join(capsys.readouterr().out.split())
    assert said.count("trials that fit least") == said.count("figure: ") == 4  # two supports under two sensors
    assert "the trials agree within the errors stated" in said
    assert "rigid, ideal: misfit" in said and "as under one rigid body" in said
    assert len(list((results / "figures").glob("doctor_pair_*.png"))) == 4


@pytest.mark.slow
def test_what_is_not_there_is_named(results, capsys):
    for words, wanted in ((["nobody"], "one of pair"), (["--draw", "7"], "a draw that the folder has estimates of")):
        with pytest.raises(SystemExit):
            main(["doctor", str(results), *words])
        assert wanted in capsys.readouterr().err
