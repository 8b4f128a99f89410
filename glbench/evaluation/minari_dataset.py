"""Seasons of agents for offline learning, and a dataset of them for `Minari <https://minari.farama.org>`_.

A season has what a learner in the Gymnasium environment would have met: observations, actions, rewards, ends. Seasons come from the
training split, or from seeds that no task is scored with, so that they reveal nothing that is held out. Writing a dataset needs the extra
``minari``; its files are Parquet, which needs no package beyond those of glbench.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium.envs.registration import EnvSpec
from numpy.typing import NDArray

from glbench import __version__
from glbench.env import Simulation
from glbench.env.kernels import shared_kernel
from glbench.env.spaces import action_space, observation_space
from glbench.errors import EpisodeError, GlbenchError, SubmissionError, TaskError, refuse
from glbench.evaluation.limits import Failure, TimeLimits
from glbench.evaluation.records import git_state
from glbench.evaluation.runners import AgentRunner, make_runner
from glbench.evaluation.sandbox.choosing import Protected
from glbench.evaluation.sandbox.frames import Prints, SandboxLimits
from glbench.evaluation.sandbox.runners import SandboxedAgent, sandboxed_runner
from glbench.registration import ENTRY_POINT, VECTOR_ENTRY_POINT
from glbench.tasks import TaskSpec, get_task, task_card
from glbench.tasks.record import FIRST_TRAINING_SEED

if TYPE_CHECKING:
    from minari.dataset.minari_storage import MinariStorage


FIRST_SEED = 40_000_000_000  # Default seed of the first run; trainings, their evaluations and searches use smaller seeds
_LAST_SEED = 2**53
_TOGETHER = 32  # Seasons that are stepped together: enough for the kernel's speed, few enough for any memory


@dataclass(frozen=True, eq=False)
class Trajectory:
    """One season of T steps, with the types and, for the same seed and actions, the bits of the Gymnasium environment.

    ``seed`` is what ``reset`` takes. ``observations`` ``(T + 1, columns)`` float32 go from the first to the one after the last step;
    ``actions`` ``(T, m)`` float32 are as they were taken: with the noise, within their bounds; ``rewards`` ``(T,)`` are float64;
    ``terminations`` ``(T,)`` are true in the last step only. ``profit`` is the sum of the season's EPI [EUR m-2].
    """

    agent: str
    seed: int
    observations: NDArray[np.float32]
    actions: NDArray[np.float32]
    rewards: NDArray[np.float64]
    terminations: NDArray[np.bool_]
    profit: float


def check_learnable(task: TaskSpec, first_seed: int, seasons: int) -> None:
    """Refuse seasons that are held out.

    Raises ``TaskError`` for another split, or a task without training, ``GlbenchError`` for no seasons, or seeds that cannot be used.
    """
    task.check_training()
    if task.split not in (None, "training"):
        refuse(f"{task.id} is in its {task.split} split, which is held out: datasets for learning come from the training split.", TaskError)
    if seasons < 1:
        refuse("A dataset needs at least one season. Name at least one agent, and at least one run of each.", GlbenchError)
    last = first_seed + seasons - 1
    if not FIRST_TRAINING_SEED <= first_seed <= last <= _LAST_SEED:
        why = "are not for learning: tasks are scored with smaller seeds" if first_seed < FIRST_TRAINING_SEED else "are too large"
        refuse(f"Seeds {first_seed:,} to {last:,} {why}. Use seeds from {FIRST_TRAINING_SEED:,} to {_LAST_SEED:,}.", GlbenchError)


def check_agent(task: TaskSpec, agent: Protected, seed: int) -> None:
    """Refuse an agent that cannot begin a season of ``task``, or whose decisions are not actions of the environment.

    Raises ``SubmissionError`` for a controller that sets controls past the task's actuation, and for an agent that fails.
    """
    if agent.agent.acts == "controls":
        msg = (
            f"'{agent.agent.name}' sets controls past the task's actuation: what it does is not an action of the environment, so nothing "
            "can be learned from it there. Use an agent that acts, such as rule_based_fair or rule_based_tuned."
        )
        raise SubmissionError(msg)
    with closing(_runner(agent, task, [seed])) as runner:
        _refuse(runner.start(), agent.agent.name, [seed])


def trajectories(
    task: TaskSpec, agent: Protected, seeds: Sequence[int], *, noise: float = 0.0, progress: Callable[[int], None] | None = None
) -> Iterator[Trajectory]:
    """Seasons of ``agent`` on ``task``, one for each of ``seeds``, in their order; the bits do not depend on the other seeds.

    ``check_learnable`` and ``check_agent`` say what can be learned from. ``noise`` is the standard deviation of Gaussian noise on every
    action, in halves of its range, which belongs to the season's seed; the agent sees its effect, and the noisy action is kept.
    ``progress`` is called after every step with the number of seasons that took it. Raises ``SubmissionError`` when the agent fails.
    """
    for first in range(0, len(seeds), _TOGETHER):
        together = list(seeds[first : first + _TOGETHER])
        with closing(_runner(agent, task, together)) as runner:
            yield from _seasons(task, runner, agent.agent.name, together, noise, progress or (lambda _: None))


def _runner(agent: Protected, task: TaskSpec, seeds: Sequence[int]) -> AgentRunner:
    limits = TimeLimits.of_table(task.evaluation.time_limits)
    if agent.submission is None:
        return make_runner(agent.agent, task, task_card(task), seeds, limits)
    return sandboxed_runner(SandboxedAgent.of(agent.submission, task, len(seeds), limits, SandboxLimits(), Prints()))


def _seasons(
    task: TaskSpec, runner: AgentRunner, name: str, seeds: list[int], noise: float, progress: Callable[[int], None]
) -> Iterator[Trajectory]:
    simulation, (low, high) = Simulation(task, len(seeds)), task_card(task).action_bounds
    steps, n, m = task.steps, len(seeds), len(low)
    standard = [np.random.default_rng(seed).standard_normal((steps, m)) for seed in seeds] if noise else []
    added = [noise * (high - low) / 2.0 * one for one in standard] if noise else None
    actions = np.zeros((n, steps, m), dtype=np.float32)
    rewards, ends, profits = np.zeros((n, steps)), np.zeros((n, steps), dtype=np.bool_), np.zeros(n)
    lengths = np.zeros(n, dtype=np.int64)
    current = simulation.reset(seeds)
    observations = np.empty((n, steps + 1, current.shape[1]), dtype=np.float32)
    observations[:, 0] = current
    _refuse(runner.start(), name, seeds)
    for step in range(steps):
        alive = ~simulation.ended
        inputs = runner.inputs(simulation, current)
        runner.ask(step, inputs, alive)
        decision = runner.decide(step, inputs, alive)
        _refuse(decision.failures, name, seeds)
        target = decision.actions if added is None else decision.actions + np.array([one[step] for one in added])
        actions[:, step] = np.clip(target, low, high)
        result = simulation.step(actions[:, step])
        current = result.observations
        observations[:, step + 1], rewards[:, step], ends[:, step] = current, result.rewards, result.terminated
        profits += np.where(alive, result.quantities["epi"], 0.0)
        lengths += alive
        progress(int(alive.sum()))
        if simulation.ended.all():
            break
    for row, seed in enumerate(seeds):
        until = int(lengths[row])  # fewer than all where a step could not be simulated, which ends a season
        yield Trajectory(
            name, seed, observations[row, : until + 1], actions[row, :until], rewards[row, :until], ends[row, :until], float(profits[row])
        )


def _refuse(failures: Sequence[Failure], name: str, seeds: Sequence[int]) -> None:
    for failure in failures:
        where = "all seasons" if failure.row is None else f"the season of seed {seeds[failure.row]}"
        refuse(f"'{name}' failed in {where}: {failure.reason}. Nothing was written.", SubmissionError)


FORMAT = "parquet"


@dataclass(frozen=True)
class Season:
    """What a season of a dataset earned."""

    agent: str
    seed: int
    steps: int
    reward: float
    profit: float
    """Sum of the EPI [EUR m-2]."""


@dataclass(frozen=True)
class WrittenDataset:
    """A dataset that was written."""

    dataset_id: str
    folder: Path
    seasons: tuple[Season, ...]
    size: int
    """Size of all files [bytes]."""

    @property
    def steps(self) -> int:
        """Steps of all seasons."""
        return sum(season.steps for season in self.seasons)


def write_dataset(
    dataset_id: str,
    task: TaskSpec,
    agents: Sequence[Protected],
    runs: int,
    *,
    noise: float = 0.0,
    first_seed: int = FIRST_SEED,
    about: Mapping[str, str] | None = None,
    progress: Callable[[int], None] | None = None,
) -> WrittenDataset:
    """Write ``runs`` seasons of each agent on the training split of ``task`` as a Minari dataset; the same arguments give the same arrays.

    The dataset appears only when it is complete: an interruption leaves none. Raises ``TaskError, GlbenchError`` when held-out seasons
    would be used; see ``check_learnable``, and ``SubmissionError`` when an agent does not act, fails, or is named twice, and
    ``EpisodeError`` when Minari does not accept the name, the dataset exists, or it cannot be written.

    ``dataset_id`` is Minari's name of it, such as ``glbench/spring/mixed-v0``; it goes to Minari's folder: ``MINARI_DATASETS_PATH``, or
    ``~/.minari/datasets``. Season i of agent j, both counted from 0, has the seed ``first_seed + j runs + i``; ``first_seed`` is
    10,000,000,000 or more. ``noise`` and ``progress`` are as for ``trajectories``, ``about`` further entries of the metadata, such as
    ``author`` and ``code_permalink``.
    """
    check_learnable(task, first_seed, runs * len(agents))
    names = [agent.agent.name for agent in agents]
    for name in names:
        if names.count(name) > 1:
            refuse(f"The agent '{name}' is named twice. Give each file or folder its own name, or use more runs.", SubmissionError)
    for agent in agents:
        check_agent(task, agent, first_seed)
    folder = _folder_of(dataset_id)
    seasons: list[Season] = []
    temporary: Path | None = None
    try:
        there = next(parent for parent in folder.parents if parent.is_dir())
        temporary = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", suffix=".partial", dir=there))
        storage = _new_storage(temporary / "data", dataset_id, task, agents, noise, about or {})
        for place, agent in enumerate(agents):
            first = first_seed + place * runs
            agent_seasons = trajectories(task, agent, range(first, first + runs), noise=noise, progress=progress)
            seasons += _store(storage, agent_seasons, noise)
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o777 & ~umask)
        folder.parent.mkdir(parents=True, exist_ok=True)
        temporary.rename(folder)
    except OSError as error:
        msg = f"Cannot write {folder}: {error.strerror or error}. Set MINARI_DATASETS_PATH to a folder that you may write to."
        raise EpisodeError(msg) from error
    finally:
        if temporary is not None:
            shutil.rmtree(temporary, ignore_errors=True)  # gone where it was renamed
    from minari.dataset.minari_dataset import parse_dataset_id
    from minari.namespace import create_namespace, list_local_namespaces

    namespace, *_ = parse_dataset_id(dataset_id)
    if namespace is not None and namespace not in list_local_namespaces():
        create_namespace(namespace)
    size = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
    return WrittenDataset(dataset_id, folder, tuple(seasons), size)


def _folder_of(dataset_id: str) -> Path:
    from minari.dataset.minari_dataset import parse_dataset_id
    from minari.storage import get_dataset_path

    try:
        parse_dataset_id(dataset_id)
        folder: Path = get_dataset_path(dataset_id)  # makes the folder of all datasets
    except (TypeError, ValueError) as error:
        rule = "made of letters, digits, '_' and '-', with namespaces of two characters or more, and a version at the end"
        msg = f"'{dataset_id}' is not a valid name for a Minari dataset: it is {rule}, such as glbench/spring/mixed-v0."
        raise EpisodeError(msg) from error
    except OSError as error:
        reason = f"Cannot make {error.filename}: {error.strerror}. Set MINARI_DATASETS_PATH to a folder that you can write to."
        refuse(reason, EpisodeError, error)
    if folder.exists():
        msg = f"The dataset {dataset_id} exists ({folder}). Name another version, or remove it with `minari delete {dataset_id}`."
        raise EpisodeError(msg)
    return folder


def _new_storage(
    data: Path, dataset_id: str, task: TaskSpec, agents: Sequence[Protected], noise: float, about: Mapping[str, str]
) -> MinariStorage:
    import minari
    from minari.dataset.minari_storage import MinariStorage

    storage: MinariStorage = MinariStorage.new(data, observation_space(task), action_space(task), env_spec=_spec(task), data_format=FORMAT)
    evaluated, git = _spec(task.chosen_on), git_state()
    storage.update_metadata(
        {
            "dataset_id": dataset_id,
            "algorithm_name": ", ".join(agent.agent.name for agent in agents),
            "description": _description(task, agents, noise),
            "licence": _licence(task),
            "requirements": [f"glbench=={__version__}"],
            "minari_version": minari.__version__,
            **({} if evaluated is None else {"eval_env_spec": evaluated.to_json()}),
            "glbench": {
                "version": __version__,
                "commit": None if git is None else git.commit + (", changed" if git.dirty else ""),
                "task": {"id": task.id, "digest": task.digest, "split": task.split},
                "agents": {agent.agent.name: agent.agent.digest for agent in agents},
                "noise": noise,
                "kernel": shared_kernel(task.model_value, task.step_seconds).describe(),
            },
            **{key: {value} if key in ("author", "author_email") else value for key, value in about.items()},
        }
    )
    return storage


def _store(storage: MinariStorage, new: Iterable[Trajectory], noise: float) -> Iterable[Season]:
    from minari.data_collector.episode_buffer import EpisodeBuffer

    for one in new:
        season = Season(one.agent, one.seed, len(one.rewards), float(one.rewards.sum()), one.profit)
        place = storage.total_episodes
        buffer: Any = EpisodeBuffer(
            seed=one.seed,
            observations=one.observations,
            actions=one.actions,
            rewards=one.rewards,
            terminations=one.terminations,
            truncations=one.terminations & False,
        )
        storage.update_episodes([buffer])
        facts = {"agent": one.agent, "noise": noise, "return": season.reward, "profit": season.profit}
        storage.update_episode_metadata([facts], [place])
        yield season


def _spec(task: TaskSpec) -> EnvSpec | None:
    """The environment as Gymnasium makes it: of a shipped task by its id, of another by its file; ``None`` where there is neither."""
    shipped = task.id in gymnasium.registry and get_task(task.id).digest == task.digest
    if not shipped and not Path(task.source).is_file():
        return None
    name = task.id if shipped else str(Path(task.source).resolve())
    kwargs = {"task": name} | ({"split": task.split} if task.split is not None else {})
    return EnvSpec(task.id, entry_point=ENTRY_POINT, vector_entry_point=VECTOR_ENTRY_POINT, kwargs=kwargs)


def _description(task: TaskSpec, agents: Sequence[Protected], noise: float) -> str:
    names = ", ".join(agent.agent.name for agent in agents)
    where = "seeds that no task is scored with" if task.split is None else "its training split"
    noisy = f", with Gaussian noise of {noise:g} of half the range on every action" if noise else ""
    return f"Seasons of {task.steps} steps of {task.id} ({task.title}) on {where}, under {names}{noisy}. {_licence(task)}"


def _licence(task: TaskSpec) -> str:
    record = task.record()
    weather = f"{record.licence.rstrip('.')} ({record.source})"
    return f"Simulated with glbench {__version__}, which has the licence BSD-3-Clause. Weather: {weather}."
