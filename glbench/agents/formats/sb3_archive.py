"""What a ``model.zip`` of Stable-Baselines3 says about itself, read without unpickling anything.

The archive holds ``data``, a JSON file in which settings stand in the open and Python objects as pickles with a description. Which
algorithm it was is not written there; each has settings that the others lack.
"""

from __future__ import annotations

import json
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from glbench.errors import SubmissionError

_RECURRENT = b"lstm_actor"
"""Begins the names of some weights of recurrent policies; nothing in their settings tells them apart."""
_VERSION = "_stable_baselines3_version"


@dataclass(frozen=True)
class Algorithm:
    """An algorithm, its package, whether it learns from its own policy's steps only, and whether that policy remembers."""

    name: str
    module: str
    on_policy: bool = False
    recurrent: bool = False


_SB3, _CONTRIB = "stable_baselines3", "sb3_contrib"
ALGORITHMS = {
    algorithm.name: algorithm
    for algorithm in (
        Algorithm("PPO", _SB3, on_policy=True),
        Algorithm("A2C", _SB3, on_policy=True),
        Algorithm("SAC", _SB3),
        Algorithm("TD3", _SB3),
        Algorithm("DDPG", _SB3),
        Algorithm("DQN", _SB3),
        Algorithm("RecurrentPPO", _CONTRIB, on_policy=True, recurrent=True),
        Algorithm("TQC", _CONTRIB),
        Algorithm("TRPO", _CONTRIB, on_policy=True),
        Algorithm("CrossQ", _CONTRIB),
        Algorithm("ARS", _CONTRIB),
        Algorithm("QRDQN", _CONTRIB),
        Algorithm("MaskablePPO", _CONTRIB, on_policy=True),
    )
}
# In this order: the first whose settings are all there. What distinguishes an algorithm from those below it comes first.
_SIGNS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("TQC", ("top_quantiles_to_drop_per_net", "target_entropy")),
    ("CrossQ", ("target_entropy", "policy_delay")),
    ("SAC", ("target_entropy",)),
    ("TD3", ("target_policy_noise", "policy_delay")),
    ("QRDQN", ("exploration_initial_eps", "n_quantiles")),
    ("DQN", ("exploration_initial_eps",)),
    ("TRPO", ("cg_max_steps",)),
    ("ARS", ("n_delta",)),
    ("PPO", ("clip_range", "gae_lambda")),
    ("A2C", ("gae_lambda", "n_steps")),
)


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
    """Read what ``file`` says about itself.

    Raises
    ------
    SubmissionError
        When it is no model of Stable-Baselines3, or of an algorithm that cannot be told.
    """
    data = archive_data(file)
    with zipfile.ZipFile(file) as archive:
        names = archive.namelist()
        recurrent = _RECURRENT in archive.read("policy.pth")
        version = archive.read(_VERSION).decode(errors="replace") if _VERSION in names else "unknown"
    columns, columns_words = _space(data.get("observation_space"))
    actions, actions_words = _space(data.get("action_space"))
    return Archive(
        algorithm=_algorithm(data, file, recurrent=recurrent),
        columns=columns,
        columns_words=columns_words,
        actions=actions,
        actions_words=actions_words,
        # The last observation as it was before normalisation is kept if and only if there was one.
        normalised=data.get("_last_original_obs") is not None,
        steps=int(data.get("num_timesteps") or 0),
        version=version,
    )


def archive_data(file: Path) -> dict[str, Any]:
    """The settings in a saved model; Python objects among them are left as descriptions of pickles.

    Raises
    ------
    SubmissionError
        When it is no model of Stable-Baselines3.
    """
    how = 'A model is saved with: model.save("model.zip").'
    try:
        with zipfile.ZipFile(file) as archive:
            lacking = {"data", "policy.pth"} - set(archive.namelist())
            if lacking:
                what = "is an archive, but no model of Stable-Baselines3: it lacks"
                msg = f"{file.name} {what} {' and '.join(sorted(lacking))}. {how}"
                raise SubmissionError(msg)
            data = json.loads(archive.read("data"))
    except (OSError, zipfile.BadZipFile, ValueError) as error:
        msg = f"{file.name} cannot be read as a model of Stable-Baselines3 ({error}). It may have been cut. {how}"
        raise SubmissionError(msg) from error
    if not isinstance(data, dict):
        msg = f"{file.name} cannot be read as a model of Stable-Baselines3 (its settings are no table). {how}"
        raise SubmissionError(msg)
    return data


def _algorithm(data: dict[str, Any], file: Path, *, recurrent: bool) -> Algorithm:
    name = next((name for name, signs in _SIGNS if all(sign in data for sign in signs)), None)
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
