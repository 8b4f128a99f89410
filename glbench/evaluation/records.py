"""The result of one agent on one task, as frozen records that check themselves.

A record is consistent or it does not exist: seeds match runs, a finished run has all its steps, the summary follows from the runs and
the digest from the deterministic part. A result may have metrics that this glbench does not know, which stay as they are, and may lack
some that it knows, but for the one that ranks. ``docs/results.md`` explains the file.
"""

from __future__ import annotations

import math
import os
import platform
import shutil
import subprocess
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final, Literal, Self

import pydantic

from glbench import __version__
from glbench.agents.card import RecipeId, Split, SubmissionCard, Year
from glbench.canonical import canonical_sha256
from glbench.errors import ResultError, refuse
from glbench.evaluation.metrics import COMMON_UNITS, MONEY_TOO, PAPER_ONLY, UNITS
from glbench.fields import MOST_ENTRIES, Count, Text, Word
from glbench.tasks.sealed import Round
from glbench.untrusted import AGENT_NAME_RULE, html_of, is_agent_name

if TYPE_CHECKING:
    import pandas as pd


SCHEMA_NAME: Final = "glbench/result"
SCHEMA_VERSION: Final = 1  # The version that is written, and the newest that can be read; a file that states none is of version 1
RANKING_METRIC: Final = "reward"  # Every result has it

Status = Literal["ok", "crashed", "timed_out", "invalid_action", "simulation_failed"]
Digest = Annotated[str, pydantic.Field(pattern=r"^[0-9a-f]{64}$")]
Seconds = Annotated[float, pydantic.Field(ge=0, le=1e15)]
MOST_STEPS = 10_000_000  # A task has at most ten years of minutes
_LARGEST_METRIC = 1e100  # Beyond what any run can reach; sums of larger numbers overflow


def _agent_name(name: str) -> str:
    if not is_agent_name(name):
        refuse(f"an agent's name has {AGENT_NAME_RULE}")
    return name


class Record(pydantic.BaseModel):
    """Base of the records: frozen, no unknown fields, no NaN."""

    model_config = pydantic.ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False, populate_by_name=True)


class Sparse(Record):
    """A record of which some fields are not written where they have no value, so that files of earlier versions keep text and digest."""

    sparse: ClassVar[frozenset[str]] = frozenset()

    @pydantic.model_serializer(mode="wrap")
    def _without_absent(self, write: pydantic.SerializerFunctionWrapHandler) -> dict[str, Any]:
        content: dict[str, Any] = write(self)
        return {name: value for name, value in content.items() if value is not None or name not in self.sparse}


class RunResult(Sparse):
    """One seeded run.

    ``cluster`` names the group of runs that it belongs to, such as the year that its season is from, where a task's runs fall into few
    groups; absent elsewhere, and from results of earlier versions. ``steps`` is the number of steps that were simulated. A run that is
    not ``ok`` carries the ``reason`` in words, and its missing steps stand in ``metrics`` at the task's price of a failed step.
    """

    sparse = frozenset({"cluster"})
    seed: Count
    status: Status
    reason: Text | None
    steps: Count
    metrics: Annotated[dict[Word, float], pydantic.Field(max_length=MOST_ENTRIES)]
    cluster: Annotated[str | None, pydantic.Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9 ._-]{0,79}$")] = None

    @pydantic.model_validator(mode="after")
    def _is_consistent(self) -> Self:
        if RANKING_METRIC not in self.metrics:
            refuse(f"run with seed {self.seed} lacks the metric '{RANKING_METRIC}'")
        if (self.status == "ok") != (self.reason is None):
            refuse(f"run with seed {self.seed} is '{self.status}' with the reason {self.reason!r}")
        return self


