"""Training of agents, the tuning of rules and policies, and the export of what was trained to files that need numpy alone.

The only room that knows PyTorch, Stable-Baselines3 (extra ``train``) and, besides ``glbench.jax``, JAX (extra ``jax``); nothing else in
glbench but the command line imports it. Each kind of training loads what it needs itself. See docs/training.md.
"""

from typing import TYPE_CHECKING

from glbench.extras import lazy_names

if TYPE_CHECKING:
    from glbench.training.folder import Trained
    from glbench.training.periodic_evaluation import CurvePoint, Listener, Progress
    from glbench.training.run import train
    from glbench.training.settings import TrainingSettings, read_settings, shipped_settings
    from glbench.training.vec_env import make_vec_env
else:
    __getattr__ = lazy_names(__name__)

__all__ = [
    "CurvePoint", "Listener", "Progress", "Trained", "TrainingSettings", "make_vec_env", "read_settings", "shipped_settings", "train",
]  # fmt: skip
