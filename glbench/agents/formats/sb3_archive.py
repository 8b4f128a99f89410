"""What a ``model.zip`` of Stable-Baselines3 says about itself, read without unpickling anything.

The archive holds ``data``, a JSON file in which settings stand in the open and Python objects as pickles with a description. Which
algorithm it was is not written there; each has settings that the others lack.
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
from typing import IO, Any

from glbench.agents.formats.archives import opened_archive
from glbench.errors import SubmissionError

_RECURRENT = b"lstm_actor"
"""Begins the names of some weights of recurrent policies; nothing in their settings tells them apart."""
_HOW = 'A model is saved with: model.save("model.zip").'
_PIECE, _LONGEST_VERSION, _LONGEST_SETTINGS, _LONGEST_WEIGHTS = 2**20, 2**20, 2**26, 2**29
"""Bytes: what is read at once, and what of an archive is read at most."""
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
    with _opened(file) as archive:
        recurrent = _holds(archive, "policy.pth", _RECURRENT)
        version = _content(archive, _VERSION, _LONGEST_VERSION) if _VERSION in archive.namelist() else b"unknown"
    try:
        columns, columns_words = _space(data.get("observation_space"))
        actions, actions_words = _space(data.get("action_space"))
        steps = int(data.get("num_timesteps") or 0)
    except (TypeError, ValueError, OverflowError) as error:
        msg = f"{file.name} cannot be read as a model of Stable-Baselines3: what it says of its spaces is no number ({error}). {_HOW}"
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
    """The settings in a saved model; Python objects among them are left as descriptions of pickles.

    Raises
    ------
    SubmissionError
        When it is no model of Stable-Baselines3.
    """
    with _opened(file) as archive:
        lacking = {"data", "policy.pth"} - set(archive.namelist())
        if lacking:
            what = "is an archive, but no model of Stable-Baselines3: it lacks"
            msg = f"{file.name} {what} {' and '.join(sorted(lacking))}. {_HOW}"
            raise SubmissionError(msg)
        data = json.loads(_content(archive, "data", _LONGEST_SETTINGS))
    if not isinstance(data, dict):
        msg = f"{file.name} cannot be read as a model of Stable-Baselines3 (its settings are no table). {_HOW}"
        raise SubmissionError(msg)
    return data


@contextmanager
def _opened(file: Path) -> Iterator[zipfile.ZipFile]:
    """The archive; whatever is wrong with it while it is read becomes a ``SubmissionError``."""
    try:
        with opened_archive(file) as archive:
            yield archive
    except (OSError, EOFError, zipfile.BadZipFile, zlib.error, lzma.LZMAError, ValueError, RuntimeError) as error:
        # RuntimeError: encrypted, packed in an unknown way, or settings that are nested without end.
        said = str(error).rstrip(".") or type(error).__name__
        msg = f"{file.name} cannot be read as a model of Stable-Baselines3 ({said}). It may have been cut. {_HOW}"
        raise SubmissionError(msg) from error


def _content(archive: zipfile.ZipFile, name: str, longest: int) -> bytes:
    """A file of the archive, which may be packed so that it would fill the memory."""
    with archive.open(name) as stream:
        content = b"".join(_pieces(stream, longest + 1))
    if len(content) > longest:
        msg = f"'{name}' in it is longer than {longest / 2**20:,.0f} MiB"
        raise ValueError(msg)
    return content


def _holds(archive: zipfile.ZipFile, name: str, word: bytes) -> bool:
    """Whether ``word`` stands somewhere in a file of the archive."""
    before = b""
    with archive.open(name) as stream:
        for piece in _pieces(stream, _LONGEST_WEIGHTS):
            if word in before + piece:
                return True
            before = piece[-len(word) :]
    return False


def _pieces(stream: IO[bytes], most: int) -> Iterator[bytes]:
    while most > 0 and (piece := stream.read(min(_PIECE, most))):
        most -= len(piece)
        yield piece


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
