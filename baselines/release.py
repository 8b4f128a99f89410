"""Evaluate every released agent again, verify the results, and put them into reports/released. Run it again and it continues.

    python baselines/release.py --work runs/release                  # what is released
    python baselines/release.py --work runs/release --list           # what is done and what is left
    python baselines/release.py --work runs/release --only recording # some agents
    python baselines/release.py --work runs/release --only my_agent --task Spring-v1  # an agent on a task that has no result of it yet
    python baselines/release.py --work runs/release --only mpc_energy --whole         # all runs, where only the first are released so far

All results come from one commit without changes and from one build of the kernel. Each must have the bits of the one that
is released, unless --new-digests says that the scores are meant to change. Results, profiles and notes of `glbench verify` are copied
when all three are right; what is not right is printed, stops nothing else, and makes the exit code 1.
"""

from __future__ import annotations

import argparse
import logging
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

from glbench.agents.identity import FORMS, baseline_names
from glbench.errors import GlbenchError, ResultError, did_you_mean
from glbench.evaluation import Progress, Result, load_result, prepare, protect, result_path
from glbench.evaluation.evaluation import TRIALS
from glbench.evaluation.fresh_draws import add_fresh_draws
from glbench.evaluation.jobs import Job as EvaluationJob
from glbench.evaluation.jobs import Options
from glbench.evaluation.profiles import profile_path
from glbench.evaluation.records import git_state
from glbench.leaderboard.collect import StoredResult, read_folder, same_runs
from glbench.resources import write_atomically
from glbench.tasks import get_task, list_tasks
from glbench.verification import proof_path, save_proof, verify
from glbench.weather.trace import TRACE

ROOT = Path(__file__).resolve().parent.parent
RELEASED = ROOT / "reports" / "released"
log = logging.getLogger("release")


@dataclass(frozen=True)
class Job:
    """An agent on a task; ``released`` is the results_digest that it must have again, ``None`` for a new one.

    ``fresh_draws``: whether the released result has fresh draws; the new one gets a new salt. A result with fewer runs than its task is not
    ranked, and gets as many again.
    """

    agent: str
    task_id: str
    released: str | None
    fresh_draws: bool = False
    runs: int | None = None
    """How many, the first ones; ``None`` for all."""

    def place(self, work: Path) -> Path:
        """Where its result is below ``work``: results of fewer runs are trials."""
        return result_path(work if self.runs is None else work / TRIALS, self.task_id, self.agent)

    @property
    def name(self) -> str:
        """Agent and task, as lines name them."""
        return f"{self.agent} on {self.task_id.rpartition('/')[2]}"

    @property
    def ref(self) -> str:
        """What ``glbench evaluate`` is to be given."""
        if self.agent in baseline_names():
            return self.agent
        places = [ROOT / "submissions" / f"{self.agent}{suffix}" for suffix in ("", *FORMS)]
        existing = [place for place in places if place.exists()]
        if not existing:
            msg = f"'{self.agent}' is neither a baseline nor in submissions/."
            raise GlbenchError(msg)
        return str(existing[0])


def plan() -> list[Job]:
    """Every released result; a task after the other."""
    results, problems = read_folder(RELEASED / "results")
    if problems:
        raise problems[0]
    jobs, whole = [], {task.id: task.evaluation.runs for task in list_tasks()}
    for one in (item.result for item in results):
        runs = one.summary.runs if one.summary.runs < whole.get(one.task.id, 0) else None
        jobs.append(Job(one.agent.name, one.task.id, one.results_digest, one.fresh_draws is not None, runs))
    return sorted(jobs, key=lambda job: (job.task_id, job.agent))


