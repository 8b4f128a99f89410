"""Trajectories as a dataset of `Minari <https://minari.farama.org>`_, the format read by libraries for offline learning.

It needs the extra ``minari``. The files are Parquet, which needs no package beyond those of glbench.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
from gymnasium.envs.registration import EnvSpec

from glbench import __version__
from glbench.env.kernels import shared_kernel
from glbench.env.spaces import action_space, observation_space
from glbench.errors import EpisodeError, SubmissionError
from glbench.evaluation.provenance import git_state
from glbench.evaluation.sandbox.choosing import Protected
from glbench.evaluation.trajectories import FIRST_SEED, check_agent, check_learnable, trajectories
from glbench.registration import ENTRY_POINT, VECTOR_ENTRY_POINT
from glbench.tasks import get_task

if TYPE_CHECKING:
    from minari.dataset.minari_storage import MinariStorage

    from glbench.evaluation.trajectories import Trajectory
    from glbench.tasks import TaskSpec

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

    The dataset appears only when it is complete: an interruption leaves none.

    Parameters
    ----------
    dataset_id
        Minari's name of the dataset, such as ``glbench/spring/mixed-v0``. It goes to Minari's folder: ``MINARI_DATASETS_PATH``, or
        ``~/.minari/datasets``.
    task, agents, runs
        Season i of agent j, both counted from 0, has the seed ``first_seed + j runs + i``.
    noise, progress
        As for ``trajectories``.
    first_seed
        Seed of the first run, 10,000,000,000 or more.
    about
        Further entries of the metadata, such as ``author`` and ``code_permalink``.

    Raises
    ------
    TaskError, GlbenchError
        When held-out seasons would be used; see ``check_learnable``.
    SubmissionError
        When an agent does not act, fails, or is named twice.
    EpisodeError
        When Minari does not accept the name, the dataset exists, or it cannot be written.
    """
    check_learnable(task, first_seed, runs * len(agents))
    names = [agent.agent.name for agent in agents]
    for name in names:
        if names.count(name) > 1:
            msg = f"The agent '{name}' is named twice. Give each file or folder its own name, or use more runs."
            raise SubmissionError(msg)
    for agent in agents:
        check_agent(task, agent, first_seed)
    folder = _folder_of(dataset_id)
    seasons: list[Season] = []
    temporary: Path | None = None
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", suffix=".partial", dir=folder.parent))
        storage = _new_storage(temporary / "data", dataset_id, task, agents, noise, about or {})
        for place, agent in enumerate(agents):
            first = first_seed + place * runs
            made = trajectories(task, agent, range(first, first + runs), noise=noise, progress=progress)
            seasons += _store(storage, made, noise)
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o777 & ~umask)
        temporary.rename(folder)
    except OSError as error:
        msg = f"Cannot write {folder}: {error.strerror or error}. Set MINARI_DATASETS_PATH to a folder that you may write to."
        raise EpisodeError(msg) from error
    finally:
        if temporary is not None:
            shutil.rmtree(temporary, ignore_errors=True)  # gone where it was renamed
    _know_namespace(dataset_id)
    size = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
    return WrittenDataset(dataset_id, folder, tuple(seasons), size)


def _folder_of(dataset_id: str) -> Path:
    from minari.dataset.minari_dataset import parse_dataset_id
    from minari.storage import get_dataset_path

    try:
        parse_dataset_id(dataset_id)
    except (TypeError, ValueError):
        msg = f"'{dataset_id}' is not a valid name for a Minari dataset: it must end with a version, such as glbench/spring/mixed-v0."
        raise EpisodeError(msg) from None
    folder: Path = get_dataset_path(dataset_id)
    if folder.exists():
        msg = f"The dataset {dataset_id} exists ({folder}). Name another version, or remove it with `minari delete {dataset_id}`."
        raise EpisodeError(msg)
    return folder


def _know_namespace(dataset_id: str) -> None:
    from minari.dataset.minari_dataset import parse_dataset_id
    from minari.namespace import create_namespace, list_local_namespaces

    namespace, *_ = parse_dataset_id(dataset_id)
    if namespace is not None and namespace not in list_local_namespaces():
        create_namespace(namespace)


def _new_storage(
    data: Path, dataset_id: str, task: TaskSpec, agents: Sequence[Protected], noise: float, about: Mapping[str, str]
) -> MinariStorage:
    import minari
    from minari.dataset.minari_storage import MinariStorage

    storage: MinariStorage = MinariStorage.new(
        data, observation_space(task), action_space(task), env_spec=_spec(task), data_format=FORMAT
    )
    evaluated = _spec(task.chosen_on)
    storage.update_metadata(
        {
            "dataset_id": dataset_id,
            "algorithm_name": ", ".join(agent.agent.name for agent in agents),
            "description": _description(task, agents, noise),
            "licence": _licence(task),
            "requirements": [f"glbench=={__version__}"],
            "minari_version": minari.__version__,
            **({} if evaluated is None else {"eval_env_spec": evaluated.to_json()}),
            "glbench": _provenance(task, agents, noise),
            **{key: {value} if key in ("author", "author_email") else value for key, value in about.items()},
        }
    )
    return storage


def _store(storage: MinariStorage, made: Iterable[Trajectory], noise: float) -> Iterable[Season]:
    from minari.data_collector.episode_buffer import EpisodeBuffer

    for one in made:
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
    return (
        f"Seasons of {task.steps} steps of {task.id} ({task.title}) on {where}, under {names}{noisy}. {_licence(task)}"
    )


def _licence(task: TaskSpec) -> str:
    record = task.record()
    weather = f"{record.licence.rstrip('.')} ({record.source})"
    return f"Simulated with glbench {__version__}, which has the licence BSD-3-Clause. Weather: {weather}."


def _provenance(task: TaskSpec, agents: Sequence[Protected], noise: float) -> dict[str, Any]:
    git = git_state()
    return {
        "version": __version__,
        "commit": None if git is None else git.commit + (", changed" if git.dirty else ""),
        "task": {"id": task.id, "digest": task.digest, "split": task.split},
        "agents": {agent.agent.name: agent.agent.digest for agent in agents},
        "noise": noise,
        "kernel": shared_kernel(task.model_value, task.step_seconds).describe(),
    }
