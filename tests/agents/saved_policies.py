"""Small policies saved in every form, made when they are needed."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

COLUMNS, ACTIONS = 22, 6
ALGORITHMS = ("PPO", "A2C", "SAC", "TD3", "DDPG", "RecurrentPPO", "TQC", "TRPO", "CrossQ", "ARS")
NORMALISED = ("PPO", "SAC", "RecurrentPPO")


class Anything(gymnasium.Env):  # type: ignore[misc]
    """An environment with spaces and nothing behind them."""

    def __init__(self, columns: int = COLUMNS, actions: gymnasium.Space | None = None) -> None:
        self.observation_space = gymnasium.spaces.Box(-1000, 1000, (columns,), np.float32)
        self.action_space = actions or gymnasium.spaces.Box(-1, 1, (ACTIONS,), np.float32)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        return self._seen(), {}

    def step(self, _action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        return self._seen(), 0.0, False, False, {}

    def _seen(self) -> Any:
        return (self.np_random.normal(size=self.observation_space.shape) * 10 + 5).astype(np.float32)


def save_model(folder: Path, algorithm: str, *, env: gymnasium.Env | None = None, statistics: bool = True) -> Any:
    """Save a model as ``folder/model.zip``, some with ``vecnormalize.pkl``, and return it with the normalised environment."""
    folder.mkdir(parents=True, exist_ok=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import sb3_contrib
        import stable_baselines3
        import torch
        from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

        venv: Any = DummyVecEnv([lambda: env or Anything()])
        if algorithm in NORMALISED:
            venv = VecNormalize(venv)
        package = stable_baselines3 if hasattr(stable_baselines3, algorithm) else sb3_contrib
        policy = "MlpLstmPolicy" if algorithm == "RecurrentPPO" else "MlpPolicy"
        settings: dict[str, Any] = {"policy_kwargs": {"net_arch": [16]}} if algorithm != "RecurrentPPO" else {}
        if algorithm == "PPO":
            settings |= {"n_steps": 32, "batch_size": 32, "n_epochs": 1}
        torch.set_num_threads(1)  # on a busy machine several threads wait for each other
        model = getattr(package, algorithm)(policy, venv, seed=1, device="cpu", **settings)
        if algorithm == "PPO":
            model.learn(32)
        elif algorithm in NORMALISED:
            model._last_original_obs = venv.reset()  # as training leaves it
            venv.step(np.zeros((1, ACTIONS)))
        model.save(folder / "model.zip")
        if algorithm in NORMALISED and statistics:
            venv.save(str(folder / "vecnormalize.pkl"))
    return model, venv


def network(width: int = 24, columns: int = COLUMNS, actions: int = ACTIONS) -> Any:
    """A small network of torch."""
    import torch

    torch.manual_seed(3)
    layers = torch.nn.Linear(columns, width), torch.nn.Tanh(), torch.nn.Linear(width, actions), torch.nn.Tanh()
    return torch.nn.Sequential(*layers).eval()


def save_torchscript(path: Path, module: Any) -> Path:
    """Save ``module`` as TorchScript."""
    import torch

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.jit.script(module).save(str(path))
    return path


def save_onnx(path: Path, *, columns: int = COLUMNS, actions: int = ACTIONS, rows: int | str = "n", gain: float = 0.1) -> Path:
    """Save ``tanh(observations @ W)`` as ONNX."""
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    weights = (gain * np.random.default_rng(5).standard_normal((columns, actions))).astype(np.float32)
    graph = helper.make_graph(
        [helper.make_node("MatMul", ["observations", "W"], ["z"]), helper.make_node("Tanh", ["z"], ["actions"])],
        "policy",
        [helper.make_tensor_value_info("observations", TensorProto.FLOAT, [rows, columns])],
        [helper.make_tensor_value_info("actions", TensorProto.FLOAT, [rows, actions])],
        [numpy_helper.from_array(weights, "W")],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    onnx.save(model, str(path))
    return path
