"""Trained policies, each in one small file without code in it, evaluated with numpy alone; and the agent that acts by them.

The file is an ``.npz`` of plain arrays (no pickles): weights, biases, normalisation of the observations, names of observations and
actions, and what it was trained on. ``glbench export`` writes it; docs/training.md lists the entries. A file of ``glbench train ppo``
holds such a network and what is before and behind it. Before it are traces, running means of observed columns, and a gated recurrent
unit (Cho et al., 2014): the policy's memory. Behind it, the network's output is the position that a control should have, and the action
moves the control there as fast as the task allows.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from glbench.agents import deterministic_math
from glbench.agents.card import LARGEST, SMALLEST_CLIP, SMALLEST_SCALE
from glbench.agents.controllers import controller
from glbench.agents.protocol import check_runs
from glbench.arrays import ArrayFile, Floats, checked_facts, packed
from glbench.errors import ShapeError, SubmissionError, refuse
from glbench.untrusted import MIB, quoted, read_regular, reason_of

if TYPE_CHECKING:
    from glbench.tasks import TaskCard

Layer = Callable[[Any], Any]
FORMAT = 1


class Arithmetic(NamedTuple):
    """What a policy computes with."""

    arrays: Any
    """numpy, or a namespace like it."""
    affine: Callable[[Any, Any], Layer]
    """From weights ``(inputs, outputs)`` and bias ``(outputs,)`` to a function of ``x`` that is ``x @ weights + bias``."""
    activations: Mapping[str, Callable[[Any], Any]]
    sigmoid: Callable[[Any], Any]


def affine(weights: Any, bias: Any) -> Layer:
    """``x @ weights + bias`` as a function of ``x``, for any kind of array."""
    return lambda x: x @ weights + bias


def hidden(layers: Sequence[Layer], x: Any, activation: Callable[[Any], Any]) -> Any:
    """Output of hidden layers, each followed by the activation."""
    for layer in layers:
        x = activation(layer(x))
    return x


def gru_step(input_gates: Any, memory_gates: Any, memory: Any, arithmetic: Arithmetic) -> Any:
    """The memory ``(rows, units)`` of a gated recurrent unit after a step.

    ``input_gates`` and ``memory_gates`` ``(rows, 3 * units)`` are what the affine maps of the input and of the memory give for the gates
    that keep and that reset, and for what is new.
    """
    keep, reset, new = arithmetic.arrays.split(input_gates, 3, -1)
    keep_too, reset_too, new_too = arithmetic.arrays.split(memory_gates, 3, -1)
    new = arithmetic.activations["Tanh"](new + arithmetic.sigmoid(reset + reset_too) * new_too)
    return new + arithmetic.sigmoid(keep + keep_too) * (memory - new)


def _silu(x: Any) -> Any:
    with np.errstate(over="ignore"):  # exp(-x) of a large negative x is infinite, and x / infinity is 0
        return x / (1.0 + np.exp(-x))


EXACT = Arithmetic(
    np,
    deterministic_math.ExactLinear.of,
    {"SiLU": deterministic_math.silu, "Tanh": deterministic_math.tanh, "ReLU": deterministic_math.relu},
    deterministic_math.sigmoid,
)
"""Gives each row the same bits in any batch and on any processor. Agents act by it."""
FAST = Arithmetic(np, affine, {"SiLU": _silu, "Tanh": np.tanh, "ReLU": deterministic_math.relu}, lambda x: 0.5 + 0.5 * np.tanh(0.5 * x))
"""Equals ``EXACT`` up to rounding and takes a fraction of the time. Trainings use it."""
ACTIVATIONS = EXACT.activations


@dataclass(frozen=True, eq=False)
class NetworkPolicy:
    """A multilayer perceptron from observations to actions, without noise."""

    task_id: str
    delta: float
    """``task_id`` and ``delta``: the task that it was trained on, and half the width of that task's uncertainty: above 1 where houses
    differ as measured."""
    observation_names: tuple[str, ...]
    action_names: tuple[str, ...]
    """``observation_names`` and ``action_names``: columns of the observations and actions, in order."""
    low: Floats
    high: Floats
    """``low`` and ``high``: bounds of the actions."""
    mean: Floats
    scale: Floats
    clip: float
    """``mean``, ``scale`` and ``clip``: observations are normalised to ``(x - mean) / scale``, within ``-clip`` to ``clip``."""
    weights: tuple[NDArray[np.float32], ...]
    biases: tuple[NDArray[np.float32], ...]
    """``weights`` and ``biases``: of the layers, ``(inputs, outputs)`` and ``(outputs,)``, float32."""
    activation: str
    """Between the layers: a name in ``ACTIVATIONS``."""
    output: Literal["clip", "tanh"]
    """``"clip"``: the last layer is the action, cut to the bounds. ``"tanh"``: its tanh, stretched to the bounds."""
    about: dict[str, str | int | float]
    """How it was made, for people: algorithm, seed, steps, ..."""
    arithmetic: Arithmetic = field(default=EXACT, repr=False)
    """What ``act`` computes with; not part of the file."""

    def __post_init__(self) -> None:
        sizes = [len(self.observation_names), *(len(bias) for bias in self.biases)]
        shapes = [matrix.shape for matrix in self.weights]
        if not shapes or shapes != list(itertools.pairwise(sizes)) or sizes[-1] != len(self.action_names):
            msg = f"A policy of {sizes[0]} observations and {len(self.action_names)} actions cannot have layers of shapes {quoted(shapes)}."
            raise ShapeError(msg)
        sides = {name: getattr(self, name).shape for name in ("mean", "scale", "low", "high")}
        if list(sides.values()) != [(sizes[0],)] * 2 + [(sizes[-1],)] * 2:
            refuse(f"A policy of {sizes[0]} observations and {sizes[-1]} actions cannot have the shapes {sides}.", ShapeError)
        if self.activation not in ACTIVATIONS or self.output not in ("clip", "tanh"):
            names = f"{', '.join(ACTIVATIONS)}; clip, tanh"
            refuse(f"Unknown activation {quoted(self.activation)} or output {quoted(self.output)}. Known: {names}.", ShapeError)
        for kind, columns in (("observation", self.observation_names), ("action", self.action_names)):
            if len(set(columns)) < len(columns):
                twice = next(name for name in columns if columns.count(name) > 1)
                refuse(f"A policy has the {kind} {quoted(twice)} {columns.count(twice)} times; each has a name of its own.", ShapeError)
        for what, values, columns, lowest in (
            ("mean", self.mean, self.observation_names, -LARGEST),
            ("scale", self.scale, self.observation_names, SMALLEST_SCALE),
            ("lower bound", self.low, self.action_names, -LARGEST),
            ("upper bound", self.high, self.action_names, -LARGEST),
        ):
            wrong = np.flatnonzero(~((values >= lowest) & (values <= LARGEST)))  # NaN as well
            if wrong.size:
                msg = f"The {what} of {quoted(columns[wrong[0]])} is {values[wrong[0]]:g}, expected {lowest:g} to {LARGEST:g}."
                raise ShapeError(msg)
        for is_right, msg in (
            (all(np.isfinite(array).all() for array in (*self.weights, *self.biases)), "A policy has weights that are not finite."),
            ((self.low < self.high).all(), "The policy has a lower bound that is not below the upper bound."),
            (self.clip >= SMALLEST_CLIP, f"The policy clips normalised observations at {self.clip:g}, expected {SMALLEST_CLIP:g} or more."),
            (0.0 <= self.delta <= LARGEST, f"The policy's delta is {self.delta:g}, expected 0 to {LARGEST:g}."),
        ):
            if not is_right:
                raise ShapeError(msg)
        layers = zip(self.weights, self.biases, strict=True)
        object.__setattr__(self, "_layers", [self.arithmetic.affine(matrix, bias) for matrix, bias in layers])

    def act(self, observations: NDArray[np.floating[Any]]) -> Floats:
        """Actions ``(rows, actions)`` for ``observations`` ``(rows, observations)``."""
        last: Layer = self._layers[-1]  # type: ignore[attr-defined]
        return self.bounded(last(self.hidden(self.normalised(observations))))

    def normalised(self, observations: NDArray[np.floating[Any]]) -> Floats:
        """What the first layer gets for observations, or for the first columns of them."""
        columns = observations.shape[1]
        return np.clip((observations.astype(np.float64) - self.mean[:columns]) / self.scale[:columns], -self.clip, self.clip)

    def hidden(self, x: Any) -> Any:
        """The last hidden layer ``(rows, hidden)`` for normalised observations."""
        return hidden(self._layers[:-1], x, self.arithmetic.activations[self.activation])  # type: ignore[attr-defined]

    def bounded(self, x: Floats) -> Floats:
        """Actions for the output ``x`` of the last layer."""
        if self.output == "tanh":
            tanh = self.arithmetic.activations["Tanh"]
            x = self.low + 0.5 * (tanh(x) + 1.0) * (self.high - self.low)
        return np.clip(x, self.low, self.high)

    def why_not(self, task: TaskCard) -> str | None:
        """Why this policy cannot act in ``task``, in words; ``None`` when it can."""
        return _mismatch(self.observation_names, self.action_names, self.low, task)

    def to_bytes(self) -> bytes:
        """The policy as the bytes of its file; equal policies give equal bytes."""
        layers = {f"weight_{i}": matrix for i, matrix in enumerate(self.weights)}
        layers |= {f"bias_{i}": bias for i, bias in enumerate(self.biases)}
        return packed(
            format=np.int64(FORMAT), task_id=self.task_id, delta=np.float64(self.delta), observation_names=self.observation_names,
            action_names=self.action_names, low=self.low, high=self.high, mean=self.mean, scale=self.scale, clip=np.float64(self.clip),
            activation=self.activation, output=self.output, about=json.dumps(self.about, sort_keys=True), **layers,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Gru:
    """A gated recurrent unit: from the input ``(rows, inputs)`` and the memory ``(rows, units)`` to the next memory."""

    weights: NDArray[np.float32]
    bias: NDArray[np.float32]
    """``weights`` and ``bias``: of the input, ``(inputs, 3 * units)`` and ``(3 * units,)``, float32: of the gates that keep and that reset,
    and of what is new."""
    recurrent: NDArray[np.float32]
    """Of the memory, ``(units, 3 * units)``."""
    arithmetic: Arithmetic = field(default=EXACT, repr=False)

    def __post_init__(self) -> None:
        wide = 3 * self.units
        if self.weights.shape[1:] != (wide,) or self.bias.shape != (wide,) or self.recurrent.shape[1:] != (wide,):
            msg = f"A memory cannot have weights of shapes {self.weights.shape}, {self.bias.shape} and {self.recurrent.shape}."
            raise ShapeError(msg)
        if not all(np.isfinite(array).all() for array in (self.weights, self.bias, self.recurrent)):
            refuse("A memory has weights that are not finite.", ShapeError)
        maps = self.arithmetic.affine(self.weights, self.bias), self.arithmetic.affine(self.recurrent, np.zeros(wide))
        object.__setattr__(self, "_maps", maps)

    @property
    def units(self) -> int:
        """Numbers that it remembers."""
        return len(self.recurrent)

    def __call__(self, x: Floats, memory: Floats) -> Floats:
        """The memory after the input ``x``."""
        of_input, of_memory = self._maps  # type: ignore[attr-defined]
        after: Floats = gru_step(of_input(x), of_memory(memory), memory, self.arithmetic)
        return after


@dataclass(frozen=True, eq=False)
class Actor:
    """A policy: a network, and what is before and behind it."""

    network: NetworkPolicy
    """From the observed columns and, after them, the traces and the recurrent unit's memory to one number an action. Its bounds are those
    of these numbers: 0 and 1 where they are positions of controls, those of the action elsewhere."""
    traced: NDArray[np.int64]
    """Columns that leave traces ``(t,)``."""
    shares: Floats
    """How far each trace goes towards the reading in a step ``(k,)``; every such column has ``k`` traces, the first share's first."""
    max_change: Floats
    """How far an action of 1 moves its control in a step ``(m,)``, of its range; 0 where the network gives the action itself."""
    low: Floats
    high: Floats
    """``low`` and ``high``: bounds of the actions ``(m,)``."""
    gru: Gru | None = None
    """The recurrent unit, whose inputs are columns and traces as the network gets them; ``None`` for none."""
    plain: bool = False
    """Whether it is the network alone, which gets the readings as they are."""

    @classmethod
    def of(cls, network: NetworkPolicy) -> Actor:
        """A policy without memory, whose network gives the actions themselves."""
        nothing = np.zeros(0)
        still = np.zeros(len(network.action_names))
        return cls(network, nothing.astype(np.int64), nothing, still, network.low, network.high, plain=True)

    def with_arithmetic(self, arithmetic: Arithmetic) -> Actor:
        """The same policy, computed with ``EXACT`` or ``FAST`` arithmetic."""
        gru = None if self.gru is None else replace(self.gru, arithmetic=arithmetic)
        return replace(self, network=replace(self.network, arithmetic=arithmetic), gru=gru)

    def __post_init__(self) -> None:
        columns = len(self.columns)
        actions = len(self.network.action_names)
        well = (
            self.traced.ndim == 1
            and all(0 <= column < columns for column in self.traced)
            and self.shares.ndim == 1
            and bool(((self.shares > 0) & (self.shares <= 1)).all())
            and {self.max_change.shape, self.low.shape, self.high.shape} == {(actions,)}
            and bool((np.isfinite(self.max_change) & (self.max_change >= 0) & (self.low < self.high)).all())
            and (self.gru is None or len(self.gru.weights) + self.gru.units == len(self.network.observation_names))
        )
        if not well or not np.isfinite([self.low, self.high]).all():
            traces = f"traces of the columns {quoted(self.traced.tolist())} with shares {quoted(self.shares.tolist())}"
            changes = f"changes of {quoted(self.max_change.tolist())} a step, such bounds, or a recurrent unit of other sizes"
            refuse(f"A policy of {columns} columns and {actions} actions cannot have {traces}, {changes}.", ShapeError)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the observed columns."""
        names = self.network.observation_names
        units = 0 if self.gru is None else self.gru.units
        return names[: len(names) - units - len(self.traced) * len(self.shares)]

    def why_not(self, task: TaskCard) -> str | None:
        """Why this policy cannot act in ``task``, in words; ``None`` when it can."""
        return _mismatch(self.columns, self.network.action_names, self.low, task)

    def preference(self, task: TaskCard) -> tuple[Any, ...]:
        """Sort key of policies for ``task``, the best first: its own policy, then the one trained under the nearest uncertainty.

        With a memory, or positions: its own, then the others in their order.
        """
        network = self.network
        own = network.task_id != task.id
        return (own, round(abs(network.delta - task.delta), 9), network.delta) if self.plain else (own,)

    def to_bytes(self) -> bytes:
        """The policy as the bytes of its file; equal policies give equal bytes."""
        if self.plain:
            return self.network.to_bytes()
        own = {name: getattr(self, name) for name in _OWN}
        if self.gru is not None:
            own |= {f"gru_{name}": getattr(self.gru, name) for name in _GRU}
        return packed(network=np.frombuffer(self.network.to_bytes(), np.uint8), **own)


_OWN = ("traced", "shares", "max_change", "low", "high")
_GRU = {"weights": 2, "bias": 1, "recurrent": 2}  # Its arrays, and how many dimensions each has


def read_actor(file: Path) -> Actor:
    """The policy in ``file``, of either format. Raises ``SubmissionError`` when it cannot be read."""
    try:
        data = read_regular(file, 64 * MIB)
    except OSError as error:
        refuse(f"Cannot read the policy {file}: {error.strerror or error}.", SubmissionError, error)
    try:
        arrays = ArrayFile.of(data)
        if "network" not in arrays:
            return Actor.of(_network(arrays))
        network = _network(ArrayFile.of(arrays.integers("network", 1, np.uint8).tobytes()))
        traced, *numbers = _OWN
        own: dict[str, Any] = {name: arrays.floats(name, 1) for name in numbers}
        gru = None
        if "gru_bias" in arrays:
            parts: dict[str, Any] = {name: arrays.floats(f"gru_{name}", of, np.float32) for name, of in _GRU.items()}
            gru = Gru(**parts)
        return Actor(network, arrays.integers(traced, 1, np.int64), **own, gru=gru)
    except (ValueError, ShapeError) as error:
        msg = f"{file} is not a glbench policy, or is damaged: {reason_of(error)}. Train it again, or write it again with glbench export."
        raise SubmissionError(msg) from error


def read_policy(file: Path) -> NetworkPolicy:
    """The network in ``file``. Raises ``SubmissionError`` when it cannot be read, or has a memory or positions."""
    policy = read_actor(file)
    if not policy.plain:
        msg = (
            f"{file} is a policy of the compiled PPO. start_from works with those of Stable-Baselines3: "
            "glbench train ppo --config baselines/ppo/paper.yml"
        )
        raise SubmissionError(msg)
    return policy.network


@dataclass(frozen=True)
class PolicyFiles:
    """A policy file, or a folder of them, trained on different tasks."""

    files: tuple[Path, ...]

    @classmethod
    def at(cls, place: Path) -> PolicyFiles:
        """The policy file ``place``, or all of the folder ``place``. Raises ``SubmissionError`` when there is none."""
        files = tuple(sorted(place.glob("*.npz"))) if place.is_dir() else (place,)
        if not files or not files[0].is_file():
            msg = f"There is no policy at {place}. glbench train writes one, and glbench export makes one of a trained model."
            raise SubmissionError(msg)
        return cls(files)


@controller("network", read=PolicyFiles.at, version="6fcf81c123040c502f9068710aceb794d84916948e29ce0d711175a4640c19ba")
@controller("actor", read=PolicyFiles.at, version="e49117f6dd9b61cf6ed41b2150606726786ac0780e5a18059087026cccf01b65")
class ActorAgent:
    """An ``Agent`` that acts by its policy, and keeps the traces, memory and positions of every run.

    Of several policies the best by ``Actor.preference`` acts. Where a policy has a memory or positions, a reading that is missing
    (not finite) leaves a trace as it is, and counts as the column's mean in training.
    """

    def __init__(self, policies: PolicyFiles | Actor) -> None:
        self._policies = (policies,) if isinstance(policies, Actor) else tuple(map(read_actor, policies.files))
        self._runs = 0

    def reset(self, task: TaskCard, n_runs: int, /) -> None:
        """Begin ``n_runs`` runs, with all controls at 0 and no traces. Raises ``SubmissionError`` when no policy fits the task."""
        self.policy = policy = policy_for(task, self._policies)
        self._runs = n_runs
        self._positions = np.zeros((n_runs, len(policy.max_change)))
        self._traces = np.full((n_runs, len(policy.shares), len(policy.traced)), np.nan)
        self._memory = np.zeros((n_runs, 0 if policy.gru is None else policy.gru.units))

    def act(self, observations: NDArray[np.float32], /) -> Floats:
        """Actions (n_runs, actions). Raises ``ShapeError`` when there are not as many rows as runs were announced to ``reset``."""
        return self._moved(self.policy.network.act(self._inputs(observations)))

    def _inputs(self, observations: NDArray[np.float32]) -> NDArray[np.floating[Any]]:
        """What the network gets: observations and, after them, traces and memory."""
        check_runs(observations, self._runs)
        policy = self.policy
        if policy.plain:
            return observations
        network, readings = policy.network, observations.astype(np.float64)
        traces, latest = self._traces, readings[:, None, policy.traced]
        after = traces + policy.shares[:, None] * (latest - traces)
        self._traces = np.where(np.isnan(traces), latest, np.where(np.isfinite(latest), after, traces))
        inputs = np.concatenate([readings, self._traces.reshape(len(readings), -1)], axis=1)
        inputs = np.where(np.isfinite(inputs), inputs, network.mean[: inputs.shape[1]])
        if policy.gru is not None:
            self._memory = policy.gru(network.normalised(inputs), self._memory)
        return np.concatenate([inputs, self._memory], axis=1)

    def _moved(self, output: Floats) -> Floats:
        """Actions for what the network gives."""
        policy = self.policy
        if policy.plain:
            return output
        moves = policy.max_change > 0
        change = np.where(moves, policy.max_change, 1.0)
        actions: Floats = np.where(moves, (output - self._positions) / change, output)
        actions = np.clip(actions, policy.low, policy.high)
        self._positions = np.clip(self._positions + change * actions, 0.0, 1.0)
        return actions


def policy_for(task: TaskCard, policies: Sequence[Actor]) -> Actor:
    """The policy that acts in ``task``. Raises ``SubmissionError`` when none fits its observations and actions."""
    fitting = [policy for policy in policies if policy.why_not(task) is None]
    if not fitting:
        reasons = "; ".join(sorted({str(policy.why_not(task)) for policy in policies}))
        trained = f"glbench train ppo --task {task.id if task.id.startswith('glbench/') else 'FILE.toml'}"
        refuse(f"The trained policy does not fit this task: {reasons}. Train one for it: {trained}.", SubmissionError)
    return min(fitting, key=lambda policy: policy.preference(task))


def _network(file: ArrayFile) -> NetworkPolicy:
    file.check_format(FORMAT)
    layers = range(file.count("weight_"))
    columns: dict[str, Any] = {name: file.floats(name, 1) for name in ("low", "high", "mean", "scale")}
    output: Any = file.text("output")
    return NetworkPolicy(
        task_id=file.text("task_id"),
        delta=file.number("delta"),
        observation_names=file.texts("observation_names"),
        action_names=file.texts("action_names"),
        **columns,
        clip=file.number("clip"),
        weights=tuple(file.floats(f"weight_{layer}", 2, np.float32) for layer in layers),
        biases=tuple(file.floats(f"bias_{layer}", 1, np.float32) for layer in layers),
        activation=file.text("activation"),
        output=output,
        about=checked_facts(file.table("about")),
    )


def _mismatch(columns: tuple[str, ...], actions: tuple[str, ...], low: Floats, task: TaskCard) -> str | None:
    if task.observation_names != columns:
        mine, theirs = (f"{len(names)} observations ({', '.join(names[:3])}, ...)" for names in (columns, task.observation_names))
        return f"it was trained on {mine}, and {task.id} shows {theirs}"
    if task.action_names != actions or [action.low for action in task.actions] != low.tolist():
        return f"its actions are not those of {task.id}"
    return None