class TaskRecord(Sparse):
    """The task that was run; its digest covers definition, parameters, weather and model.

    Of a task with splits ``split`` and ``years`` say of which split, and from which years, the seasons of the runs were;
    ``salt_commitment`` is the SHA-256 of the secret salt that entered the draws, where there was one. All three are absent elsewhere,
    and from results of earlier versions.
    """

    sparse = frozenset({"split", "years", "salt_commitment"})
    id: Annotated[str, pydantic.Field(pattern=r"^[A-Za-z0-9_-]+/[A-Za-z0-9_.-]+-v[1-9][0-9]*$", max_length=200)]
    digest: Digest
    title: Text
    steps: Annotated[int, pydantic.Field(ge=0, le=MOST_STEPS)]
    step_seconds: Annotated[float, pydantic.Field(ge=1, le=86400)]
    split: Split | None = None
    years: Annotated[tuple[Year, ...] | None, pydantic.FailFast(), pydantic.Field(max_length=MOST_ENTRIES)] = None
    salt_commitment: Digest | None = None


class TrainingRecord(Record):
    """Recipe, seed and form that the agent's card states, with a digest over the weights.

    ``policy`` is ``None`` if no file holds weights.
    """

    recipe: RecipeId
    seed: Count
    form: Word
    policy: Digest | None = None


class AgentRecord(Sparse):
    """The agent that acted; its digest covers its files. ``information`` says in words what it could see.

    ``training`` is absent if its card names no recipe, and in results of earlier versions.
    """

    sparse = frozenset({"training"})

    name: Annotated[str, pydantic.AfterValidator(_agent_name)]
    kind: Literal["submission", "baseline"]
    digest: Digest
    privileged: bool
    information: Text
    card: SubmissionCard | None = None
    """What the submission says about itself; ``None`` without a card and in results of earlier versions."""
    training: TrainingRecord | None = None


class EvaluationRecord(Record):
    """How it was run. Times are of this machine and no part of the score.

    ``decision_seconds`` is the time spent in the agent, for all runs together; ``decision_milliseconds`` the same for one step of one run.
    """

    runs: Annotated[Count, pydantic.Field(ge=1)]
    seeds: Annotated[tuple[Count, ...], pydantic.FailFast()]
    workers: Annotated[Count, pydantic.Field(ge=1)]
    wall_seconds: Seconds
    steps_per_second: Seconds
    decision_seconds: Seconds
    decision_milliseconds: Seconds
    resumed_at_step: Count | None
    limits: Annotated[dict[Word, Seconds], pydantic.Field(max_length=MOST_ENTRIES)]
    kernel: Annotated[dict[Word, Text | float], pydantic.Field(max_length=MOST_ENTRIES)]
    sandbox: Literal["bubblewrap", "unsandboxed", "built-in"] | None = None
    """How the agent ran: in a sandbox, without one, or as a part of glbench; ``None`` in results of glbench without sandboxes."""


