from __future__ import annotations

import dataclasses
import functools

import pytest


@pytest.fixture(autouse=True)
def library(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Whose DDPG learns. What is ours is tested with Stable-Baselines3, whose first step takes no seconds of
    compiling; tests of the library itself ask for both."""
    # Imported here, or the command line's tests would wait for torch.
    from harness import rl

    chosen: str = getattr(request, "param", "sb3")
    monkeypatch.setattr(rl, "Settings", functools.partial(rl.Settings, library=chosen))
    for env, settings in rl.SETTINGS.items():
        monkeypatch.setitem(rl.SETTINGS, env, dataclasses.replace(settings, library=chosen))
    return chosen
