"""Where an episode comes from: task, agent, seed, how it ended, kernel and versions. Recorded with every file.

Nothing in it depends on the day or on the folder: the same evaluation gives the same bytes.
"""

from __future__ import annotations

import json
import platform
from importlib.metadata import version
from typing import Annotated, Any, Literal, Self

import pydantic

from glbench import __version__
from glbench.agents import LoadedAgent
from glbench.canonical import canonical_json
from glbench.errors import EpisodeError, TaskError, refuse
from glbench.fields import MOST_ENTRIES, Count, Text, Word
from glbench.tasks import TaskSpec
from glbench.untrusted import is_agent_name, parse_json, steers, visible

Status = Literal["ok", "crashed", "timed_out", "invalid_action", "simulation_failed"]
Acts = Literal["actions", "controls"]


class Facts(pydantic.BaseModel):
    """Base of the records: frozen, strict, no unknown fields."""

    model_config = pydantic.ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class TaskFacts(Facts):
    """The task; ``parts`` are the digests that its digest is made of (definition, parameters, weather, model, ...)."""

    id: Word
    digest: Word
    title: Text
    steps: Count
    step_seconds: Annotated[float, pydantic.Field(gt=0, le=86400)]
    start: Annotated[str, pydantic.Field(pattern=r"^\d{4}-\d{2}-\d{2}$")]
    parts: Annotated[dict[Word, Word], pydantic.Field(max_length=MOST_ENTRIES)]
    salt_commitment: Annotated[str, pydantic.Field(pattern=r"^[0-9a-f]{64}$")] | None = None
    """Of the round that the draws belong to; ``None``, and not in the file, with public draws."""

    @pydantic.model_serializer(mode="wrap")
    def _without_what_is_not(self, write: pydantic.SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {name: entry for name, entry in write(self).items() if name != "salt_commitment" or entry is not None}


class AgentFacts(Facts):
    """The agent. ``acts``: whether it gave actions, or (privileged) the controls themselves; ``columns``: their names."""

    name: Word
    kind: Word
    digest: Word
    privileged: bool
    information: Text
    acts: Acts
    columns: Annotated[tuple[Word, ...], pydantic.FailFast(), pydantic.Field(max_length=MOST_ENTRIES)]

    @pydantic.model_validator(mode="after")
    def _has_a_name(self) -> Self:
        if not is_agent_name(self.name):
            refuse(f"{self.name!r} cannot be the name of an agent")
        return self


class RunFacts(Facts):
    """One run: how it ended, the steps simulated, and the number of recorded actions.

    A run whose last step could not be simulated has one action more than steps.
    """

    seed: Count
    status: Status
    reason: Text | None
    steps: Count
    actions: Count

    @pydantic.model_validator(mode="after")
    def _counts_fit(self) -> Self:
        expected = self.steps + (1 if self.status == "simulation_failed" else 0)
        if self.actions not in (expected, self.steps) or (self.status == "ok") != (self.reason is None):
            refuse(f"the run with seed {self.seed} is '{self.status}' after {self.steps} steps with {self.actions} actions")
        return self


class Provenance(Facts):
    """What all runs of an evaluation share."""

    task: TaskFacts
    agent: AgentFacts
    kernel: Annotated[dict[Word, Text | float], pydantic.Field(max_length=MOST_ENTRIES)]
    versions: Annotated[dict[Word, Word], pydantic.Field(max_length=MOST_ENTRIES)]

    @pydantic.model_validator(mode="after")
    def _says_what_computed(self) -> Self:
        if "backend" not in self.kernel or "glbench" not in self.versions:
            refuse("the kernel's backend or the version of glbench is missing")
        return self


def provenance_of(task: TaskSpec, agent: LoadedAgent, kernel: dict[str, str | float]) -> Provenance:
    """Provenance of an evaluation with a kernel of that description. Raises ``TaskError`` when the task's title is not one line."""
    if any(steers(letter) for letter in task.title):
        refuse(f"The title of the task {task.id} is {task.title!r}: it must stand on one line, without control characters.", TaskError)
    prints = task.fingerprint()
    all_controls = task.model_value.control_names
    return Provenance(
        task=TaskFacts(
            **{name: getattr(task, name) for name in ("id", "digest", "title", "steps", "step_seconds", "salt_commitment")},
            start=task.weather.start.isoformat(),
            parts={name: getattr(prints, name) for name in PARTS},
        ),
        agent=AgentFacts(
            **{name: getattr(agent, name) for name in ("name", "kind", "digest", "privileged", "information", "acts")},
            columns=all_controls if agent.acts == "controls" else tuple(action.name for action in task.actions),
        ),
        kernel=kernel,
        versions=versions(task),
    )


PARTS = ("definition", "parameters", "start", "observation", "weather", "model")  # Parts of a task's fingerprint


def versions(task: TaskSpec) -> dict[str, str]:
    """Versions of everything that computes a number."""
    model = task.model_value
    return {
        "glbench": __version__,
        "model": model.id if task.conventions.names_model else model.version,
        "python": platform.python_version(),
        "numpy": version("numpy"),
        "casadi": version("casadi"),
    }


def canonical(facts: pydantic.BaseModel) -> bytes:
    """The one form (RFC 8785) of a record as JSON."""
    return canonical_json(json.loads(facts.model_dump_json()))


def as_words(provenance: Provenance, run: RunFacts | None = None) -> dict[str, str]:
    """The same as a flat table of words, for people who open a file in Foxglove."""
    task, agent = provenance.task, provenance.agent
    words: dict[str, Any] = {
        "task": task.id,
        "task_title": task.title,
        "task_digest": task.digest,
        "start": f"{task.start}T00:00:00 UTC",
        "step_seconds": f"{task.step_seconds:g}",
        "agent": agent.name,
        "agent_digest": agent.digest,
        "agent_sees": agent.information,
        "kernel": str(provenance.kernel["backend"]),
        "glbench": provenance.versions["glbench"],
    }
    words |= {} if task.salt_commitment is None else {"salt_commitment": task.salt_commitment}
    if run is not None:
        words |= {"seed": str(run.seed), "status": run.status, "steps": str(run.steps)}
        words |= {} if run.reason is None else {"reason": run.reason}
    return words


def definition_json(task: TaskSpec) -> bytes:
    """The definition of ``task``, prose included, as JSON for people and programs."""
    return (json.dumps(task.attachment(), indent=2, ensure_ascii=False) + "\n").encode()


def task_of(definition: bytes) -> TaskSpec:
    """The task that a record's attached definition defines, right or not. Raises ``EpisodeError`` when it defines none."""
    try:
        return TaskSpec.of_attachment(parse_json(definition))
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError, pydantic.ValidationError) as error:
        msg = f"The task definition in the record cannot be read ({visible(' '.join(str(error).split())[:200])}). Evaluate again."
        raise EpisodeError(msg) from error