def main() -> int:
    """Release what is left of the plan, or list it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--work", type=Path, required=True, help="folder for evaluations before they are released")
    parser.add_argument("--only", nargs="*", default=[], metavar="AGENT", help="some of the agents")
    parser.add_argument("--task", nargs="*", default=[], metavar="ID", help="some of the tasks; with --only, also new ones")
    parser.add_argument("--runs", type=int, help="of new results: only the first runs, where all would take too long; they are not ranked")
    parser.add_argument("--whole", action="store_true", help="evaluate all runs, even where the released result has only the first ones")
    parser.add_argument("--new-digests", action="store_true", help="accept scores that differ from the released ones")
    parser.add_argument("--list", action="store_true", help="say what is done and leave")
    parser.add_argument("--out", type=Path, default=RELEASED, help="another folder than reports/released, to try it")
    arguments = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s", datefmt="%H:%M:%S", stream=sys.stdout)
    jobs = plan()
    agents, tasks = sorted({job.agent for job in jobs}), [get_task(name).id for name in arguments.task]
    examples = {path.stem for path in (ROOT / "submissions").glob("*.py")}
    for name in arguments.only:
        if name not in {*agents, *baseline_names(), *examples}:
            parser.error(f"there is no agent '{name}' to release.{did_you_mean(name, agents)}")
    if arguments.only and tasks:  # also on tasks that the agents have no released result of
        released = {(job.agent, job.task_id) for job in jobs}
        jobs += [Job(agent, task, None, runs=arguments.runs) for task in tasks for agent in arguments.only if (agent, task) not in released]
    jobs = [job for job in jobs if job.agent in (arguments.only or agents) and job.task_id in (tasks or [job.task_id])]
    if arguments.whole:
        jobs = [replace(job, runs=None, released=None) if job.runs is not None else job for job in jobs]
    state = git_state()
    if state is None or state.dirty:
        changed = "has changes that are not committed" if state is not None else "is no checkout of git"
        parser.error(f"{ROOT} {changed}: a release comes from a commit")
    work = arguments.work.resolve() / state.commit[:12]
    finished = [job for job in jobs if is_released(job, arguments.out, work)]
    if arguments.list:
        for job in jobs:
            print(f"{job.name:50} {'done' if job in finished else 'left'}")
        return 0
    log.info("%d results of commit %s, %d of them done", len(jobs), state.commit[:12], len(finished))
    refused = 0
    for number, job in enumerate(jobs, 1):
        if job in finished:
            continue
        began = time.monotonic()
        try:
            outcome = release(job, arguments.out, work, new_digests=arguments.new_digests)
        except KeyboardInterrupt:
            log.info("Interrupted; the same command continues")
            return 130
        except GlbenchError as error:
            refused += 1
            outcome = f"NOT RELEASED: {error}"
        log.info("%d/%d %s: %s (%.0f s)", number, len(jobs), job.name, outcome, time.monotonic() - began)
    if refused:
        log.info("%d of %d results are not released; the lines above say why", refused, len(jobs))
        return 1
    if edited := of_changed_checkouts(arguments.out):
        log.info("Of a changed checkout: %s. Release them again.", ", ".join(edited))
        return 1
    if older := unlike(arguments.out, work):
        log.info("%d released results are of another build of the kernel, the first is %s", len(older), older[0])
        if not (arguments.only or tasks):  # of a release of everything none may be left
            return 1
    return write_tables(arguments.out)


def release(job: Job, out: Path, work: Path, *, new_digests: bool) -> str:
    """Evaluate, check, verify, copy; what to say of it.

    Raises
    ------
    ResultError
        When the result is not what it should be.
    """
    task = get_task(job.task_id)
    agent = protect(job.ref, "bubblewrap")
    evaluation = prepare(task, agent, runs=job.runs, out=work, workers=None)
    result = evaluation.stored or evaluation.run(LogLines(job.name))
    check(job, result, work, new_digests=new_digests)
    if job.fresh_draws:
        add_fresh_draws(EvaluationJob(task, job.ref, agent, Options(work)), evaluated)
    path = job.place(work)
    if not is_ours(job):
        write_atomically(path, result.model_copy(update={"profile": None}).to_json())
    verdict = verify(path)
    if verdict.exactness != "bits":
        raise ResultError(verdict.reason)
    save_proof(verdict)
    if is_kept(job, result):
        return f"reward {result.summary.mean['reward']:,.1f}, reproduced; the released result keeps the digest of the agent at its time"
    for source, target in copies(job, work, out):
        write_atomically(target, source.read_bytes())
    new = "" if result.results_digest == job.released else ", new digest"
    return f"reward {result.summary.mean['reward']:,.1f}, digest {result.results_digest[:12]}{new}, reproduced"


def evaluated(job: EvaluationJob) -> Result:
    """The result of a part of an evaluation with fresh draws."""
    evaluation = job.prepare()
    return evaluation.stored or evaluation.run(LogLines(f"{job.agent_name}, for fresh draws"))


def check(job: Job, result: Result, work: Path, *, new_digests: bool) -> None:
    """Refuse a result of another commit or kernel build than its neighbours, with failed runs, or with other scores than released."""
    state = git_state()
    if result.git is None or result.git.dirty or result.git != state:
        msg = "the checkout changed while this was evaluated; commit, and start again"
        raise ResultError(msg)
    if result.summary.failed:
        reason = next(run.reason for run in result.runs if run.reason)
        msg = f"{result.summary.failed} of {result.summary.runs} runs failed, the first with: {reason}"
        raise ResultError(msg)
    kernel = result.evaluation.kernel
    if kernel["backend"] not in ("compiled", "discrete"):  # the second steps models that are maps, and has nothing to compile
        msg = f"the model was stepped by '{kernel['backend']}': a release needs a C++ compiler"
        raise ResultError(msg)
    for item in results_in(work):
        other = item.result.evaluation.kernel
        if model_of(item.result) == model_of(result) and other.get("library_digest") != kernel.get("library_digest"):
            msg = f"its kernel is another build than that of {item.path}; remove {work} and start again"
            raise ResultError(msg)
    if job.released not in (None, result.results_digest) and not new_digests and not is_kept(job, result):
        msg = f"results_digest {result.results_digest[:12]}, released {job.released[:12]}: the scores differ (--new-digests accepts that)"
        raise ResultError(msg)


def results_in(work: Path) -> list[StoredResult]:
    """All results in ``work``: those of all runs of a task, and those of its first runs."""
    return [item for folder in (work, work / TRIALS) for item in read_folder(folder / "results")[0]]


def is_kept(job: Job, result: Result) -> bool:
    """Whether the released result has these runs under an earlier digest of the agent, which grew since: it stays as it is."""
    if job.released in (None, result.results_digest):
        return False
    released = load_result(result_path(RELEASED, job.task_id, job.agent))
    return released.results_digest == job.released and same_runs(result, released)


def model_of(result: Result) -> tuple[str, str]:
    """Model and variant, each of which has a kernel of its own."""
    return result.versions.model, str(result.evaluation.kernel.get("variant"))


def is_released(job: Job, out: Path, work: Path) -> bool:
    """Whether ``out`` holds what was evaluated in ``work``, to the last byte."""
    pairs, path = copies(job, work, out), job.place(work)
    if job.released is not None and path.is_file() and proof_path(path).is_file() and is_kept(job, load_result(path)):
        return True
    if not all(source.is_file() and target.is_file() for source, target in pairs):
        return False
    return all(source.read_bytes() == target.read_bytes() for source, target in pairs)


def unlike(out: Path, work: Path) -> list[str]:
    """Results in ``out`` that stem from another build of the kernel than those in ``work``."""
    ours = [item.result for item in results_in(work)]
    builds = {model_of(result): result.evaluation.kernel.get("library_digest") for result in ours}
    names = []
    for item in read_folder(out / "results")[0]:
        build = item.result.evaluation.kernel.get("library_digest")
        if builds.get(model_of(item.result), build) != build:
            names.append(str(item.path.relative_to(out)))
    return names


def of_changed_checkouts(out: Path) -> list[str]:
    """Results in ``out`` that no commit stands for."""
    stored = read_folder(out / "results")[0]
    return [str(i.path.relative_to(out)) for i in stored if i.result.git is None or i.result.git.dirty]


def copies(job: Job, work: Path, out: Path) -> list[tuple[Path, Path]]:
    """Files to copy, and where to: profile, result, note."""
    ours, theirs = job.place(work), result_path(out, job.task_id, job.agent)
    return [(place(ours), place(theirs)) for place in ((profile_path, Path, proof_path) if is_ours(job) else (Path, proof_path))]


def is_ours(job: Job) -> bool:
    """Whether glbench may ship the weather of the task's seasons, which profiles have: not where it is read from a package."""
    return get_task(job.task_id).weather.source != TRACE


def write_tables(out: Path) -> int:
    """Normalised scores and tables from what is released now."""
    commands = [["leaderboard", "--write", "--all", "--strict", "--out", str(out)]]
    if out.resolve() == RELEASED:
        commands.insert(0, ["tasks", "references", "--write"])
    for command in commands:
        log.info("glbench %s", " ".join(command))
        code = subprocess.run([sys.executable, "-m", "glbench", *command], stdout=subprocess.DEVNULL, check=False).returncode
        if code != 0:
            return code
    return 0


class LogLines:
    """A line a minute."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._last = time.monotonic()

    def __call__(self, progress: Progress) -> None:
        """Say where an evaluation stands."""
        if time.monotonic() - self._last >= 60:
            self._last = time.monotonic()
            log.info("%s: step %d of %d", self._name, progress.step, progress.steps)


if __name__ == "__main__":
    sys.exit(main())
