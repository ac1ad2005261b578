"""Tasks that are seen in images: encoders, what they see, and the expert that sees states."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium import spaces

from envs import from_gymnasium
from envs.encoders import EXAMPLES, FEATURES, LAYERS, Convolutions, Images, _convolved, made
from envs.swingups import swingup
from envs.swingups.swingup_pixels import SIDE, SPEC, drawn
from harness.api.exported import Exported, ExportedPolicy, LearnedReward, make
from harness.cell.experts import source_for
from harness.demonstrations.reading import read
from harness.records import Conditions, Shown
from harness.registry import ENCODERS, SPECS, BadInput
from harness.rl.on_policy import dynamics_of
from harness.rl.simulator import Simulator
from harness.rl.stored import from_arrays, to_arrays
from harness.rl.world import Features, TaskWorld
from methods.base import Array, Unsuitable
from methods.rewards import Constant


def images(count: int, channels: int = 2) -> Images:
    return np.random.default_rng(0).integers(0, 256, (count, SIDE, SIDE, channels), np.uint8)


class Mean:
    """An encoder of the user's: the mean pixel, many times."""

    def __init__(self, examples: Images) -> None:
        assert examples.ndim == 4

    def __call__(self, shown: Images) -> Array:
        return np.repeat(shown.mean(axis=(1, 2, 3))[:, None], FEATURES, axis=1)


class Short(Mean):
    def __call__(self, shown: Images) -> Array:
        return super().__call__(shown)[:, 1:]


class Unfinished(Mean):
    def __call__(self, shown: Images) -> Array:
        return np.where(np.arange(FEATURES) == 3, np.nan, super().__call__(shown))


class Drawn(Mean):
    """An encoder that is another one each time."""

    def __init__(self, examples: Images) -> None:
        super().__init__(examples)
        self._shift = np.random.default_rng().normal()

    def __call__(self, shown: Images) -> Array:
        return super().__call__(shown) + self._shift


class Centred(Mean):
    """An encoder whose features depend on what is beside an image."""

    def __call__(self, shown: Images) -> Array:
        features = super().__call__(shown)
        return features - features.mean(axis=0)


@pytest.mark.parametrize(("width", "stride"), [(5, 2), (3, 1), (8, 4)])
def test_a_convolution_is_torchs(width: int, stride: int) -> None:
    x, weights = (
        images(3),
        np.random.default_rng(1).integers(-9, 10, (2 * width * width, 4)).astype(np.float32),
    )
    # Windows have the axes (C, width, width).
    kernel = torch.as_tensor(weights.T.reshape(4, 2, width, width))
    theirs = torch.nn.functional.conv2d(
        torch.as_tensor(x.transpose(0, 3, 1, 2), dtype=torch.float32), kernel, None, stride, width // 2
    )
    ours = _convolved(x, width, stride, weights)
    assert np.array_equal(ours, theirs.numpy().transpose(0, 2, 3, 1)[:, : ours.shape[1], : ours.shape[2]])


@pytest.mark.parametrize("name", LAYERS)
def test_features_do_not_depend_on_what_is_encoded_beside(name: str) -> None:
    examples = drawn(swingup.NOMINAL.observe(np.random.default_rng(0).uniform(-3, 3, (2, 300))).T, 1.0)
    encode = Convolutions(LAYERS[name], np.concatenate([examples, examples[::-1]], axis=-1))
    shown = images(40)
    every = encode(shown)
    assert every.shape == (40, FEATURES)
    assert np.array_equal(every[:7], encode(shown[:7]))
    assert np.array_equal(every[7:8], encode(shown[7:8]))
    assert len(np.unique(every, axis=0)) == 40


