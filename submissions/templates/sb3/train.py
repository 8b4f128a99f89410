"""Train a policy with Stable-Baselines3 and save it beside this file: model.zip and vecnormalize.pkl.

    python train.py --steps 1000000
    glbench submit check FOLDER

Nothing of this file runs in an evaluation. It is part of the submission, so that others can train again.
"""

import argparse
import time
from pathlib import Path

import gymnasium
from stable_baselines3 import PPO
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

HERE = Path(__file__).parent
TASK = "glbench:glbench/GreenhouseReal-v1"  # its training split; choose between policies with split="validation"


def main():
    """Train for ``--steps`` control steps; 0 saves a policy that has learned nothing, which is enough to try everything out."""
    parser = argparse.ArgumentParser(description="Train a policy and save it beside this file.")
    parser.add_argument("--steps", type=int, default=200_000, help="control steps of all environments together")
    parser.add_argument("--seed", type=int, default=1)
    wanted = parser.parse_args()
    began = time.monotonic()
    envs = VecNormalize(DummyVecEnv([lambda: Monitor(gymnasium.make(TASK)) for _ in range(4)]), gamma=0.99)
    model = PPO("MlpPolicy", envs, gamma=0.99, seed=wanted.seed, device="cpu")
    if wanted.steps:
        model.learn(wanted.steps)
    model.save(HERE / "model.zip")
    envs.save(str(HERE / "vecnormalize.pkl"))
    hours = (time.monotonic() - began) / 3600
    print(
        f"Saved model.zip and vecnormalize.pkl. For submission.toml: steps = {model.num_timesteps}, wall_hours = {hours:.2f}"
    )


if __name__ == "__main__":
    main()
