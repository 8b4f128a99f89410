"""A model saved by Stable-Baselines3: no code, deterministic predictions, VecNormalize's statistics, memory of recurrent policies.

A ``model.zip`` holds ``data``, a JSON file with settings in the open and Python objects as pickles with a description. Which
algorithm it was is not written there; each has settings that the others lack. ``read_archive`` reads all of this without unpickling.
Unpickling runs code of whoever wrote the file. It happens when the agent is made, which is where a submission in Python would run its
code, too: inside the sandbox, if there is one.
"""

from __future__ import annotations

import json
import lzma
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from glbench.agents.saved_policies import DAMAGED, EvenRows, PolicyAgent, Rows, normaliser, without_warnings
from glbench.errors import SubmissionError, last_line, refuse
from glbench.extras import need
from glbench.untrusted import opened_archive

if TYPE_CHECKING:
    from glbench.agents.identity import Identity
    from glbench.tasks import TaskCard


_RECURRENT = b"lstm_actor"  # Begins the names of some weights of recurrent policies; nothing in their settings tells them apart
_HOW = 'A model is saved with: model.save("model.zip").'
_PIECE, _LONGEST_VERSION, _LONGEST_SETTINGS, _LONGEST_WEIGHTS = 2**20, 2**20, 2**26, 2**29
"""Bytes: what is read at once, and what of an archive is read at most."""
_VERSION = "_stable_baselines3_version"
_SB3, _CONTRIB = "stable_baselines3", "sb3_contrib"


@dataclass(frozen=True)
class Algorithm:
    """An algorithm, its package, whether it learns from its own policy's steps only, and whether that policy remembers.

    ``signs`` are settings that tell it from those below it in ``ALGORITHMS``: of a saved model the first that has all of them is its own.
    """

    name: str
    module: str
    signs: tuple[str, ...] = ()
    on_policy: bool = False
    recurrent: bool = False


ALGORITHMS = {
    algorithm.name: algorithm
    for algorithm in (
        Algorithm("TQC", _CONTRIB, ("top_quantiles_to_drop_per_net", "target_entropy")),
        Algorithm("CrossQ", _CONTRIB, ("target_entropy", "policy_delay")),
        Algorithm("SAC", _SB3, ("target_entropy",)),
        Algorithm("TD3", _SB3, ("target_policy_noise", "policy_delay")),
        Algorithm("DDPG", _SB3),
        Algorithm("QRDQN", _CONTRIB, ("exploration_initial_eps", "n_quantiles")),
        Algorithm("DQN", _SB3, ("exploration_initial_eps",)),
        Algorithm("TRPO", _CONTRIB, ("cg_max_steps",), on_policy=True),
        Algorithm("ARS", _CONTRIB, ("n_delta",)),
        Algorithm("PPO", _SB3, ("clip_range", "gae_lambda"), on_policy=True),
        Algorithm("A2C", _SB3, ("gae_lambda", "n_steps"), on_policy=True),
        Algorithm("RecurrentPPO", _CONTRIB, on_policy=True, recurrent=True),
        Algorithm("MaskablePPO", _CONTRIB, on_policy=True),
    )
}


@dataclass(frozen=True)
class Archive:
    """A saved model: algorithm, spaces, whether it was trained with VecNormalize, steps of training, version.

    ``columns`` is the width of its observations, ``None`` when they are no row of numbers; ``actions`` the width of its actions,
    ``None`` when they are no row of real numbers; ``*_words`` describe both spaces.
    """

    algorithm: Algorithm
    columns: int | None
    columns_words: str
    actions: int | None
    actions_words: str
    normalised: bool
    steps: int
    version: str


def read_archive(file: Path) -> Archive:
    """What ``file`` says of itself. Raises ``SubmissionError`` when it is not a model of Stable-Baselines3, or its algorithm is unclear."""
    data = archive_data(file)
    with _opened(file) as archive:
        recurrent, before = False, b""
        with archive.open("policy.pth") as stream:
            for piece in _pieces(stream, _LONGEST_WEIGHTS):
                if _RECURRENT in before + piece:
                    recurrent = True
                    break
                before = piece[-len(_RECURRENT) :]
        version = _content(archive, _VERSION, _LONGEST_VERSION) if _VERSION in archive.namelist() else b"unknown"
    try:
        columns, columns_words = _space(data.get("observation_space"))
        actions, actions_words = _space(data.get("action_space"))
        steps = int(data.get("num_timesteps") or 0)
    except (TypeError, ValueError, OverflowError) as error:
        msg = f"{file.name} cannot be read as a model of Stable-Baselines3: what it says of its spaces is not a number ({error}). {_HOW}"
        raise SubmissionError(msg) from error
    return Archive(
        algorithm=_algorithm(data, file, recurrent=recurrent),
        columns=columns,
        columns_words=columns_words,
        actions=actions,
        actions_words=actions_words,
        # The last observation as it was before normalisation is kept if and only if there was one.
        normalised=data.get("_last_original_obs") is not None,
        steps=steps,
        version=version.decode(errors="replace"),
    )


