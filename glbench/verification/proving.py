"""Verification: simulates every run again from task, seed and recorded actions, and compares all that follows with the result."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from glbench.agents.baselines import shipped_digest
from glbench.episodes import ActionLog, Replay, Trace, episodes_folder
from glbench.episodes.header import versions as recorded_versions
from glbench.episodes.recorder import LARGEST_TRACE, bytes_a_step
from glbench.errors import ActionError, GlbenchError, ResultError
from glbench.evaluation import Result, evaluate
from glbench.evaluation.fresh_draws import REFERENCES
from glbench.evaluation.limits import Failure
from glbench.evaluation.metrics import units_of
from glbench.evaluation.profiles import load_profile, make_profile
from glbench.evaluation.records import FreshDraws, RunResult, current_versions, this_machine, usable_cores
from glbench.evaluation.rollout import RunTotals
from glbench.kernel import Kernel, available
from glbench.tasks import Round, TaskSpec
from glbench.verification import documents, proof

Progress = Callable[[int, int], None]
"""Called with the steps done and the steps there are."""


def verify(
    path: Path | str,
    *,
    episodes: Path | None = None,
    task: Path | None = None,
    sealed: Round | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> proof.Verdict:
    """Reproduce or refute one result from its records alone; the agent is not needed.

    ``path`` is the result file, with its recorded actions beside it; ``episodes`` the folder with full episodes, by default where
    ``glbench evaluate`` puts them, if there are any; ``task`` the file of a task that is not published, by default the definition in the
    record. ``sealed`` is the round that the result is to be of, with its secret. Without it, what can be checked of a result of a sealed
    round is checked, and the outcome is ``"sealed"`` at best. ``workers`` processes simulate, by default what is fastest here; ``progress``
    is called after every step. The verdict says what was reproduced, what differs, or what is missing to verify it.
    """
    path = Path(path)
    try:
        result, content = documents.read_result(path)
        folder = (episodes or episodes_folder(path), episodes is not None)
        runs = _reproduced(path, result, task, sealed, folder, workers, progress)
        if result.fresh_draws is not None:
            runs = _with_fresh_draws(path, result, result.fresh_draws, task, runs, workers, progress)
    except proof.Refused as refused:
        return proof.Verdict(path, refused.outcome, refused.cause, refused.reason)
    agreement = runs.agreement
    reproduced, claims = proof.coverage(result, profile=runs.profiled, references=runs.references)
    earn = "run earns" if len(result.runs) == 1 else "runs earn"
    if result.fresh_draws is not None:
        earn = "runs, and as many with fresh draws, earn"
    reason = f"{len(result.runs)} {earn} what the result says"
    if agreement.exact:
        reason += ": the same bits."
    else:
        reason += f" within {proof.TOLERANCE:g} relative (largest difference {agreement.largest:.1e}), not to the last bit. {runs.origin}"
    exactness: proof.Exactness = "bits" if agreement.exact else "tolerance"
    facts = runs.notes, runs.runs, runs.steps, runs.episodes, reproduced, claims, proof.sha256_of(path, content), result.created
    return proof.Verdict(path, "reproduced", "", reason, exactness, agreement.largest, *facts)


@dataclass(frozen=True, eq=False)
class _Reproduced:
    """Facts about runs that were reproduced."""

    task: TaskSpec
    agreement: proof.Agreement
    origin: str
    notes: tuple[str, ...]
    profiled: bool
    episodes: tuple[int, ...]
    runs: int
    steps: int
    references: bool = False
    """Whether the runs of reference agents were evaluated again, too."""


def _reproduced(
    path: Path,
    result: Result,
    file: Path | None,
    sealed: Round | None,
    episodes: tuple[Path, bool] | None,
    workers: int | None,
    progress: Progress | None,
) -> _Reproduced:
    """Simulate the runs of ``result`` again; raise ``Refused`` if they differ. ``episodes``: a folder, and whether some must be there."""
    log = documents.read_record(path, result)
    spec = documents.with_its_draws(result, documents.find_task(result, log, file), sealed)
    notes = documents.check_seeds(result, spec)
    documents.check_setting(result, log, spec)
    units = units_of(spec)
    unknown = sorted(set(result.units) - set(units))
    if unknown:
        proof.cannot_tell("unknown_metrics", f"This glbench does not measure {', '.join(unknown)}. Verify with the one that did.")
    other = {name: unit for name, unit in result.units.items() if unit != units[name]}
    if other:
        proof.refute(
            "units",
            f"The result gives units that are not the task's: {', '.join(f'{n} in {u}, not {units[n]}' for n, u in other.items())}.",
        )
    ranks = spec.evaluation.metric
    if ranks not in result.units:
        proof.refute("metric", f"The result lacks the metric '{ranks}', by which {spec.id} is ranked.")
    if result.task.salt_commitment != spec.salt_commitment:
        _stay_sealed(path, result, log, spec, workers, progress)
    whole, complaint = [], None
    if episodes is not None:
        try:
            whole = documents.read_episodes(episodes[0], log, required=episodes[1])
        except proof.Refused as refused:
            complaint = refused  # counts only when the result itself is right
    profiled = _profile_is_there(path, result, spec)
    with _kernel(result, spec, workers) as kernel:
        origin = _origin(result, spec, kernel)
        rows = range(len(log.runs)) if profiled else [row for row, _ in whole]
        again = _simulate(spec, log, rows, kernel, progress)
    agreement = _agreement(result, spec, log, again)
    same = agreement.exact or again.has_same_arithmetic(log)
    _refuse(agreement, same_arithmetic=same, origin=origin)
    documents.check_sums(result, log, spec)
    for claimed, run in zip(result.runs, again.runs, strict=True):
        differs = (claimed.status, claimed.steps) != (run.status, run.steps)
        if differs or (agreement.exact and claimed.reason != run.reason):
            reason = (
                f"The run with seed {claimed.seed} is '{claimed.status}' after {claimed.steps} steps in the result; its actions lead to "
                f"'{run.status}' after {run.steps} steps ({run.reason or 'to the end'})."
            )
            proof.refute("status", reason)
    if complaint is not None:
        raise complaint
    for row, episode in whole:
        assert again.trace is not None
        replayed = again.trace.episode(spec, row, log.provenance, log.runs[row], log.actions[:, row])
        agreement = documents.compare_episode(agreement, episode, replayed)
    _refuse(agreement, same_arithmetic=same, origin=origin)
    profiled = profiled and agreement.exact
    if profiled and result.profile is not None:
        profile = make_profile(spec, result, log, again.trace)
        if profile.digest != result.profile.digest:
            proof.refute("profile", f"{result.profile.file} does not show what the recorded actions lead to. Delete it and evaluate again.")
    seeds = tuple(log.runs[row].seed for row, _ in whole)
    steps = sum(run.steps for run in result.runs)
    return _Reproduced(spec, agreement, origin, notes, profiled, seeds, len(result.runs), steps)


def _with_fresh_draws(
    path: Path, result: Result, fresh: FreshDraws, file: Path | None, runs: _Reproduced, workers: int | None, progress: Progress | None
) -> _Reproduced:
    """Simulate the runs with fresh draws again, evaluate the reference agents with both sets of draws, and add both to ``runs``."""
    try:
        again = _reproduced(path, result.of_fresh_draws(), file, Round(fresh.salt), None, workers, progress)
    except proof.Refused as refused:
        reason = f"The runs with fresh draws: {refused.reason}"
        raise proof.Refused(refused.outcome, refused.cause, reason) from None
    if fresh.metric != runs.task.evaluation.metric:
        proof.refute("fresh_draws", f"The fresh draws state the metric '{fresh.metric}', and {result.task.id} is ranked by another metric.")
    exact = runs.agreement.exact and again.agreement.exact
    unlike = []
    for one in fresh.references:
        try:
            is_alike = one.name in REFERENCES and one.digest == shipped_digest(one.name)
        except GlbenchError:
            is_alike = False
        if not is_alike:
            unlike.append(one.name)
    if exact and not unlike:
        seeds = result.evaluation.seeds
        for one in fresh.references:
            for task, claims, draws in ((runs.task, one.published, "published"), (again.task, one.fresh, "fresh")):
                reference = evaluate(task, one.name, runs=len(seeds), first_seed=seeds[0], workers=workers or usable_cores())
                values = reference.values(task.evaluation.metric)
                if values != tuple(claims):
                    seed, was, now = next(row for row in zip(seeds, claims, values, strict=True) if row[1] != row[2])
                    reason = (
                        f"The result states {was!r} for the reference agent {one.name} in the run with seed {seed} of the {draws} "
                        f"draws; it earns {now!r}."
                    )
                    proof.refute("reference", reason)
        checked, notes = True, runs.notes
    else:
        why = f"this glbench does not have {', '.join(unlike)}" if unlike else "this machine computes other bits"
        note = f"The reference agents of the fresh draws were not evaluated again: {why}."
        checked, notes = False, (*runs.notes, note)
    return replace(
        runs,
        agreement=max(runs.agreement, again.agreement, key=lambda one: (not one.exact, one.largest)),
        notes=notes,
        runs=runs.runs + again.runs,
        steps=runs.steps + again.steps,
        references=checked,
    )


def _stay_sealed(path: Path, result: Result, log: ActionLog, spec: TaskSpec, workers: int | None, progress: Progress | None) -> NoReturn:
    """End the verification of a result whose draws are secret; ``spec`` has the public ones, with which it must not be reproduced."""
    documents.check_sums(result, log, spec)
    _profile_is_there(path, result, spec)
    scenario = spec.scenario
    # Whether runs draw numbers, which another salt changes, rather than one of a few seasons and days.
    has_numbers = any(group.half_width > 0.0 for group in scenario.groups)
    has_numbers = has_numbers or any(group.half_width > 0.0 for group in scenario.start_groups)
    has_numbers = has_numbers or scenario.generated is not None or spec.sensors is not None or spec.outdoor_sensors is not None
    if has_numbers:
        facts = log.provenance.task.model_copy(update={"salt_commitment": None})
        public = replace(log, provenance=log.provenance.model_copy(update={"task": facts}))
        with _kernel(result, spec, workers) as kernel:
            agreement = _agreement(result, spec, log, _simulate(spec, public, (), kernel, progress))
        if agreement.largest <= proof.CHAOS:
            proof.refute("public_draws", "The result says that its draws are sealed, and the public draws lead to its numbers.")
    proof.not_yet(
        f"Its draws belong to the sealed round {result.task.salt_commitment}, and nobody can simulate them without the round's secret. "
        "Checked: the result agrees with itself and with its recorded actions; task, seeds and kernel are right; the rewards add "
        f"up{'; the public draws do not lead there' if has_numbers else ''}. Not checked: that the actions earn these rewards. Once "
        "the host has published the round's file, verify with --round FILE."
    )


@dataclass(frozen=True, eq=False)
class _Again:
    """What came out of simulating again."""

    runs: tuple[RunResult, ...]
    rewards: NDArray[np.float64]
    final_states: NDArray[np.float64]
    trace: Trace | None

    def has_same_arithmetic(self, log: ActionLog) -> bool:
        """Whether rewards or final state of a run, one of the longest, are the same bits: then this machine computes as that one did."""
        longest = max(run.steps for run in log.runs)
        rows = [row for row, run in enumerate(log.runs) if run.steps == longest > 0]
        rewards = proof.same_bits(log.rewards[:longest, rows], self.rewards[:longest, rows]).all(axis=0)
        return bool(rewards.any() or proof.same_bits(log.final_states[rows], self.final_states[rows]).all(axis=1).any())


def _kernel(result: Result, task: TaskSpec, workers: int | None) -> Kernel:
    """The kernel that made the result where it works here, else the best there is."""
    recorded = str(result.evaluation.kernel.get("backend"))
    backend = recorded if recorded in available(task.model_value) else "auto"
    return Kernel(task.model_value, task.step_seconds, backend=backend, threads=min(workers or 1, len(result.runs)))


def _origin(result: Result, task: TaskSpec, kernel: Kernel) -> str:
    """What the result states of its machine, beside this one: an explanation of differences for people, and evidence of nothing."""
    here, there = this_machine(), result.machine
    versions = current_versions(recorded_versions(task)["model"]).model_dump()
    others = [name for name, number in result.versions.model_dump().items() if versions.get(name) != number and name != "gymnasium"]
    differences = []
    if (here.processor, here.architecture) != (there.processor, there.architecture):
        differences.append(f"the processor {there.processor} ({there.architecture}; here {here.processor}, {here.architecture})")
    if others:
        differences.append(f"other versions of {', '.join(others)}")
    described, recorded = kernel.describe(), result.evaluation.kernel
    kinds = [name for name in {**described, **recorded} if described.get(name) != recorded.get(name)]
    if described["backend"] != recorded.get("backend"):
        differences.append(f"the kernel '{recorded.get('backend')}' (here '{described['backend']}')")
    elif kinds:
        differences.append(f"a kernel that differs in {', '.join(kinds)}")
    return f"The result states {' and '.join(differences)}." if differences else "The result states this very machine and kernel."


def _profile_is_there(path: Path, result: Result, task: TaskSpec) -> bool:
    """Whether the result names a profile, which is beside it and can be made again within the memory of a trace."""
    if result.profile is None or task.steps * len(result.runs) * bytes_a_step(task) > LARGEST_TRACE:
        return False
    try:
        return load_profile(result, path) is not None
    except ResultError as error:
        proof.refute("profile", str(error))


def _simulate(task: TaskSpec, log: ActionLog, traced: Sequence[int], kernel: Kernel, progress: Progress | None) -> _Again:
    """All runs again, booked as the evaluation books them."""
    replay = Replay(task, log, kernel=kernel)
    totals, rewards = RunTotals(task, log.seeds), np.zeros_like(log.rewards)
    trace = Trace(replay.simulation, traced) if traced else None
    ends = {row: Failure(row, run.status, run.reason or "") for row, run in enumerate(log.runs)}
    last = np.array([run.actions for run in log.runs])
    steps = iter(replay.steps())
    for step in range(task.steps):
        totals.end(ends[int(row)] for row in np.flatnonzero(last <= step))
        try:
            outcome = next(steps, None)
        except ActionError as error:
            proof.refute("invalid_action", f"The task does not allow a recorded action of step {step + 1}: {error}")
        if outcome is None:
            break
        ended = totals.add(outcome)
        if ended:
            replay.simulation.end(ended)
        rewards[step] = np.where(totals.alive, outcome.rewards, 0.0)
        if trace is not None:
            trace.add(replay.simulation, outcome)
        if progress is not None:
            progress(step + 1, task.steps)
    return _Again(totals.results(), rewards, np.array(replay.simulation.x), trace)


def _refuse(agreement: proof.Agreement, *, same_arithmetic: bool, origin: str) -> None:
    refused = agreement.verdict(same_arithmetic=same_arithmetic, origin=origin)
    if refused is not None:
        raise refused


def _agreement(result: Result, task: TaskSpec, log: ActionLog, again: _Again) -> proof.Agreement:
    """Rewards of every step, final states and metrics."""
    seeds = tuple(f"reward of the run with seed {seed}" for seed in log.seeds)
    agreement = proof.Agreement().add("reward", log.rewards, again.rewards, seeds, "recorded rewards")
    if tuple(run.cluster for run in result.runs) != tuple(run.cluster for run in again.runs):
        proof.refute("task_facts", "The seasons that the runs name (cluster) are not those that they are in.")
    names = tuple(name for name in units_of(task) if name in result.units)  # an earlier glbench may have measured fewer
    metrics, earned = (np.array([[run.metrics[name] for name in names] for run in runs]) for runs in (result.runs, again.runs))
    for row, run in enumerate(result.runs):
        states, reached = log.final_states[row : row + 1], again.final_states[row : row + 1]
        agreement = agreement.add("state", states, reached, task.model_value.state_names, f"final state of the run with seed {run.seed}")
        where = f"metrics of the run with seed {run.seed}"
        agreement = agreement.add("metric", metrics[row : row + 1], earned[row : row + 1], names, where)
    return agreement
