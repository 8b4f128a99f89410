"""``check_submission``: the files first, then an evaluation of a day that is compared with itself, all within seconds.

The agent runs in a process of its own, as in an evaluation: in the sandbox, or without one where there is to be none.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from glbench.agents.identity import FORM_WORDS, Identity, baseline_names, is_built_in, read_identity
from glbench.agents.loading import find_submission
from glbench.agents.protocol import Agent
from glbench.env import Simulation
from glbench.errors import GlbenchError, SandboxError, SubmissionError, refuse
from glbench.evaluation.limits import Failure, TimeLimits
from glbench.evaluation.runners import AgentRunner, Decision
from glbench.evaluation.sandbox.choosing import Protection, SandboxChoice, protection_of
from glbench.evaluation.sandbox.frames import GIB, MIB, Kind, Prints, SandboxLimits
from glbench.evaluation.sandbox.process import LostError
from glbench.evaluation.sandbox.runners import SandboxedAgent, in_process
from glbench.evaluation.submitting import findings
from glbench.evaluation.submitting.findings import Finding, Report, Subject, note, problem
from glbench.tasks import DEFAULT_TASK, TaskSpec, get_task, task_card

SECONDS = 15.0  # Time for the steps of the check [s]. Imports, making the agent and the seasons, and first decisions do not count.
STEPS = 96  # Steps of the short run: a day in steps of a quarter of an hour, with its night
RUNS = 4
_LEAST = 0.6  # Share of the time that is the agent's, however long packages took to be imported
_SHARE_RUN, _SHARE_REPEAT, _SHARE_ALONE = 0.5, 0.4, 0.4
"""Shares of the time that is left, for the first run, its repetition, and each row alone."""
_PACKAGES_SECONDS = 60.0
_PRINTED_NOTE, _LONGEST_QUOTE = 4096, 160
_ANY = 2**62
_SHORTEST_START, _SHORTEST_STEP = 30.0, 10.0
"""Seconds that an agent gets to be made, and a decision of a run, however little time the check has left: running out of the check's own
time says nothing about the agent, and a busy machine starts a good one ten times as slowly."""
_SIZES = SandboxLimits()
_SIZES_OF_THE_MACHINE = SandboxLimits(scratch=_ANY, shared=_ANY, tasks=_ANY, files=_ANY, open_files=_ANY, made=_ANY)
"""Without a sandbox only memory has a limit."""
_WHERE: dict[Protection, str] = {"bubblewrap": "in a sandbox (bubblewrap)", "unsandboxed": "unsandboxed, with your rights"}


def check_submission(
    ref: str | Path, task: str | Path | TaskSpec = DEFAULT_TASK, *, seconds: float = SECONDS, sandbox: SandboxChoice = "auto"
) -> Report:
    """Find out what will be wrong with the submission at the path ``ref`` in an evaluation on ``task``: a task, its id, or a task file.

    ``seconds`` is the time for the steps of the check; loading and first decisions do not count, because a planning agent needs most of its
    time there. ``sandbox`` is as for ``glbench.evaluation.evaluate``; where there can be none that it asks for, only files are looked at,
    and the report says so. Raises ``SubmissionError`` when there is no such file or folder, or it is a baseline.
    """
    began = time.monotonic()
    spec = task if isinstance(task, TaskSpec) else get_task(task)
    if str(ref) in baseline_names() and not Path(ref).exists():
        refuse(f"'{ref}' is a baseline of glbench and no submission: there is nothing to check. Evaluate it.", SubmissionError)
    path = find_submission(ref)
    if is_built_in(path):
        return _look_at_settings(path, spec, began)
    book = _Book()
    card, results = findings.card_findings(path)
    book.add(results, "card")
    # A wrong card hides what lies behind it: what is wrong with the rest is found out as if there was none.
    broken_card = card is None and any(finding.level == "problem" for finding in results)
    identity = protection = None
    if not broken_card:
        try:
            identity = read_identity(path)
        except SubmissionError as error:
            book.add([problem("files", str(error))], "files")
    name, what = path.resolve().stem if path.is_file() else path.resolve().name, "a submission"
    if identity is not None:
        what = FORM_WORDS[identity.form]
        book.add(findings.card_notes(identity))
        book.add(findings.size_findings(identity), "files")
        book.facts["files"] = findings.size_in_words(identity)
        imports = findings.imports_of(identity)
        book.add(findings.package_findings(identity, imports), "packages")
        book.add(findings.policy_findings(identity, task_card(spec)))
        if not book.hopeless:
            try:
                protection = protection_of(identity, sandbox)
            except SandboxError as error:
                book.add([problem("loading", str(error))])
        if protection is not None:
            book.facts["loading"] = _WHERE[protection]
            remaining = max(2.0, seconds - (time.monotonic() - began))
            _DryRun(identity, findings.large_packages(identity, imports), spec, book, remaining, walls=protection == "bubblewrap").run()
    results = list(dict.fromkeys(book.findings))
    return Report(name, what, spec.id, tuple(results), frozenset(book.checked), book.facts, time.monotonic() - began)


def _look_at_settings(path: Path, spec: TaskSpec, began: float) -> Report:
    """A folder of settings for a controller of glbench has no code to run: whether they can be read, and serve the task."""
    from glbench.agents.baselines import read_baseline

    book, card = _Book(), task_card(spec)
    try:
        baseline = read_baseline(path)
        book.add([], "card", "files")
        agent = baseline.make(card)
        if baseline.sees == "observations":
            cast(Agent, agent).reset(card, 1)
        book.add([], "loading")
        book.facts["loading"] = f"settings for glbench's controller {baseline.card.controller}; no code to run"
    except GlbenchError as error:
        book.add([problem("loading", str(error))])
    name = path.resolve().name
    return Report(name, "settings", spec.id, tuple(book.findings), frozenset(book.checked), book.facts, time.monotonic() - began)


@dataclass
class _Book:
    """What was found so far."""

    findings: list[Finding] = field(default_factory=list)
    checked: set[Subject] = field(default_factory=set)
    facts: dict[Subject, str] = field(default_factory=dict)

    def add(self, results: Sequence[Finding], *subjects: Subject) -> None:
        self.findings += results
        self.checked |= {*subjects, *(finding.subject for finding in results)}

    @property
    def hopeless(self) -> bool:
        """Whether running it would only say the same again."""
        return any(finding.level == "problem" and finding.subject in {"loading", "packages"} for finding in self.findings)


class _DryRun:
    """A few steps of an evaluation, shown again to fresh agents, together and alone; what goes wrong becomes a finding.

    All agents that are made live in one process, each from the file run afresh.
    """

    def __init__(self, submission: Identity, packages: Sequence[str], task: TaskSpec, book: _Book, seconds: float, *, walls: bool) -> None:
        self._task, self._book, self._seconds = task, book, seconds
        self._limits = TimeLimits.of_table(task.evaluation.time_limits)
        self._prints = Prints(_SIZES.printed)
        sizes = _SIZES if walls else _SIZES_OF_THE_MACHINE
        self._agent = SandboxedAgent.of(submission, task, 1, self._limits, sizes, self._prints, walls=walls)
        self._packages = packages
        self._deadline = time.monotonic() + seconds
        self._dialogue: list[tuple[NDArray[np.float32], NDArray[np.float64]]] = []
        self._stack = ExitStack()
        self._runner: AgentRunner

    def run(self) -> None:
        """Look at everything, in the order in which things can go wrong."""
        try:
            # Large enough for the answers of all runs.
            with self._stack:
                self._process = replace(self._agent, runs=RUNS).process()
                self._stack.callback(self._process.close)
                # Large packages, whose time is not the agent's, are imported first.
                self._process.ask(Kind.REHEARSE, 0, "\0".join(self._packages).encode(), seconds=_PACKAGES_SECONDS)
                self._process.answer(0, time.monotonic() + _PACKAGES_SECONDS, "importing its packages takes too long")
                self._deadline = max(self._deadline, time.monotonic() + _LEAST * self._seconds)
                if self._make(RUNS):
                    self._book.checked.add("loading")
                    # An agent that does not repeat itself would be found to decide differently alone, too.
                    if self._short_run() and self._repeat():
                        self._alone()
                    self._book_surroundings()
        except LostError as error:
            self._book.add([problem("loading", f"{error.reason[:1].upper()}{error.reason[1:]}.")])
        except SandboxError as error:
            self._book.add([problem("loading", str(error))])
        except GlbenchError as error:
            self._book.add([problem("decisions", str(error))])
        self._book_printing()

    def _make(self, runs: int, *, again: bool = False) -> bool:
        """Make a new agent and reset it, outside of the time for steps. Report a failure and return false."""
        remaining, began = self._remaining(), time.monotonic()
        hasty = replace(
            self._limits,
            start=min(self._limits.start, max(round(remaining, 1), _SHORTEST_START)),
            step=min(self._limits.step, max(round(remaining / runs, 1), _SHORTEST_STEP)),
        )
        agent = replace(self._agent, runs=runs, time=hasty)
        when = " a second time" if again else ""
        try:
            self._runner = in_process(agent, self._process, single=agent.made_in(self._process))
        except SubmissionError as error:
            late = isinstance(error.__cause__, LostError) and error.__cause__.status == "timed_out"
            text = (
                f"It did not come back within {_duration(hasty.start)} while its file was loaded or in make_agent: it hangs, waits for "
                f"something, or this machine is too busy for it to start. The limit of an evaluation is {_duration(self._limits.start)}."
            )
            reason = f"The agent cannot be made{when}: {str(error).rstrip('.')}." if again else str(error)
            self._book.add([problem("loading", text if late else reason)])
            return False
        self._stack.callback(self._runner.close)  # it may have started another process
        failure = next(iter(self._runner.start()), None)
        if failure is not None:
            self._book.add([problem("loading", f"The agent cannot be made{when}: {failure.reason.rstrip('.')}.")])
        self._deadline += time.monotonic() - began
        return failure is None

    def _ask(self, observations: NDArray[np.float32], step: int) -> tuple[Decision, float]:
        """What it decides for the rows, and the seconds that this took; those of the first decision are not the check's."""
        began = time.perf_counter()
        decision = self._runner.decide(0, observations, np.ones(len(observations), dtype=np.bool_))
        took = time.perf_counter() - began
        if step == 1:
            self._deadline += took
        return decision, took

    def _short_run(self) -> bool:
        """Run a day in closed loop; false when it ends early, after which nothing can be compared."""
        loading = time.monotonic()
        simulation = Simulation(self._task, RUNS)
        first, steps = self._task.evaluation.first_seed, min(STEPS, self._task.steps)
        observations = simulation.reset(range(first, first + RUNS))
        began = until = time.monotonic()
        self._deadline += began - loading
        seconds, memory = list[float](), list[int]()
        for step in range(1, steps + 1):
            inputs = observations.astype(np.float32)
            decision, took = self._ask(inputs, step)
            if not self._accepted(decision, took, seconds):
                return False
            self._dialogue.append((inputs, decision.actions))
            seconds.append(took / RUNS)
            memory.append(self._process.memory())
            start = time.monotonic()
            outcome = simulation.step(decision.actions)
            observations = outcome.observations
            if step == 1:  # it may have compiled the kernel
                self._deadline += time.monotonic() - start
                until = time.monotonic() + _SHARE_RUN * self._remaining()
            if outcome.failed:
                text = f"Step {step} cannot be simulated with these actions: {outcome.failed[0].reason}."
                self._book.add([problem("decisions", text)])
                return False
            if time.monotonic() > until:
                break
        self._measured(seconds, memory)
        if len(seconds) < steps:
            part = f"Only {len(seconds)} of {steps} steps fitted into the check ({time.monotonic() - began:.0f} s)"
            self._book.add([note("time", f"{part}; what goes wrong later was not seen.")])
        return True

    def _accepted(self, decision: Decision, took: float, before: list[float]) -> bool:
        """Whether there are actions for all runs after decisions that took so long a run; why there are none is reported."""
        failure, step = _worst(decision), len(before) + 1
        if failure is not None and failure.status == "timed_out":
            # Agents for single runs have one clock each; what the others took does not matter.
            together, took = (RUNS, took) if failure.row is None else (1, min(took, self._runner.limits.step))
            self._book.add([_no_answer(took, together, before, self._task.steps, self._limits)])
            return False
        self._book.checked.add("decisions")
        if failure is None:
            return True
        if failure.row is None or failure.status != "invalid_action":
            last = next(iter(self._prints.last_lines(1)), "") if failure.status == "crashed" else ""
            heard = f' Its last words: "{last[:_LONGEST_QUOTE]}"' if last else ""
            text = f"act fails in step {step}: {failure.reason}.{heard} The runs it decides for would end there."
        else:
            who = "every run" if len(decision.failures) == RUNS else f"run {failure.row + 1} of {RUNS}"
            text = f"In step {step}, {who}: {failure.reason}. The run would end there, and each missing step costs."
        self._book.add([problem("decisions", text)])
        return False

    def _measured(self, seconds: list[float], memory: list[int]) -> None:
        """What decisions of one run took [s], and what memory was taken after each step [bytes]."""
        steps, runs = self._task.steps, self._task.evaluation.runs
        limits, results = self._limits, list[Finding]()
        first, later = seconds[0], seconds[1:]
        each, whole = _pace(seconds, steps)
        if max(seconds) > limits.step:
            text = f"One decision took {max(seconds):.1f} s a run; the limit is {limits.step:g} s."
            results.append(problem("time", text))
        if later and whole > limits.run:
            text = (
                f"All decisions of a run would take {_duration(whole)}: {_duration(first)} for the first one and {_duration(each)} for "
                f"each other one, the mean of {len(later)}. The limit is {_duration(limits.run)}: runs would end early."
            )
            results.append(problem("time", text))
        measured = f"the first one {1e3 * first:.3g} ms" if later else "the first one alone, which may take longer than others"
        self._book.facts["time"] = (
            f"{1e3 * each:.3g} ms a decision of one run, {measured}; at most {_duration(whole * runs)} for {runs} runs of {steps} steps"
        )
        half = memory[len(memory) // 2 :]  # the first half warms up
        growth = max(0.0, (half[-1] - half[0]) / (len(half) - 1)) if len(half) > 1 else 0.0
        reached = memory[-1] + growth * steps
        if reached > _SIZES.memory:
            text = (
                f"Memory grows by {growth / MIB:.2f} MiB a step and would reach {reached / GIB:,.1f} GiB by the end of a run; the limit is "
                f"{_SIZES.memory / GIB:,.0f} GiB. Keep only what the next decision needs."
            )
            results.append(problem("memory", text))
        self._book.facts["memory"] = f"{max(memory) / MIB:,.0f} MiB; limit {_SIZES.memory / MIB:,.0f} MiB"
        self._book.add(results, "time", "memory")

    def _replayed(self, rows: slice, subject: Subject, share: float) -> Iterator[tuple[int, Decision, NDArray[np.float64]]]:
        """Step, what a fresh agent decides when it is shown the same observations of ``rows`` again, and what was decided before.

        Ends after ``share`` of the time that is left; nothing where the agent cannot be made.
        """
        if not self._make(len(range(RUNS)[rows]), again=True):
            return
        self._book.checked.add(subject)
        until = time.monotonic()
        for step, (observations, before) in enumerate(self._dialogue, start=1):
            decision, _ = self._ask(observations[rows], step)
            if step == 1:
                until = time.monotonic() + share * self._remaining()
            yield step, decision, before[rows]
            if time.monotonic() > until:
                return

    def _repeat(self) -> bool:
        """Show a fresh agent the same observations: it must decide the same, to the last bit."""
        for step, decision, before in self._replayed(slice(None), "repeatable", _SHARE_REPEAT):
            failure = _worst(decision)
            if failure is not None and (failure.row is None or failure.status != "invalid_action"):
                self._book.add([_unrepeatable(step, None, failure.reason)])
                return False
            if decision.actions.tobytes() != before.tobytes():
                self._book.add([_unrepeatable(step, float(np.abs(decision.actions - before).max()), "")])
                return False
        return "repeatable" in self._book.checked

    def _alone(self) -> None:
        """Show fresh agents single runs: what they decide must not depend on the company."""
        for row in (0, RUNS - 1):
            for step, decision, together in self._replayed(slice(row, row + 1), "rows", _SHARE_ALONE):
                failure, difference = _worst(decision), float(np.abs(decision.actions - together).max())
                if failure is not None:
                    text = f"With one run instead of {RUNS} the agent fails in step {step}: {failure.reason}. So would `--runs 1`."
                    self._book.add([problem("rows", text)])
                    return
                if difference > 0.0:
                    self._book.add([_company(difference, step)])
                    return
            if "rows" not in self._book.checked:
                return

    def _book_surroundings(self) -> None:
        """Where the agent connected to and what it wrote, as it says itself; nothing once its process has ended."""
        activity: dict[str, list[str]] = {"c": [], "w": []}
        with suppress(LostError):
            self._process.ask(Kind.HEARD, 0, seconds=1.0)
            _, body = self._process.answer(0, time.monotonic() + 1.0, "no answer")
            for line in bytes(body).decode("utf-8", errors="replace").splitlines():
                activity.get(line[:1], []).append(line[2:])
        self._book.checked.add("surroundings")
        if activity["c"]:
            text = f"It connects to {', '.join(activity['c'])}. In the evaluation there is no network: bring along what it needs."
            self._book.add([problem("surroundings", text)])
        files = [file for file in activity["w"] if "__pycache__" not in file]  # by Python, of what is imported first here
        if files:
            text = f"It writes to {', '.join(files)}. In the evaluation only /tmp can be written to, and that is gone afterwards."
            self._book.add([problem("surroundings", text)])

    def _book_printing(self) -> None:
        size, limit = self._prints.size, _SIZES.printed
        text_of_size = f"It prints {size / 1024:,.0f} KiB in this short run"
        self._book.checked.add("printing")
        if size > limit:
            text = f"{text_of_size}. Of an evaluation only the beginning and the end are kept, and printing takes time."
            self._book.add([problem("printing", text)])
        elif size > _PRINTED_NOTE:
            self._book.add([note("printing", f"{text_of_size}. Of an evaluation only the beginning and the end are kept.")])
        if size:
            self._book.facts["printing"] = f"{size} bytes"

    def _remaining(self) -> float:
        """Seconds until the whole check should be over."""
        return max(self._deadline - time.monotonic(), 0.1)


def _worst(decision: Decision) -> Failure | None:
    """The failure that says most: one of a call before one of an action."""
    return next(
        (one for one in decision.failures if one.row is None or one.status != "invalid_action"), next(iter(decision.failures), None)
    )


_SAME = 1e-4  # Differences of an action that rounding explains; what is larger is information from other runs


def _company(difference: float, step: int) -> Finding:
    """A run alone was decided differently, by ``difference``, than among others."""
    if difference > _SAME:
        text = (
            f"A run shown alone is decided differently than among others, by {difference:.2g} in step {step}: rows learn of each other. "
            "Decide each row from that row only, and keep one memory a row."
        )
        return problem("rows", text)
    text = (
        f"A run shown alone is decided differently than among others in the last digits ({difference:.1g} in step {step}), as matrix "
        "products round by the size of a batch. `--runs 1` will differ a little from the first of many runs."
    )
    return note("rows", text)


def _unrepeatable(step: int, difference: float | None, reason: str) -> Finding:
    """A fresh agent decided differently by ``difference``, or failed for a ``reason``."""
    how = f"by up to {difference:.2g}" if difference is not None else f"because it failed: {reason}"
    text = (
        f"Shown the same observations again, a fresh agent decided differently in step {step}, {how}. Draw random numbers from a "
        "generator that is seeded in reset, and do not look at the clock: otherwise nobody can repeat the result."
    )
    return problem("repeatable", text)


def _pace(seconds: Sequence[float], steps: int) -> tuple[float, float]:
    """What a decision of a run takes after the first one, and all ``steps`` of them, from the ``seconds`` of the first ones.

    Agents that plan take long for their first decision, and shorter for all others.
    """
    first, later = seconds[0], seconds[1:] or seconds
    each = sum(later) / len(later)
    return each, first + (steps - 1) * each


def _no_answer(seconds: float, runs: int, before: Sequence[float], steps: int, limits: TimeLimits) -> Finding:
    """``act`` was stopped after so many ``seconds`` for that many runs; the decisions ``before`` took so long a run."""
    whom = "one run" if runs == 1 else f"{runs} runs"
    began = f"act did not come back within {_duration(seconds)} for {whom} in step {len(before) + 1}"
    each = seconds / runs
    if each >= limits.step:
        return problem("time", f"{began}. The limit is {limits.step:g} s for one decision of one run.")
    _, whole = _pace([*before, each], steps)
    if before and whole > limits.run:
        text = f"{began}. At that pace all decisions of a run take {_duration(whole)} or more, and the limit is {_duration(limits.run)}."
        return problem("time", text)
    may = "not for an evaluation" if before else "the first decision of an evaluation may take that long"
    return note("time", f"{began}, which is too slow for this check, though {may}: more was not seen.")


def _duration(seconds: float) -> str:
    """Seconds, minutes or hours, as suits."""
    if seconds < 90:
        return f"{seconds:.2g} s" if seconds < 10 else f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
