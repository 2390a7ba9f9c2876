"""Planning as an environment of Gymnasium: its interface, its rewards, and what it keeps to itself."""

import math
import subprocess
import sys
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from estimators.action_selection.trained import TrainedIndex
from estimators.evaluation.metrics import normalized_absolute_difference
from estimators.testing.truth import truth_within_reach
from scenarios import Scenario, run_scenario
from scenarios.policies import Policy
from testbed import InvalidValueError, Rotate, load_object
from tests.helpers.pages import DOCS, blocks_of, run_file
from tests.helpers.runs import quiet, small_scenario

pytestmark = pytest.mark.slow
gymnasium = pytest.importorskip("gymnasium", reason="needs the extra gym")
from gymnasium.utils.env_checker import check_env  # noqa: E402  after the check that it is there

from scenarios.environment import PlanningEnv  # noqa: E402
from scenarios.environment.planning import Reward  # noqa: E402
from scenarios.environment.train import train  # noqa: E402

ID = "scenarios.environment:heft/Planning-v0"
ROOT = Path(__file__).parents[3]


def actions(env: PlanningEnv, count: int, seed: int = 0) -> list[np.ndarray]:
    """Points of actions of the family, which are not refused beforehand."""
    drawn = env.family.sample(env.box.shape, env.box.grasps, 10 * count, seed)
    return [env.box.point(a).astype(np.float32) for a in np.random.default_rng(seed).permutation(np.array(drawn))][
        :count
    ]


@pytest.mark.parametrize("backend", ["expected", "analytic", "mujoco"])
def test_gymnasium_finds_nothing_wrong(backend):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gymnasium.make(ID, backend=backend, render_mode="rgb_array").unwrapped)


@pytest.mark.parametrize("backend", ["expected", "analytic"])
def test_one_seed_is_one_episode_and_another_is_another(backend):
    def episode(seed: int) -> list[np.ndarray]:
        env = PlanningEnv(backend, budget_s=45.0)
        found, over = [env.reset(seed=seed)[0]], False
        env.action_space.seed(0)
        while not over:
            seen, reward, _, over, _ = env.step(env.action_space.sample())
            found.append(seen | {"reward": np.array(reward)})
        return [np.concatenate([np.ravel(value) for value in each.values()]) for each in found]

    first, again, other = episode(1), episode(1), episode(2)
    assert all((a == b).all() for a, b in zip(first, again, strict=True))
    assert (first[0] != other[0]).any()


@pytest.mark.parametrize("backend", ["expected", "analytic", "mujoco"])
def test_rewards_times_seconds_sum_to_the_fall_of_the_expected_nad(backend):
    kinds: dict[Reward, Callable[[float], float]] = {"nad": float, "log_nad": math.log}
    for reward, of in kinds.items():
        env = PlanningEnv(backend, reward, budget_s=50.0, object="L2")
        info = env.reset(seed=0)[1]
        before, total, spent, over = info["expected_nad"], 0.0, 0.0, False
        points = [*actions(env, 2), np.ones(6, np.float32)]
        while not over:
            _, gain, ended, over, info = env.step(points[0] if len(points) == 1 else points.pop(0))
            total, spent = total + gain * info["seconds"], spent + info["seconds"]
            assert not ended
        assert total == pytest.approx(of(before) - of(info["expected_nad"]))
        assert total > 0
        assert spent >= 50.0


def test_the_last_reward_is_the_true_nad():
    env = PlanningEnv("analytic", "final", budget_s=140.0, object="L2")
    env.reset(seed=0)
    rewards, over, points = [], False, actions(env, 20)
    while not over:
        _, reward, _, over, _ = env.step(points.pop(0))
        rewards.append(reward)
    assert set(rewards[:-1]) == {0.0}
    assert env.answer is not None
    truth = load_object("L2").truth
    assert rewards[-1] == -normalized_absolute_difference(env.box.shape, env.answer, truth)
    assert -0.2 < rewards[-1] < 0


def test_refused_actions_cost_time_and_end_nothing():
    env = PlanningEnv("mujoco", budget_s=110.0, object="L2")
    first, _ = env.reset(seed=0)
    inside = Rotate(0, 0.15, 4.0, tuple(env.box.shape.particles[0].tolist()), True)
    seen, reward, ended, over, info = env.step(env.box.point(inside))
    assert (reward, ended, over, info["why"]) == (0.0, False, False, "center at a particle")
    assert info["seconds"] > 0
    assert seen["time_left"][0] == pytest.approx(1 - info["seconds"] / 110.0)
    assert seen["done"][0, -1] == -1
    assert all((seen[name] == first[name]).all() for name in ("error", "mean", "expected_nad"))
    env.left = 5.0
    *_, over, info = env.step(actions(env, 1)[0])
    assert over
    assert "5 s are left" in info["why"]