def test_an_encoder_of_ones_own_is_found_and_others_are_refused() -> None:
    assert {*LAYERS} == {*ENCODERS}
    found = made(f"{__name__}:Mean", images(8))
    assert found(images(3)).shape == (3, FEATURES)
    assert np.allclose(found(images(8)).mean(axis=0), 0)
    assert np.allclose(found(images(8)).std(axis=0), 1)
    refused = {
        "Short": r"gives \(2, 63\) of 2 images, not finite \(2, 64\)",
        "Unfinished": "not finite",
        "Drawn": "other features again",
        "Centred": "or beside others",
    }
    for kind, why in refused.items():
        with pytest.raises(ValueError, match=why):
            made(f"{__name__}:{kind}", images(8))
    for name in ("smal", "no.module:Class", f"{__name__}:Missing"):
        with pytest.raises(ValueError, match=r"no encoder .*give small, nature, or module:Class"):
            made(name, images(8))


def test_the_rod_is_drawn_where_it_is() -> None:
    up, left, down = (np.array([[np.cos(a), np.sin(a), 0.0]]) for a in (0, np.pi / 2, np.pi))
    middle = SIDE // 2
    for obs, (row, column) in ((up, (6, middle)), (left, (middle, 6)), (down, (SIDE - 6, middle))):
        image = drawn(obs, 1.0)[0, ..., 0]
        assert image[row, column] > 200
        assert image[SIDE - 1 - row, SIDE - 1 - column] == (0 if row != column else image[row, column])
        assert 20 < (image > 100).sum() < 40
    assert (drawn(up, 0.5) > 100).sum() < (drawn(up, 1.0) > 100).sum()


def test_an_experts_episodes_are_shown_in_images() -> None:
    seeds = range(3)
    states = Simulator(SPEC.expert_sees).run(lambda obs: np.tanh(obs[:, 1:2]), seeds)
    shown = Simulator(SPEC).shown(states, seeds)
    assert SPEC.expert_sees is SPECS["swingup"]
    for there, here in zip(states, shown, strict=True):
        assert np.array_equal(there.act, here.act)
        assert np.array_equal(there.rewards, here.rewards)
        assert here.obs.shape == (201, FEATURES)
    assert Simulator(SPECS["swingup"]).shown(states, seeds) is states
    other = replace(SPEC, expert_task=SPECS["swingup"].variant("heavy"))
    with pytest.raises(RuntimeError, match=r"episodes differ from swingup\.heavy's"):
        Simulator(other).shown(Simulator(other.expert_sees).run(lambda obs: obs[:, :1], seeds), seeds)


def test_images_have_no_written_dynamics_and_no_expert_to_ask() -> None:
    assert dynamics_of(SPECS["swingup"]) is swingup.NOMINAL
    assert dynamics_of(SPECS["swingup"].variant("heavy")) is not None
    assert dynamics_of(SPECS["highway"]) is not None
    assert dynamics_of(SPEC) is dynamics_of(SPEC.variant("heavy")) is None
    assert SPEC.variant("heavy").expert_sees.name == "swingup.heavy"
    world = TaskWorld(SPEC, "absorbing", "sbx", expert=lambda obs: obs)
    with pytest.raises(Unsuitable, match="the expert sees states"):
        world.ask(np.zeros((1, FEATURES)))


def test_another_encoder_sees_otherwise() -> None:
    seeds, still = range(2), np.zeros((2, 1))
    small, nature = (
        Simulator(spec).run(lambda obs: still[: len(obs)], seeds)
        for spec in (SPEC, SPEC.encoded_by("nature"))
    )
    assert np.array_equal(small[0].rewards, nature[0].rewards)
    assert not np.allclose(small[0].obs, nature[0].obs)
    with pytest.raises(ValueError, match="cartpole: it has no images to encode"):
        SPECS["cartpole"].encoded_by("small")


class Spot(gym.Env[Any, Any]):
    """A spot that moves over 12 by 12 pixels, as numbers of its axes come first or last."""

    action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)

    def __init__(self, first: bool = False) -> None:
        self._first, self._at = first, 0
        self.observation_space = spaces.Box(0, 255, (1, 12, 12) if first else (12, 12, 1), np.uint8)

    def _shown(self) -> tuple[Any, dict[str, Any]]:
        image = np.zeros((12, 12, 1), np.uint8)
        image.reshape(-1)[self._at] = 255
        return image.transpose(2, 0, 1) if self._first else image, {}

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self._at = int(self.np_random.integers(144))
        return self._shown()

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self._at = (self._at + (1 if action[0] > 0 else 143)) % 144
        obs, info = self._shown()
        return obs, float(self._at), False, False, info


