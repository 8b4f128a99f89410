"""A trained policy in one small file without code in it, evaluated with numpy alone.

The file is an ``.npz`` of plain arrays (no pickles): weights, biases, normalisation of the observations, names of
observations and actions, and what it was trained on. ``glbench export`` writes it; docs/training.md lists the entries.
"""

from __future__ import annotations

import io
import itertools
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from glbench.agents.exact_math import ExactLinear, relu, silu, tanh
from glbench.arrays import ArrayFile, checked_facts
from glbench.errors import ShapeError, SubmissionError
from glbench.untrusted import MIB, quoted, read_regular

if TYPE_CHECKING:
    from glbench.tasks import TaskCard

Floats = NDArray[np.float64]
FORMAT = 1
ACTIVATIONS: dict[str, Callable[[Floats], Floats]] = {"SiLU": silu, "Tanh": tanh, "ReLU": relu}


@dataclass(frozen=True, eq=False)
class NetworkPolicy:
    """A multilayer perceptron from observations to actions, without noise.

    Attributes
    ----------
    task_id, delta
        The task that it was trained on, and half the width of that task's uncertainty.
    observation_names, action_names
        Columns of the observations and actions, in order.
    low, high
        Bounds of the actions.
    mean, scale, clip
        Observations are normalised to ``(x - mean) / scale``, within ``-clip`` to ``clip``.
    weights, biases
        Of the layers, ``(inputs, outputs)`` and ``(outputs,)``, float32.
    activation
        Between the layers: a name in ``ACTIVATIONS``.
    output
        ``"clip"``: the last layer is the action, cut to the bounds. ``"tanh"``: its tanh, stretched to the bounds.
    about
        How it was made, for people: algorithm, seed, steps, ...
    """

    task_id: str
    delta: float
    observation_names: tuple[str, ...]
    action_names: tuple[str, ...]
    low: Floats
    high: Floats
    mean: Floats
    scale: Floats
    clip: float
    weights: tuple[NDArray[np.float32], ...]
    biases: tuple[NDArray[np.float32], ...]
    activation: str
    output: Literal["clip", "tanh"]
    about: dict[str, str | int | float]

    def __post_init__(self) -> None:
        sizes = [len(self.observation_names), *(len(bias) for bias in self.biases)]
        shapes = [matrix.shape for matrix in self.weights]
        if not shapes or shapes != list(itertools.pairwise(sizes)) or sizes[-1] != len(self.action_names):
            msg = f"A policy of {sizes[0]} observations and {len(self.action_names)} actions cannot have layers of shapes {quoted(shapes)}."
            raise ShapeError(msg)
        sides = {name: getattr(self, name).shape for name in ("mean", "scale", "low", "high")}
        if list(sides.values()) != [(sizes[0],)] * 2 + [(sizes[-1],)] * 2:
            msg = f"A policy of {sizes[0]} observations and {sizes[-1]} actions cannot have the shapes {sides}."
            raise ShapeError(msg)
        if self.activation not in ACTIVATIONS or self.output not in ("clip", "tanh"):
            known = f"Known: {', '.join(ACTIVATIONS)}; clip, tanh."
            msg = f"Unknown activation {quoted(self.activation)} or output {quoted(self.output)}. {known}"
            raise ShapeError(msg)
        arrays: tuple[NDArray[np.floating[Any]], ...] = (
            self.low,
            self.high,
            self.mean,
            self.scale,
            *self.weights,
            *self.biases,
        )
        if not all(np.isfinite(array).all() for array in arrays):
            msg = "A policy has weights or bounds that are not finite."
            raise ShapeError(msg)
        if not ((self.scale > 0.0).all() and (self.low < self.high).all() and self.clip > 0.0):
            msg = "The policy has a scale or a clip of 0 or less, or a lower bound that is not below the upper bound."
            raise ShapeError(msg)
        layers = tuple(ExactLinear.of(matrix, bias) for matrix, bias in zip(self.weights, self.biases, strict=True))
        object.__setattr__(self, "_layers", layers)

    def act(self, observations: NDArray[np.floating[Any]]) -> Floats:
        """Actions ``(rows, actions)`` for ``observations`` ``(rows, observations)``: each row the same bits in any batch."""
        normalised = (observations.astype(np.float64) - self.mean) / self.scale
        x = np.clip(normalised, -self.clip, self.clip)
        layers: tuple[ExactLinear, ...] = self._layers  # type: ignore[attr-defined]
        between = ACTIVATIONS[self.activation]
        for layer in layers[:-1]:
            x = between(layer(x))
        x = layers[-1](x)
        if self.output == "tanh":
            x = self.low + 0.5 * (tanh(x) + 1.0) * (self.high - self.low)
        actions: Floats = np.clip(x, self.low, self.high)
        return actions

    def why_not(self, task: TaskCard) -> str | None:
        """Why this policy cannot act in ``task``, in words; ``None`` when it can."""
        if task.observation_names != self.observation_names:
            return f"it was trained on {_columns(self.observation_names)}, and {task.id} shows {_columns(task.observation_names)}"
        if task.action_names != self.action_names or [action.low for action in task.actions] != self.low.tolist():
            return f"its actions are not those of {task.id}"
        return None

    def to_bytes(self) -> bytes:
        """The policy as the bytes of its file; equal policies give equal bytes."""
        file = io.BytesIO()
        layers = {f"weight_{i}": matrix for i, matrix in enumerate(self.weights)}
        layers |= {f"bias_{i}": bias for i, bias in enumerate(self.biases)}
        np.savez_compressed(
            file,
            allow_pickle=False,
            format=np.int64(FORMAT),
            task_id=np.array(self.task_id),
            delta=np.float64(self.delta),
            observation_names=np.array(self.observation_names),
            action_names=np.array(self.action_names),
            low=self.low,
            high=self.high,
            mean=self.mean,
            scale=self.scale,
            clip=np.float64(self.clip),
            activation=np.array(self.activation),
            output=np.array(self.output),
            about=np.array(json.dumps(self.about, sort_keys=True)),
            **layers,
        )
        return file.getvalue()

    @classmethod
    def from_bytes(cls, data: bytes, name: str) -> NetworkPolicy:
        """Read what ``to_bytes`` wrote; ``name`` is for messages.

        Raises
        ------
        SubmissionError
            When the bytes are no policy, or a damaged one.
        """
        try:
            file = ArrayFile.of(data)
            if file.integer("format") != FORMAT:
                msg = f"The policy {name} has format {file.integer('format')}; this version of glbench reads format {FORMAT}."
                raise SubmissionError(msg)
            return cls(**_fields(file))
        except (ValueError, ShapeError) as error:
            msg = f"{name} is not a glbench policy, or is damaged: {error}. Write it again with glbench export."
            raise SubmissionError(msg) from error


def read_policy(file: Path) -> NetworkPolicy:
    """The policy in ``file``.

    Raises
    ------
    SubmissionError
        When it cannot be read.
    """
    try:
        data = read_regular(file, 64 * MIB)
    except OSError as error:
        msg = f"Cannot read the policy {file}: {error.strerror or error}."
        raise SubmissionError(msg) from error
    return NetworkPolicy.from_bytes(data, str(file))


def _fields(file: ArrayFile) -> dict[str, Any]:
    layers = range(file.count("weight_"))
    return {
        "task_id": file.text("task_id"),
        "delta": file.number("delta"),
        "observation_names": file.texts("observation_names"),
        "action_names": file.texts("action_names"),
        **{name: file.floats(name, 1) for name in ("low", "high", "mean", "scale")},
        "clip": file.number("clip"),
        "weights": tuple(file.floats(f"weight_{layer}", 2, np.float32) for layer in layers),
        "biases": tuple(file.floats(f"bias_{layer}", 1, np.float32) for layer in layers),
        "activation": file.text("activation"),
        "output": file.text("output"),
        "about": checked_facts(file.table("about")),
    }


def _columns(names: tuple[str, ...]) -> str:
    return f"{len(names)} observations ({', '.join(names[:3])}, ...)"