def test_a_repeated_action_is_expected_to_add_nothing():
    env = PlanningEnv(object="L2")
    env.reset(seed=0)
    point = actions(env, 1)[0]
    assert [env.step(point)[1] > 0 for _ in range(2)] == [True, False]


@pytest.mark.parametrize("backend", ["expected", "analytic", "mujoco"])
def test_observations_depend_on_the_truth_by_measurements_alone(backend):
    model = load_object("L2")
    other = replace(model, truth=replace(model.truth, mass=model.truth.mass[::-1], friction=model.truth.friction / 2))
    assert other.total_mass == pytest.approx(model.total_mass)
    envs = [PlanningEnv(backend, object=each) for each in (model, other)]
    seen = [env.reset(seed=0) for env in envs]
    assert all(np.allclose(seen[0][0][name], seen[1][0][name], atol=1e-6) for name in seen[0][0])
    for point in actions(envs[0], 2):
        steps = [env.step(point) for env in envs]
        same = all(np.allclose(steps[0][0][name], steps[1][0][name], atol=1e-6) for name in steps[0][0])
        assert same == (backend == "expected")
        assert truth_within_reach({"seen": steps[0][0], "info": steps[0][4]}, model) == []


def test_the_expected_backend_needs_no_mujoco():
    code = f"import gymnasium, sys; gymnasium.make('{ID}').reset(seed=0); print('mujoco' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True)
    assert done.stdout.strip() == "False"


def test_the_episode_of_the_documentation_runs(tmp_path, monkeypatch, capsys):
    blocks = blocks_of(DOCS / "environment.md")
    (code,) = (block.text for block in blocks if block.title == "episode.py")
    (tmp_path / "episode.py").write_text(code, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    run_file("episode.py")
    assert capsys.readouterr().out == next(block.text for block in blocks if block.mark.endswith("episode.py"))


def test_two_environments_in_processes_of_their_own():
    alone = gymnasium.make_vec(ID, 2, "sync", budget_s=40.0)
    apart = gymnasium.make_vec(ID, 2, "async", vector_kwargs={"context": "spawn"}, budget_s=40.0)
    try:
        alone.action_space.seed(0)
        point = alone.action_space.sample()
        for vector in (alone, apart):
            vector.reset(seed=5)
        one, two = alone.step(point), apart.step(point)
        assert all((one[0][name] == two[0][name]).all() for name in one[0])
        assert (one[1] == two[1]).all()
        assert len({*one[4]["expected_nad"]}) == 2
    finally:
        alone.close()
        apart.close()


@pytest.mark.parametrize(
    ("settings", "field"),
    [
        ({"backend": "gazebo"}, "backend"),
        ({"reward": "nade"}, "reward"),
        ({"reward": "final"}, "reward"),
        ({"budget_s": 0.0}, "budget_s"),
        ({"blocks": (1, 4)}, "blocks"),
        ({"object": "shears"}, "object"),
    ],
)
def test_settings_that_mean_nothing_are_named(settings, field):
    with pytest.raises(InvalidValueError) as error:
        PlanningEnv(**settings)
    assert error.value.field == f"PlanningEnv.{field}"


def test_numbers_of_blocks_may_be_a_list():
    env = PlanningEnv(blocks=[2, 3])  # pyright: ignore[reportArgumentType]
    assert env.reset(seed=0)[1]["seconds"] == 0.0


def test_the_policy_of_a_short_training_runs_in_a_scenario(tmp_path: Path):
    weights = tmp_path / "w.json"
    falls = train(weights, objects=2, unseen=2, generations=2, population=4, candidates=40, budget_s=60.0)
    assert TrainedIndex.load(weights).budget_s == 60.0
    assert falls.shape == (2, 2)
    assert (falls > 1).all()
    small_scenario(tmp_path)
    settings = {"file": str(weights), "candidates": 40, "most": 2}
    policy = Policy(kind="estimators.action_selection.trained:TrainedPolicy", touches=2, settings=settings, held_out=0)
    scenario = Scenario(objects=[str(tmp_path / "pair.toml")], policy=policy, sensing=["ft300s"], seeds=1)
    rows = run_scenario(scenario, tmp_path / "out", 0, quiet, "inline", secret="tests")
    assert len(rows) > 0
    assert max(rows["nad"].tolist()) < 0.2
    assert {len(keys) for keys in rows["trial_keys"]} == {3}  # the weighing, and two planned trials