SPOTS = ("irl_bench_test/Last-v0", "irl_bench_test/First-v0")


@pytest.fixture
def spots() -> Iterator[None]:
    for name in SPOTS:
        gym.register(name, Spot, max_episode_steps=20, kwargs={"first": name == SPOTS[1]})
    yield
    for name in SPOTS:
        del gym.registry[name]


def test_any_task_of_images_has_features(spots: None) -> None:
    last, first = (from_gymnasium(name, "spot") for name in SPOTS)
    assert (last.obs_size, last.encoder) == (FEATURES, "small")
    run = [Simulator(spec).run(lambda obs: np.ones((len(obs), 1)), range(3)) for spec in (last, first)]
    assert np.array_equal(run[0][1].obs, run[1][1].obs)
    assert len(np.unique(run[0][0].obs, axis=0)) == 21
    own = Simulator(last.encoded_by(f"{__name__}:Mean")).run(lambda obs: np.ones((len(obs), 1)), [0])
    assert np.allclose(own[0].obs, 0)  # all its images are as bright
    env: Any = last.make()
    native, _ = gym.make(last.env_id).reset(seed=5)
    assert np.array_equal(env.get_wrapper_attr("encoded")(native[None])[0], env.reset(seed=5)[0])
    assert EXAMPLES >= 2 * FEATURES


def test_images_of_a_file_are_encoded(spots: None, tmp_path: Path) -> None:
    spec, env = from_gymnasium(SPOTS[1], "spot"), gym.make(SPOTS[1])
    shown, act = [env.reset(seed=3)[0]], np.where(np.arange(20) % 3, 0.5, -0.5)[:, None].astype(np.float32)
    shown += [env.step(one)[0] for one in act]
    ends = {"terminal": np.array([True]), "indices": np.zeros(0, np.int64), "infos": np.zeros(20)}
    (played,) = Simulator(spec).run(lambda obs: act[:1], [3], [act.astype(np.float64)])
    for obs in (np.stack(shown), np.stack(shown).reshape(21, -1)):
        np.savez(tmp_path / "a.npz", obs=obs, acts=act, rews=np.zeros(20), **ends)
        assert np.array_equal(read(tmp_path / "a.npz", spec).episodes.obs[0], played.obs)
    for odd in (np.stack(shown)[..., :6], np.stack(shown).transpose(0, 2, 3, 1), np.zeros((21, FEATURES))):
        np.savez(tmp_path / "a.npz", obs=odd, acts=act, rews=np.zeros(20), **ends)
        with pytest.raises(BadInput, match=r"and the task's are images uint8 \(1, 12, 12\)"):
            read(tmp_path / "a.npz", spec)
    with pytest.raises(BadInput, match="the task draws its images itself"):
        read(tmp_path / "a.npz", SPEC)


def test_what_is_kept_and_learned_is_of_its_encoder() -> None:
    seen = []
    for encoder in ("", "nature", f"{__name__}:Mean", ""):
        conditions = Conditions("smoke", "absorbing", "sbx", encoder=encoder)
        (obs, *_) = source_for("swingup_pixels", 100, conditions).demonstrations(Shown(demos=1)).obs
        seen.append(obs)
    assert np.array_equal(seen[0], seen[3])
    assert len({obs.tobytes() for obs in seen}) == 3
    nature = SPEC.encoded_by("nature")
    reward = Exported(ExportedPolicy(lambda obs: obs[:, :1], nature), Constant(1.0, 0.0), nature, {})
    assert LearnedReward(make("swingup_pixels", encoder="nature"), reward).reset(seed=0)[0].shape == (
        FEATURES,
    )
    with pytest.raises(BadInput, match=r"irl_bench.make\('swingup_pixels'\) has those, with the encoder"):
        LearnedReward(make("swingup_pixels"), reward)
    stored = to_arrays(Features(nature), "phi")
    assert from_arrays(*stored)._spec.encoder == "nature"
    with pytest.raises(BadInput, match="cartpole: it has no images"):
        make("cartpole", encoder="small")
