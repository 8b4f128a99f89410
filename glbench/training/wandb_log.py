"""Weights & Biases as a listener. Works offline too: ``WANDB_MODE=offline``, and ``wandb sync`` later."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from glbench.errors import TrainingError
from glbench.training.periodic_evaluation import CurvePoint, Listener, Progress
from glbench.training.sweep import Search

_NOT_INSTALLED = (
    'Weights & Biases is not installed. Install it with `pip install "glbench[train,wandb]"`, '
    "or in a checkout with `uv sync --inexact --extra train --extra wandb`."
)
_NOT_IN_AN_ID = re.compile(r"[^A-Za-z0-9_-]")


class WandbListener(Listener):
    """Logs evaluations and speed to a run of Weights & Biases.

    ``name`` is that of the run, which a run of that name is continued under; ``None`` in a sweep, which names its trials itself. ``config``
    are settings to show beside it, ``folder`` is where its files go. Raises ``TrainingError`` when the package is not installed, or no run
    can be started (not logged in, no network).
    """

    def __init__(self, name: str | None, config: dict[str, Any], folder: Path) -> None:
        try:
            import wandb
        except ImportError as error:
            raise TrainingError(_NOT_INSTALLED) from error
        folder.mkdir(parents=True, exist_ok=True)
        fixed: dict[str, Any] = {} if name is None else {"name": name, "id": _NOT_IN_AN_ID.sub("-", name), "resume": "allow"}
        try:
            self.run = wandb.init(project="glbench", dir=str(folder), config=config, **fixed)
        except (wandb.errors.Error, OSError) as error:
            msg = f"Weights & Biases cannot start a run: {error} Log in with `wandb login`, or set WANDB_MODE=offline."
            raise TrainingError(msg) from error

    def on_progress(self, progress: Progress) -> None:
        """Speed and the reward of the last seasons."""
        values: dict[str, float] = {"steps": progress.steps, "steps_per_second": progress.steps_per_second}
        if progress.season_reward is not None:
            values["season_reward"] = progress.season_reward
        self.run.log(values)

    def on_evaluation(self, point: CurvePoint) -> None:
        """What an evaluation gave."""
        sums = {f"evaluation/{name}": value for name, value in point.result.sums.items()}
        self.run.log({"steps": point.steps, **sums})
        if point.is_best:
            self.run.summary["best_reward"] = point.result.reward

    def close(self) -> None:
        """End the run."""
        self.run.finish()


def wandb_sweep(search: Search, folder: Path) -> None:
    """Run the search as a sweep of Weights & Biases, which then chooses the trials; needs an account and the network.

    Raises ``TrainingError`` when the package is not installed or the service cannot be reached.
    """
    try:
        import wandb
    except ImportError as error:
        raise TrainingError(_NOT_INSTALLED) from error
    from glbench.tasks import get_task
    from glbench.training.run import train
    from glbench.training.sweep import base_settings, with_choices

    settings, task = base_settings(search), get_task(search.task)

    def trial() -> None:
        listener = WandbListener(None, {}, folder)
        try:
            trial_settings = with_choices(settings, dict(listener.run.config), search.steps)
            train(
                task, trial_settings, folder / str(listener.run.id), seed=search.seed, resume=True, tensorboard=False, listeners=[listener]
            )
        finally:
            listener.close()

    try:
        wandb.agent(wandb.sweep(search.wandb_config(), project="glbench"), function=trial, count=search.total, project="glbench")
    except (wandb.errors.Error, OSError) as error:
        msg = f"Weights & Biases cannot run the sweep: {error} Log in with `wandb login`, or run it here without --wandb."
        raise TrainingError(msg) from error
