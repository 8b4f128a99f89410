"""A model saved by Stable-Baselines3: no code, deterministic predictions, VecNormalize's statistics, memory of recurrent policies.

A ``model.zip`` holds pickles, and unpickling runs code of whoever wrote the file. It happens here, when the agent is made, which is where a
submission in Python would run its code, too: inside the sandbox, if there is one. ``sb3_archive`` reads all it can before that.
"""

from __future__ import annotations

import pickle
import zipfile
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from glbench.agents.formats.normalising import Normalise, normaliser
from glbench.agents.formats.packages import need
from glbench.agents.formats.policy import PolicyAgent
from glbench.agents.formats.quiet import without_warnings
from glbench.agents.formats.rows import EvenRows, Rows
from glbench.agents.formats.sb3_archive import Algorithm, Archive, archive_data, read_archive
from glbench.agents.isolation import last_line
from glbench.errors import SubmissionError

if TYPE_CHECKING:
    from pathlib import Path

    from glbench.agents.identity import Identity
    from glbench.tasks import TaskCard

_FAILURES = (
    RuntimeError,
    ValueError,
    KeyError,
    TypeError,
    AttributeError,
    ImportError,
    AssertionError,
    EOFError,
    OSError,
)


def sb3_agent(submission: Identity, task: TaskCard) -> PolicyAgent:
    """The agent of a saved model; torch uses one thread from here on, since bits depend on the number of threads.

    Raises
    ------
    SubmissionError
        When a package is missing, the file cannot be used, or the model does not fit the task.
    """
    file = submission.entry
    archive = read_archive(file)
    complaints = space_complaints(archive, task, file.name)
    complaints += statistics_complaints(archive, submission)
    if complaints:
        raise SubmissionError(" ".join(complaints))
    what = f"The {archive.algorithm.name} model {file.name}"
    torch = need("torch", what)
    need(archive.algorithm.module, what)
    torch.set_num_threads(1)
    columns = len(task.observations)
    normalise: Normalise = normaliser(submission, columns)
    policy = _load(archive.algorithm, file)
    _check_bounds(policy.action_space, task, file.name)
    if archive.algorithm.recurrent:
        state = _state_width(policy)
        return PolicyAgent(EvenRows(_recurrent(policy, columns), columns + state), normalise, len(task.actions), state)
    return PolicyAgent(EvenRows(_plain(policy), columns), normalise, len(task.actions))


def space_complaints(archive: Archive, task: TaskCard, name: str) -> list[str]:
    """What does not fit between the model and ``task``, one sentence each."""
    columns, actions = len(task.observations), len(task.actions)
    found = []
    if archive.columns is None:
        found.append(f"{name} was trained on {archive.columns_words}; the task shows a row of {columns} columns.")
    elif archive.columns != columns:
        found.append(
            f"{name} sees {archive.columns} columns, the task shows {columns} ({', '.join(task.observation_names[:3])}, ...): "
            "it was trained on another task or with a wrapper around the environment. Train it on the task's own observations."
        )
    if archive.actions is None:
        found.append(
            f"The actions of {name} ({archive.algorithm.name}) are {archive.actions_words}; the task wants {actions} real numbers at once. "
            "Use an algorithm for continuous actions, such as PPO or SAC, or write a Python agent that translates."
        )
    elif archive.actions != actions:
        found.append(
            f"{name} gives {archive.actions} actions, the task has {actions} ({', '.join(task.action_names)})."
        )
    return found


def statistics_complaints(archive: Archive, submission: Identity) -> list[str]:
    """Whether the statistics are there that the model was trained with."""
    given = submission.statistics is not None or (
        submission.card is not None and submission.card.normalisation is not None
    )
    if not archive.normalised or given:
        return []
    name = submission.entry.name
    return [
        f"{name} was trained with VecNormalize, and its statistics are missing: without them it sees numbers that it never met. "
        f'Save them with env.save("vecnormalize.pkl") and put the file beside {name}.'
    ]


def _load(algorithm: Algorithm, file: Path) -> Any:
    """The policy alone: no buffers, no optimisers, and of the pickles only those that it is built from."""
    saving = need("stable_baselines3.common.save_util", f"The {algorithm.name} model {file.name}")
    unneeded = dict.fromkeys(
        set(archive_data(file)) - {"policy_class", "observation_space", "action_space", "policy_kwargs", "use_sde"}
    )
    try:
        with without_warnings():
            data, parameters, _ = saving.load_from_zip_file(file, device="cpu", custom_objects=unneeded)
            settings = {**data["policy_kwargs"], "optimizer_class": _NoOptimiser, "optimizer_kwargs": {}}
            spaces = data["observation_space"], data["action_space"]
            if algorithm.name == "ARS":  # finds its weights without gradients and has no schedule of learning
                policy = data["policy_class"](*spaces, **data["policy_kwargs"])
            else:
                if algorithm.on_policy:
                    settings["use_sde"] = data["use_sde"]
                policy = data["policy_class"](*spaces, _never, **settings)
            policy.load_state_dict(parameters["policy"])
    except (*_FAILURES, pickle.UnpicklingError, zipfile.BadZipFile) as error:
        msg = (
            f"{file.name} cannot be loaded by Stable-Baselines3: {last_line(error)}. A model with network classes of your own "
            "needs a Python agent that brings them along; one of another version can be loaded and saved again there."
        )
        raise SubmissionError(msg) from error
    policy.set_training_mode(False)
    return policy


class _NoOptimiser:
    """Stands where a policy wants the optimiser of its training; making a real one takes seconds."""

    def __init__(self, *_: object, **__: object) -> None:
        self.param_groups: list[object] = []


def _never(_progress: float) -> float:
    return 0.0


def _check_bounds(space: Any, task: TaskCard, name: str) -> None:
    low, high = np.asarray(space.low, dtype=float), np.asarray(space.high, dtype=float)
    if np.array_equal(low, [action.low for action in task.actions]) and np.array_equal(
        high, [action.high for action in task.actions]
    ):
        return
    msg = (
        f"The actions of {name} lie between {low.min():g} and {high.max():g}, those of the task between {task.actions[0].low:g} and "
        f"{task.actions[0].high:g}: it was trained with another actuation or behind a wrapper that rescales."
    )
    raise SubmissionError(msg)


def _plain(policy: Any) -> Any:
    def function(rows: Rows) -> NDArray[np.floating]:
        actions: NDArray[np.floating] = policy.predict(rows, deterministic=True)[0]
        return actions

    return function


def _state_width(policy: Any) -> int:
    layers, _, width = policy.lstm_hidden_state_shape
    return int(2 * layers * width)


def _recurrent(policy: Any, columns: int) -> Any:
    """The policy with hidden and cell state as further columns of each row."""
    layers, _, width = policy.lstm_hidden_state_shape

    def function(rows: Rows) -> NDArray[np.floating]:
        n = len(rows)
        before = rows[:, columns:].reshape(n, 2, layers, width).transpose(1, 2, 0, 3)
        state = (np.ascontiguousarray(before[0]), np.ascontiguousarray(before[1]))
        actions, after = policy.predict(
            rows[:, :columns], state=state, episode_start=np.zeros(n, dtype=bool), deterministic=True
        )
        columns_after = np.stack(after).transpose(2, 0, 1, 3).reshape(n, -1)
        return np.concatenate([actions, columns_after], axis=1)

    return function