def archive_data(file: Path) -> dict[str, Any]:
    """The settings in a saved model, pickled objects described only. Raises ``SubmissionError`` when it is none of Stable-Baselines3."""
    with _opened(file) as archive:
        lacking = {"data", "policy.pth"} - set(archive.namelist())
        if lacking:
            what = "is an archive, but no model of Stable-Baselines3: it lacks"
            refuse(f"{file.name} {what} {' and '.join(sorted(lacking))}. {_HOW}", SubmissionError)
        data = json.loads(_content(archive, "data", _LONGEST_SETTINGS))
    if not isinstance(data, dict):
        refuse(f"{file.name} cannot be read as a model of Stable-Baselines3 (its settings are no table). {_HOW}", SubmissionError)
    return data


@contextmanager
def _opened(file: Path) -> Iterator[zipfile.ZipFile]:
    """The archive; whatever is wrong with it while it is read becomes a ``SubmissionError``."""
    try:
        with opened_archive(file) as archive:
            yield archive
    except (OSError, EOFError, zipfile.BadZipFile, zlib.error, lzma.LZMAError, ValueError, RuntimeError) as error:
        # RuntimeError: encrypted, packed in an unknown way, or settings that are nested without end.
        reason = str(error).rstrip(".") or type(error).__name__
        msg = f"{file.name} cannot be read as a model of Stable-Baselines3 ({reason}). It may have been cut. {_HOW}"
        raise SubmissionError(msg) from error


def _content(archive: zipfile.ZipFile, name: str, longest: int) -> bytes:
    """A file of the archive, which may be packed so that it would fill the memory."""
    with archive.open(name) as stream:
        content = b"".join(_pieces(stream, longest + 1))
    if len(content) > longest:
        refuse(f"'{name}' in it is longer than {longest / 2**20:,.0f} MiB")
    return content


def _pieces(stream: IO[bytes], most: int) -> Iterator[bytes]:
    while most > 0 and (piece := stream.read(min(_PIECE, most))):
        most -= len(piece)
        yield piece


def _algorithm(data: dict[str, Any], file: Path, *, recurrent: bool) -> Algorithm:
    name = next((one.name for one in ALGORITHMS.values() if one.signs and all(sign in data for sign in one.signs)), None)
    if name is None:
        msg = (
            f"{file.name} was saved by an algorithm that glbench does not know. It knows {', '.join(ALGORITHMS)}. "
            "For another one write a Python agent that loads the model, or export its policy as TorchScript."
        )
        raise SubmissionError(msg)
    if name == "TD3" and data["policy_delay"] == 1 and data.get("target_noise_clip") == 0.0:
        name = "DDPG"
    if name == "PPO" and recurrent:
        name = "RecurrentPPO"
    policy = data.get("policy_class")
    if name == "PPO" and isinstance(policy, dict) and "maskable" in str(policy.get("__module__", "")):
        name = "MaskablePPO"
    return ALGORITHMS[name]


def _space(described: object) -> tuple[int | None, str]:
    """Width of a space that is a row of real numbers, and the space in words."""
    if not isinstance(described, dict):
        return None, "nothing that can be read"
    kind = str(described.get(":type:", "")).rpartition(".")[2].rstrip("'>")
    shape = described.get("_shape", described.get("shape"))
    if kind == "Box" and isinstance(shape, list) and len(shape) == 1:
        return int(shape[0]), f"{shape[0]} columns"
    if kind == "Box":
        return None, f"an array of shape ({', '.join(str(size) for size in shape or ())})"
    words = {"Discrete": "one choice out of several (Discrete)", "MultiDiscrete": "several choices (MultiDiscrete)"}
    return None, words.get(kind, f"a {kind} space")


