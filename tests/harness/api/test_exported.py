"""What is exported is what was scored, bit for bit, and other programs take it."""

import shutil
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from hypothesis import given, settings
from hypothesis import strategies as st
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor

import irl_bench
from harness.api.exported import FACTS, export, load_learned
from harness.cell.run import prepare, run_cell
from harness.cli.main import main
from harness.process.environment import CACHE_VARIABLE
from harness.records import Cell, Conditions
from harness.registry import SPECS, BadInput
from harness.rl.seeds import evaluation_seeds
from harness.store.opening import open_for_run, open_to_verify
from harness.store.request import Request

CONDITIONS = Conditions("smoke", "absorbing", "sb3")
CELLS = [Cell("cartpole", "shaped", 0), Cell("cartpole_discrete", "bc", 0)]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that learned a policy with a reward, and one of choices."""
    path = tmp_path_factory.mktemp("run") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(CACHE_VARIABLE, str(path.parent / "cache"))
        request = Request(("shaped", "bc"), ("cartpole", "cartpole_discrete"), (0,), CONDITIONS)
        with open_for_run(path, request) as directory:
            for cell in CELLS:
                directory.save(*run_cell(cell, CONDITIONS, prepare([cell], CONDITIONS)))
    return path


@pytest.fixture(scope="module")
def folder(run: Path) -> Path:
    return export(run, "cartpole", "shaped", to=run.parent / "exported")


def test_exported_and_in_process_outputs_are_bit_equal(run: Path, folder: Path) -> None:
    with open_to_verify(run) as directory:
        kept = directory.read_learned(directory.load()[0][CELLS[0]])
    found = load_learned(folder)
    rng = np.random.default_rng(0)
    obs, act, after = rng.normal(size=(50, 4)), rng.uniform(-1, 1, (50, 1)), rng.normal(size=(50, 4))
    assert np.array_equal(found.policy(obs), kept["pi_star"](obs))
    assert found.reward is not None
    assert np.array_equal(found.reward(obs, act, after), kept["reward"](obs, act, after))
    assert found.reward.absorbing == kept["reward"].absorbing == found.facts["absorbing"]
    retrained = load_learned(export(run, "cartpole", "shaped", policy="pi_R", to=folder.parent / "pi_R"))
    assert np.array_equal(retrained.policy(obs), kept["pi_R"](obs))


def test_nothing_that_is_there_is_replaced(run: Path, folder: Path, tmp_path: Path) -> None:
    (tmp_path / "reward.safetensors").write_text("mine")
    for there in (tmp_path, folder, run, tmp_path / "reward.safetensors"):
        with pytest.raises(BadInput, match="is there already"):
            export(run, "cartpole", "shaped", to=there)
    assert (tmp_path / "reward.safetensors").read_text() == "mine"


@pytest.mark.parametrize("other", ["CartPole-v1", "Pendulum-v1", "InvertedPendulum-v5"])
def test_a_reward_is_of_its_own_tasks_spaces(folder: Path, other: str) -> None:
    with pytest.raises(BadInput, match=r"irl_bench.make\('cartpole'\) has those"):
        irl_bench.LearnedReward(gym.make(other), folder)


@pytest.mark.parametrize("cell", CELLS, ids=lambda cell: cell.env)
def test_stable_baselines_evaluates_an_exported_policy_to_what_the_run_scored(run: Path, cell: Cell) -> None:
    found = load_learned(export(run, cell.env, cell.method, to=run.parent / cell.env))
    env = Monitor(irl_bench.make(cell.env))
    seeds = evaluation_seeds(0, SPECS[cell.env].eval_episodes["smoke"])
    returns = []
    for seed in seeds:
        env.reset(seed=seed)
        done = False
        obs, _ = env.reset(seed=seed)
        while not done:
            action, _ = found.policy.predict(obs)
            obs, _, terminated, truncated, _ = env.step(action)
            done = terminated or truncated
        returns.append(env.get_episode_rewards()[-1])
    with open_to_verify(run) as directory:
        row = directory.load()[0][cell].rows[0]
    assert np.mean(returns) == pytest.approx(row.return_mean, rel=1e-5)
    mean, _ = evaluate_policy(found.policy, env, n_eval_episodes=2)  # type: ignore[arg-type]
    assert np.isfinite(mean)


@pytest.mark.filterwarnings("ignore:.*different from the unwrapped version:UserWarning")
@pytest.mark.filterwarnings("ignore:.*Box observation space (minimum|maximum) value is:UserWarning")
def test_any_library_learns_under_an_exported_reward(folder: Path) -> None:
    env = irl_bench.LearnedReward(irl_bench.make("cartpole"), folder)
    check_env(irl_bench.LearnedReward(irl_bench.make("cartpole"), folder), skip_render_check=True)
    found = load_learned(folder)
    obs, _ = env.reset(seed=3)
    plain = irl_bench.make("cartpole")
    plain.reset(seed=3)
    for act in np.linspace(-0.5, 0.5, 5, dtype=np.float32)[:, None]:
        after, paid, *_, info = env.step(act)
        _, true, *_ = plain.step(act)
        rows = [np.asarray(row, float)[None] for row in (obs, act, after)]
        assert found.reward is not None
        assert paid == found.reward(*rows)[0] - found.reward.absorbing
        assert info["true_reward"] == true
        obs = after
    bare = irl_bench.LearnedReward(irl_bench.make("cartpole"), folder, offset=False)
    bare.reset(seed=3)
    assert found.reward is not None
    assert bare.step(np.zeros(1, np.float32))[1] != 0
    model = PPO("MlpPolicy", env, n_steps=32, batch_size=32, n_epochs=1, seed=0)
    before = {name: value.clone() for name, value in model.policy.state_dict().items()}
    model.learn(64)
    assert any((value != before[name]).any() for name, value in model.policy.state_dict().items())


def test_what_is_not_there_is_said(
    run: Path, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def refused(*words: str) -> str:
        assert main(["export", str(run), *words, "--to", str(tmp_path / "to")]) == 2
        assert not (tmp_path / "to").exists()
        return capsys.readouterr().err

    shaped, choices = ("--env", "cartpole", "--method", "shaped"), ("--env", "cartpole_discrete", "--method")
    assert "has no cartpole_discrete gail, seed 0; it has cartpole shaped" in refused(*choices, "gail")
    assert "has no cartpole shaped, seed 7; it has seeds 0" in refused(*shaped, "--seed", "7")
    assert "has no pi_R; it has pi_star" in refused(*choices, "bc", "--policy", "pi_R")
    with pytest.raises(BadInput, match="the method learns none"):
        irl_bench.LearnedReward(
            irl_bench.make("cartpole_discrete"), export(run, "cartpole_discrete", "bc", to=tmp_path / "bc")
        )
    for name, why in {"cartpol": "did you mean 'cartpole'", "all": "one env", "gym:Nope-v1": "Nope"}.items():
        with pytest.raises(BadInput, match=why):
            irl_bench.make(name)
    with pytest.raises(BadInput, match="holds nothing that was exported"):
        load_learned(tmp_path / "nowhere")


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_whatever_is_damaged_is_refused_in_a_line(
    folder: Path, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    copy = tmp_path_factory.mktemp("copy") / "folder"
    shutil.copytree(folder, copy)
    name = data.draw(st.sampled_from(["policy.safetensors", "reward.safetensors", FACTS]))
    whole = (copy / name).read_bytes()
    at = data.draw(st.integers(0, len(whole) - 1))
    damaged = [whole[:at], whole[:at] + b"\x80" + whole[at + 1 :]]
    (copy / name).write_bytes(data.draw(st.sampled_from(damaged)))
    said = "ok"
    try:
        load_learned(copy)
    except BadInput as error:
        said = str(error)
    assert said.isprintable()
    assert name == FACTS or said != "ok" or whole[at] == 0x80
