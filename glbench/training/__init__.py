"""Training of agents with Stable-Baselines3, and their export to files that need numpy alone.

The only room that knows PyTorch and Stable-Baselines3 (extra ``train``); nothing else in glbench but the command line imports it.
See docs/training.md.
"""

from __future__ import annotations

from glbench.training.probe import CurvePoint, Listener, Progress
from glbench.training.run import Trained, train
from glbench.training.settings import TrainingSettings, read_settings, shipped_settings
from glbench.training.vec_env import make_vec_env

__all__ = [
    "CurvePoint",
    "Listener",
    "Progress",
    "Trained",
    "TrainingSettings",
    "make_vec_env",
    "read_settings",
    "shipped_settings",
    "train",
]