class RecordReference(Record):
    """A file beside the result, such as the one that holds the actions of all runs, and the digest of its content."""

    file: Annotated[str, pydantic.Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", max_length=255)]
    digest: Digest


class Versions(Record):
    """Versions of everything that computes a number."""

    glbench: Word
    model: Word
    python: Word
    numpy: Word
    casadi: Word
    gymnasium: Word


class Machine(Record):
    """Where it was computed."""

    processor: Word
    architecture: Word
    cores: Count
    system: Word


class GitState(Record):
    """The checkout it was computed from; ``dirty`` when code, tasks, weather or baselines differ from the commit."""

    commit: Word
    dirty: bool


class Summary(Record):
    """Means over all runs, failed ones included, and how many runs ended how."""

    runs: Count
    ok: Count
    failed: Count
    statuses: dict[Status, Count]
    mean: Annotated[dict[Word, float], pydantic.Field(max_length=MOST_ENTRIES)]


class ReferenceRuns(Record):
    """A reference agent: the ranking metric of each run, in the order of the seeds, with the published and with the fresh draws."""

    name: Annotated[str, pydantic.AfterValidator(_agent_name)]
    digest: Digest
    published: Annotated[tuple[float, ...], pydantic.FailFast()]
    fresh: Annotated[tuple[float, ...], pydantic.FailFast()]


class FreshDraws(Record):
    """A second evaluation with draws from a ``salt`` that was secret until its end, and reference agents with the same draws."""

    salt: Digest
    metric: Word
    """Ranking metric of the task, to which the values of ``references`` belong."""
    runs: Annotated[tuple[RunResult, ...], pydantic.FailFast()]
    references: Annotated[tuple[ReferenceRuns, ...], pydantic.Field(min_length=1, max_length=MOST_ENTRIES)]
    record: RecordReference
    digest: Digest
    """SHA-256 over all fields except ``record``, and the ``results_digest`` of the result."""

    def computed_digest(self, results_digest: str) -> str:
        """The correct ``digest`` in a result with this ``results_digest``."""
        return canonical_sha256({"result": results_digest, **self.model_dump(mode="json", exclude={"record", "digest"})})


class Result(Sparse):
    """One agent on one task: everything that ``reports/results/<task>/<agent>.json`` holds."""

    sparse = frozenset({"fresh_draws"})
    schema_name: Literal["glbench/result"] = pydantic.Field(default=SCHEMA_NAME, alias="schema")
    schema_version: Literal[1] = SCHEMA_VERSION
    task: TaskRecord
    agent: AgentRecord
    evaluation: EvaluationRecord
    versions: Versions
    machine: Machine
    git: GitState | None
    created: Word
    units: Annotated[dict[Word, Word], pydantic.Field(max_length=MOST_ENTRIES)]
    """Of every metric that the runs have."""
    runs: Annotated[tuple[RunResult, ...], pydantic.FailFast()]
    summary: Summary
    results_digest: Digest
    record: RecordReference | None = None
    """What `glbench verify` reproduces the result from; ``None`` in results that were made without a folder."""
    profile: RecordReference | None = None
    """What pages show of days and seasons; ``None`` in results that were made without a folder, or by an earlier glbench."""
    fresh_draws: FreshDraws | None = None
    """Evaluation with fresh draws (`glbench evaluate --fresh-draws`); absent without it. ``results_digest`` does not cover it."""

    @pydantic.model_validator(mode="after")
    def _is_consistent(self) -> Self:
        seeds = tuple(run.seed for run in self.runs)
        if seeds != self.evaluation.seeds or len(seeds) != self.evaluation.runs:
            refuse(
                f"the result announces {self.evaluation.runs} runs with the seeds {_short(self.evaluation.seeds)} "
                f"and holds {len(seeds)} with the seeds {_short(seeds)}"
            )
        if len(set(seeds)) != len(seeds):
            refuse("a seed occurs twice")
        for run in self.runs:
            if set(run.metrics) != set(self.units):
                missing, more = sorted(set(self.units) - set(run.metrics)), sorted(set(run.metrics) - set(self.units))
                refuse(f"run with seed {run.seed} lacks metrics that have a unit {missing}, or has some without one {more}")
            if any(abs(value) > _LARGEST_METRIC for value in run.metrics.values()):
                refuse(f"run with seed {run.seed} has a metric above {_LARGEST_METRIC:g}")
            if run.steps > self.task.steps or (run.status == "ok") != (run.steps == self.task.steps):
                refuse(f"run with seed {run.seed} is '{run.status}' after {run.steps} of {self.task.steps} steps")
        # Other tasks may measure their heat in MJ; what every task has is in one unit, and so is all that the paper's tasks have.
        fixed = UNITS if set(self.units) >= PAPER_ONLY else COMMON_UNITS
        priced = MONEY_TOO if fixed is COMMON_UNITS else {}
        if any(unit not in (fixed.get(name, unit), priced.get(name)) for name, unit in self.units.items()):
            refuse("the units are not those of this schema version")
        if self.summary != summarise(self.runs):
            refuse("the summary does not follow from the runs")
        if len({run.cluster is None for run in self.runs}) > 1:
            refuse("some runs name their group (cluster) and some do not")
        if self.results_digest != results_digest(self.task.digest, self.agent, self.runs, self.task.salt_commitment):
            refuse("results_digest does not match task, agent and runs: the file was changed after it was written")
        if self.fresh_draws is not None:
            self._check_fresh_draws(self.fresh_draws)
        return self

    def _check_fresh_draws(self, fresh: FreshDraws) -> None:
        if self.task.split != "test" or self.task.salt_commitment is not None:
            refuse("fresh_draws belong to a result on the published test split, and this result has other draws")
        runs = len(self.runs)
        if any(len(values) != runs for one in fresh.references for values in (one.published, one.fresh)):
            refuse(f"fresh_draws: a reference agent does not have {runs} runs with both sets of draws")
        if any(abs(value) > _LARGEST_METRIC for one in fresh.references for value in one.published + one.fresh):
            refuse(f"fresh_draws: a reference agent has a metric above {_LARGEST_METRIC:g}")
        if fresh.metric not in self.units:
            refuse(f"fresh_draws: the runs do not have the metric '{fresh.metric}'")
        if fresh.digest != fresh.computed_digest(self.results_digest):
            refuse("fresh_draws: the digest does not match salt, runs and reference agents: the file was changed after it was written")
        try:
            self.of_fresh_draws()
        except ValueError as error:
            refuse(f"fresh_draws: {error}", ValueError, error)

    def of_fresh_draws(self) -> Result:
        """The evaluation with fresh draws as a separate result, like one of a round with that salt. Needs ``fresh_draws``."""
        fresh = self.fresh_draws
        assert fresh is not None
        commitment = Round(fresh.salt).commitment
        fields = {name: getattr(self, name) for name in type(self).model_fields}
        fields["task"] = self.task.model_copy(update={"years": None, "salt_commitment": commitment})
        fields |= {"runs": fresh.runs, "summary": summarise(fresh.runs), "record": fresh.record, "profile": None}
        digest = results_digest(self.task.digest, self.agent, fresh.runs, commitment)
        return Result(**fields | {"results_digest": digest, "fresh_draws": None})

    @property
    def clusters(self) -> tuple[str, ...] | None:
        """The group of each run, in the order of the seeds; ``None`` where runs name none."""
        names = tuple(run.cluster for run in self.runs if run.cluster is not None)
        return names if len(names) == len(self.runs) else None

    @property
    def failed(self) -> tuple[RunResult, ...]:
        """The runs that did not end well, with their reasons."""
        return tuple(run for run in self.runs if run.status != "ok")

    def values(self, metric: str) -> tuple[float, ...]:
        """One metric of all runs, in the order of the seeds, in the unit of ``units[metric]``.

        Raises ``ResultError`` when the result does not have the metric: an earlier or a later glbench may have measured others.
        """
        if metric not in self.units:
            msg = f"The result of {self.agent.name} on {self.task.id} has no metric '{metric}'. It has {', '.join(self.units)}."
            raise ResultError(msg)
        return tuple(run.metrics[metric] for run in self.runs)

    def to_frame(self) -> pd.DataFrame:
        """One row a run, indexed by seed: ``status``, ``reason``, ``steps`` and every metric; units in ``frame.attrs["units"]``."""
        import pandas as pd

        rows = [{"status": run.status, "reason": run.reason, "steps": run.steps, **run.metrics} for run in self.runs]
        frame = pd.DataFrame(rows, index=pd.Index([run.seed for run in self.runs], name="seed"))
        frame.attrs.update(task=self.task.id, agent=self.agent.name, units=dict(self.units))
        return frame

    def __repr__(self) -> str:
        return f"<Result {self.agent.name} on {self.task.id}: {self.summary.ok} of {self.summary.runs} runs ok>"

    def _repr_html_(self) -> str:
        """What a notebook shows: agent, task, how the runs ended, and mean and range of every metric."""
        split = f", split {self.task.split}" if self.task.split else ""
        ended = ", ".join(f"{count} {status}" for status, count in self.summary.statuses.items())
        facts = [("task", f"{self.task.id}{split}"), ("agent", self.agent.name), ("runs", ended)]
        rows = [
            (name, unit, self.summary.mean[name], min(values), max(values))
            for name, unit in self.units.items()
            if any(values := self.values(name))
        ]
        return html_of(f"{self.agent.name} on {self.task.id}", facts, ("metric", "unit", "mean", "lowest", "highest"), rows)

    def to_json(self) -> str:
        """The text of the result file: JSON, two spaces, floats in the shortest form that reads back to the same bits."""
        return self.model_dump_json(by_alias=True, indent=2) + "\n"


def summarise(runs: tuple[RunResult, ...]) -> Summary:
    """Means (correctly rounded sums, hence independent of the order of the runs) and counts of statuses."""
    statuses: dict[Status, int] = {}
    for run in runs:
        statuses[run.status] = statuses.get(run.status, 0) + 1
    ok = statuses.get("ok", 0)
    names = runs[0].metrics if runs else ()
    mean = {name: math.fsum(run.metrics[name] for run in runs) / len(runs) for name in names}
    return Summary(runs=len(runs), ok=ok, failed=len(runs) - ok, statuses=statuses, mean=mean)


def results_digest(task_digest: str, agent: AgentRecord, runs: tuple[RunResult, ...], salt_commitment: str | None = None) -> str:
    """SHA-256 over the canonical JSON (RFC 8785) of what must repeat bit for bit: task, commitment to a salt, agent, and every run."""
    deterministic: dict[str, Any] = {
        "task": task_digest,
        "agent": {"name": agent.name, "digest": agent.digest},
        "runs": [run.model_dump(mode="json") for run in runs],
        **({} if salt_commitment is None else {"salt_commitment": salt_commitment}),
    }
    return canonical_sha256(deterministic)


def _short(seeds: tuple[int, ...]) -> str:
    listed = ", ".join(str(seed) for seed in seeds[:3])
    return f"[{listed}, ... {seeds[-1]}]" if len(seeds) > 4 else f"[{', '.join(map(str, seeds))}]"


# What decides a number, besides task and agent (those have digests of their own). Reports and a user's submissions change all the
# time and do not make a checkout "dirty".
_DECISIVE = ("glbench", "tasks", "weather", "baselines", "pyproject.toml", "uv.lock")
_GIT_SECONDS = 10


def current_versions(model: str) -> Versions:
    """Versions of everything that computes a number; ``model`` is that of the model."""
    packages = {name: version(name) for name in ("numpy", "casadi", "gymnasium")}
    return Versions(glbench=__version__, model=model, python=platform.python_version(), **packages)


def this_machine() -> Machine:
    """Processor, cores that this process may use, operating system."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text(encoding="utf-8", errors="replace").splitlines() if cpuinfo.is_file() else []
    names = [value.strip() for key, _, value in (line.partition(":") for line in lines) if key.strip() == "model name"]
    processor = next(iter(names), "") or platform.processor() or platform.machine() or "unknown"
    return Machine(processor=processor, architecture=platform.machine(), cores=usable_cores(), system=platform.platform())


def usable_cores() -> int:
    """Processor cores that this process may use: fewer than the machine has inside many containers and batch systems."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def git_state() -> GitState | None:
    """Commit of the checkout that glbench runs from; ``None`` for an installed package or where git cannot tell."""
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists() or not (root / "pyproject.toml").is_file():
        return None
    commit = _git(root, "rev-parse", "--verify", "HEAD")
    changes = _git(root, "status", "--porcelain", "--", *[name for name in _DECISIVE if (root / name).exists()])
    return None if commit is None or changes is None else GitState(commit=commit, dirty=bool(changes))


def _git(root: Path, *arguments: str) -> str | None:
    program = shutil.which("git")
    if program is None:
        return None
    # Without the optional locks a status in the background never disturbs a commit that the user makes at the same time.
    environment = {**os.environ, "GIT_OPTIONAL_LOCKS": "0"}
    try:
        answer = subprocess.run(
            [program, "-C", str(root), *arguments],
            capture_output=True, text=True, check=False, timeout=_GIT_SECONDS, env=environment,
        )  # fmt: skip
    except (OSError, subprocess.TimeoutExpired):
        return None
    return answer.stdout.strip() if answer.returncode == 0 else None
