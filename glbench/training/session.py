"""What the compiled training and the searches share: a session in a folder, from its start or its kept state to the card."""

from __future__ import annotations

import io
import json
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from glbench.agents.saved_policies import DAMAGED
from glbench.errors import TrainingError, refuse
from glbench.resources import write_atomically
from glbench.tasks import TaskSpec
from glbench.training.card import TrainingFacts, digest_of_tasks, note_session, write_card
from glbench.training.folder import Trained, altered, claim, folder_lock, open_folder
from glbench.training.periodic_evaluation import History, Listener, Pace, ProbeResult, Progress

Arrays = Mapping[str, NDArray[Any]]


class Session(ABC):
    """A training or a search under way.

    It works for ``tasks`` by ``settings`` with an ``evaluation`` and a ``kernel_preset``; ``settings_digest`` and ``seed`` tell it, with
    the tasks' digest, from others. ``folder`` keeps its state, the best that it made, the learning curve and the card.
    """

    what: ClassVar[str]
    """``training`` or ``search``."""
    state: ClassVar[str]
    """Name of the file in the folder that it continues from."""

    def __init__(self, tasks: Sequence[TaskSpec], settings: Any, settings_digest: str, seed: int, folder: Path) -> None:
        self.tasks, self.settings, self.folder, self.seed = tasks, settings, folder, seed
        self.identity: dict[str, Any] = {"task_digest": digest_of_tasks(tasks), "settings_digest": settings_digest, "seed": seed}
        self.history = History()

    @property
    @abstractmethod
    def steps(self) -> int:
        """Environment steps so far."""

    @abstractmethod
    def prepare(self) -> None:
        """Make what it begins with: kernels, runs, first weights."""

    @abstractmethod
    def advance(self) -> float:
        """Do a generation or an update; the mean reward of a season in it."""

    @abstractmethod
    def evaluate(self) -> ProbeResult:
        """Mean sums over the runs that select the best."""

    @abstractmethod
    def save_best(self) -> None:
        """Write what was evaluated last, the best so far, to the folder."""

    @abstractmethod
    def arrays(self) -> Arrays:
        """What the rest of it depends on, besides ``counts`` and history."""

    def counts(self) -> dict[str, int]:
        """Counts that belong to its state."""
        return {}

    @abstractmethod
    def restore(self, arrays: Arrays, facts: Mapping[str, Any]) -> None:
        """Continue from the arrays of another session; ``facts`` has its counts."""

    @abstractmethod
    def facts(self) -> TrainingFacts:
        """What its card says."""

    def carry_out(
        self,
        target: Mapping[str, int],
        total_steps: int,
        listeners: Sequence[Listener],
        *,
        resume: bool,
        policy: Path | None = None,
        start: Mapping[str, Any] | None = None,
    ) -> Trained:
        """Work in the folder until ``total_steps`` are made, which are ``target`` in the words of ``folder.claim``; write the card.

        ``policy`` is the policy to start from, ``start`` what the card says of the start. Raises ``TrainingError`` as ``folder.claim`` and
        ``folder.folder_lock``, and when the state in the folder belongs to another session, cannot be read, or has been changed.
        """
        with folder_lock(self.folder):
            state = self.folder / self.state if (self.folder / self.state).is_file() else None
            card = claim(self.folder, self.identity, state, start=policy, target=target, resume=resume)
            if card is not None:
                if not (self.folder / (file := str(card.get("settings", "policy.npz")))).is_file():
                    why = f"{self.folder} holds a finished training without its {file}. Remove the folder to train again."
                    raise TrainingError(why)
                return Trained.of(self.folder, card, already_done=True)
            self.prepare()
            if state is not None:
                self._go_on(state)
            note_session(self.history, self.tasks[0], self.steps)
            open_folder(self.folder, self.settings.model_dump(mode="json", exclude_none=True))
            pace = Pace(self.steps)
            while self.steps < total_steps:
                if self.steps >= self.history.next_evaluation:
                    self._evaluate(listeners)
                try:
                    reward = self.advance()
                    for listener in listeners:
                        listener.on_progress(Progress(self.steps, total_steps, pace.rate(self.steps), reward))
                except KeyboardInterrupt:
                    self.keep()
                    raise
            if not self.history.curve or self.history.curve[-1]["steps"] < self.steps:
                self._evaluate(listeners)
            card = write_card(self.folder, self.tasks, self.facts(), self.settings.evaluation, self.history, start)
        return Trained.of(self.folder, card, already_done=False)

    def _evaluate(self, listeners: Sequence[Listener]) -> None:
        if self.steps:  # an interruption costs the evaluation alone
            self.keep()
        with self.history.time.spend("evaluation"):
            result = self.evaluate()
        point = self.history.add(self.steps, result, self.settings.evaluation.every)
        if point.is_best:
            self.save_best()
        self.history.write_curve(self.folder)
        self.keep()
        for listener in listeners:
            listener.on_evaluation(point)
            listener.on_saved(self.steps)

    def keep(self) -> None:
        """Write what is needed to continue to the folder."""
        arrays = self.arrays()
        state = {"identity": self.identity, "history": asdict(self.history), **self.counts()}
        facts = json.dumps({**state, "digest": self._digest(state, arrays)})
        content = io.BytesIO()
        np.savez(content, allow_pickle=False, facts=np.frombuffer(facts.encode(), np.uint8), **arrays)
        write_atomically(self.folder / self.state, content.getvalue())

    def _go_on(self, file: Path) -> None:
        try:
            with np.load(file, allow_pickle=False) as stored:
                facts, arrays = json.loads(stored["facts"].tobytes()), {name: stored[name] for name in stored.files if name != "facts"}
            if facts["identity"] != self.identity:
                msg = f"{self.folder} holds another {self.what}: task, settings, start or seed differ. Choose another folder with --out."
                raise TrainingError(msg)
            if facts.pop("digest", None) != self._digest(facts, arrays):
                raise altered(file)
            self.restore(arrays, facts)
        except DAMAGED as error:
            refuse(f"The state of the {self.what} {file} cannot be read: {error}. Remove it to start over.", TrainingError, error)
        self.history = History.from_dict(facts["history"])

    def _digest(self, facts: Mapping[str, Any], arrays: Arrays) -> str:
        digest = sha256(json.dumps(facts, sort_keys=True).encode())
        for array in arrays.values():
            header = f"{array.dtype.str} {array.shape}" if self.what == "training" else ""  # that of a search is one list of rewards
            digest.update(header.encode() + array.tobytes())
        return digest.hexdigest()