def sb3_agent(submission: Identity, task: TaskCard) -> PolicyAgent:
    """The agent of a saved model; torch uses one thread from here on, since bits depend on the number of threads.

    Raises ``SubmissionError`` when a package is missing, the file cannot be used, or the model does not fit the task.
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
    normalise = normaliser(submission, columns)
    policy = _load(archive.algorithm, file)
    low, high = (np.asarray(bound, dtype=float) for bound in (policy.action_space.low, policy.action_space.high))
    if not all(map(np.array_equal, (low, high), task.action_bounds)):
        msg = (
            f"The actions of {file.name} lie between {low.min():g} and {high.max():g}, those of the task between {task.actions[0].low:g} "
            f"and {task.actions[0].high:g}: it was trained with another actuation or behind a wrapper that rescales."
        )
        raise SubmissionError(msg)
    if archive.algorithm.recurrent:
        layers, _, width = policy.lstm_hidden_state_shape
        state = int(2 * layers * width)
        return PolicyAgent(EvenRows(_recurrent(policy, columns), columns + state), normalise, len(task.actions), state)

    def function(rows: Rows) -> NDArray[np.floating]:
        actions: NDArray[np.floating] = policy.predict(rows, deterministic=True)[0]
        return actions

    return PolicyAgent(EvenRows(function, columns), normalise, len(task.actions))


def space_complaints(archive: Archive, task: TaskCard, name: str) -> list[str]:
    """What does not fit between the model and ``task``, one sentence each."""
    columns, actions = len(task.observations), len(task.actions)
    complaints = []
    if archive.columns is None:
        complaints.append(f"{name} was trained on {archive.columns_words}; the task shows a row of {columns} columns.")
    elif archive.columns != columns:
        complaints.append(
            f"{name} sees {archive.columns} columns, the task shows {columns} ({', '.join(task.observation_names[:3])}, ...): "
            "it was trained on another task or with a wrapper around the environment. Train it on the task's own observations."
        )
    if archive.actions is None:
        complaints.append(
            f"The actions of {name} ({archive.algorithm.name}) are {archive.actions_words}; the task wants {actions} real numbers at once. "
            "Use an algorithm for continuous actions, such as PPO or SAC, or write a Python agent that translates."
        )
    elif archive.actions != actions:
        complaints.append(f"{name} gives {archive.actions} actions, the task has {actions} ({', '.join(task.action_names)}).")
    return complaints


def statistics_complaints(archive: Archive, submission: Identity) -> list[str]:
    """Whether the statistics are there that the model was trained with."""
    card = submission.card
    by_card = card is not None and card.normalisation is not None
    if not archive.normalised or submission.statistics is not None or by_card:
        return []
    name = submission.entry.name
    return [
        f"{name} was trained with VecNormalize, and its statistics are missing: without them it sees numbers that it never met. "
        f'Save them with env.save("vecnormalize.pkl") and put the file beside {name}.'
    ]


def _load(algorithm: Algorithm, file: Path) -> Any:
    """The policy alone: no buffers, no optimisers, and of the pickles only those that it is built from."""
    saving = need("stable_baselines3.common.save_util", f"The {algorithm.name} model {file.name}")
    unneeded = dict.fromkeys(set(archive_data(file)) - {"policy_class", "observation_space", "action_space", "policy_kwargs", "use_sde"})
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
                policy = data["policy_class"](*spaces, lambda _progress: 0.0, **settings)
            policy.load_state_dict(parameters["policy"])
    except DAMAGED as error:
        msg = (
            f"{file.name} cannot be loaded by Stable-Baselines3: {last_line(error)}. A model with network classes of your own "
            "needs a Python agent that brings them along; one of another version can be loaded and saved again there."
        )
        raise SubmissionError(msg) from error
    policy.set_training_mode(False)
    return policy


class _NoOptimiser:
    """In the place of the optimiser of a policy's training; making a real one takes seconds."""

    def __init__(self, *_: object, **__: object) -> None:
        self.param_groups: list[object] = []


def _recurrent(policy: Any, columns: int) -> Any:
    """The policy with hidden and cell state as further columns of each row."""
    layers, _, width = policy.lstm_hidden_state_shape

    def function(rows: Rows) -> NDArray[np.floating]:
        n = len(rows)
        before = rows[:, columns:].reshape(n, 2, layers, width).transpose(1, 2, 0, 3)
        state = (np.ascontiguousarray(before[0]), np.ascontiguousarray(before[1]))
        actions, after = policy.predict(rows[:, :columns], state=state, episode_start=np.zeros(n, dtype=bool), deterministic=True)
        return np.concatenate([actions, np.stack(after).transpose(2, 0, 1, 3).reshape(n, -1)], axis=1)

    return function
