"""``card.toml``: how an agent was made."""

from __future__ import annotations

import json
import platform
import re
import tomllib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from glbench import __version__
from glbench.agents.network_policy import Actor, read_actor
from glbench.errors import TrainingError, refuse
from glbench.evaluation.records import git_state, this_machine
from glbench.resources import write_atomically
from glbench.tasks import TaskSpec, task_card
from glbench.training.periodic_evaluation import CURVE, History
from glbench.training.settings import EvaluationPlan, TrainingSettings
from glbench.untrusted import reason_of

CARD, POLICY = "card.toml", "policy.npz"
_PACKAGES = ("torch", "stable-baselines3", "sb3-contrib", "cmaes", "jax", "numpy", "gymnasium", "casadi")
_NOT_LEARNT = "Nothing was learnt: this is the policy that the training began with, which no later one of {:,} steps beat."
_SHARED = ("simulator", "policy", "learning")


def settings_digest(settings: TrainingSettings) -> str:
    """SHA-256 (hex) over all settings but the number of steps, which may be raised to train on."""
    content = settings.model_dump(mode="json", exclude={"n_timesteps", "start_from"})
    if settings.accrual is None:  # trainings from before there was one keep their digests
        del content["accrual"]
    if settings.start_from is not None:
        content["start"] = sha256(settings.start_from.read_bytes()).hexdigest()  # its place does not matter
    return sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


@dataclass(frozen=True)
class TrainingFacts:
    """What a training's card says of it, in words and in figures.

    ``training`` is the card's table of that name: algorithm, seed, steps, settings and whatever else its kind of training has to tell.
    ``controller`` is what acts, with the settings in ``acts_with``.
    """

    title: str
    description: str
    command: str
    sources: tuple[str, ...]
    training: Mapping[str, Any]
    controller: str = "network"
    acts_with: str = POLICY


def digest_of_tasks(tasks: Sequence[TaskSpec]) -> str:
    """The task's digest; of several tasks SHA-256 (hex) over theirs."""
    return tasks[0].digest if len(tasks) == 1 else sha256(" ".join(task.digest for task in tasks).encode()).hexdigest()


def note_session(history: History, task: TaskSpec, steps: int) -> None:
    """Note with which versions and commit a training on ``task`` continues from ``steps``, unless they are those of the session before."""
    git = git_state()
    commit = [] if git is None else [f"commit {git.commit}{' with changes' if git.dirty else ''}"]
    words = ", ".join([*(f"{name} {number}" for name, number in _versions(task).items()), *commit])
    if not history.sessions or history.sessions[-1].partition(": ")[2] != words:
        history.sessions.append(f"from step {steps}: {words}")


def training_table(algorithm: str, settings: Any, digest: str, seed: int, steps: int) -> dict[str, Any]:
    """What the cards of all kinds have in their table of the training; ``digest`` is the settings'."""
    about = {"algorithm": algorithm, "seed": seed, "steps": steps, "kernel_preset": settings.kernel_preset}
    return {**about, "settings": "settings.yml", "settings_digest": digest, "learning_curve": CURVE}


def facts_of_training(task: TaskSpec, settings: TrainingSettings, digest: str, seed: int, steps: int, ends: Sequence[int]) -> TrainingFacts:
    """What the card of a training with Stable-Baselines3 says; ``digest`` is the settings', ``ends`` where it ended before it went on."""
    name = settings.algorithm.rpartition(".")[2]
    paid = "" if settings.accrual is None else f" {settings.accrual.in_words(task)}"
    return TrainingFacts(
        title=f"{name.upper() if name == settings.algorithm else name} trained on {task.id}, seed {seed}",
        description=f"The best model of {steps:,} steps by evaluation return, without the noise of exploration.{paid}",
        command="glbench train, with the settings in settings.yml; the tables below tell the rest.",
        sources=("Stable-Baselines3 (Raffin et al., 2021)",),
        training={
            **training_table(settings.algorithm, settings, digest, seed, steps),
            "first_env_seed": settings.first_env_seed,
            "n_envs": settings.n_envs,
            **({"ended_before_at": list(ends)} if ends else {}),
        },
    )


def write_card(
    folder: Path,
    tasks: TaskSpec | Sequence[TaskSpec],
    facts: TrainingFacts,
    evaluation: EvaluationPlan,
    history: History,
    start: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Write the card of a finished training to ``folder/card.toml``, with which the folder can be evaluated as an agent; its content.

    ``start`` tells of what it started from.
    """
    all_tasks = tasks if isinstance(tasks, Sequence) else (tasks,)
    task = all_tasks[0]
    ids = {"id": task.id} if len(all_tasks) == 1 else {"ids": [one.id for one in all_tasks]}
    spent = history.time
    shares = {name: round(seconds / spent.training, 4) for name, seconds in asdict(spent).items() if name in _SHARED}
    learnt = history.best_steps > 0
    where = this_machine()
    git = git_state()
    seasons: dict[str, Any] = {}
    if task.splits is not None:
        years = getattr(task.splits, str(task.split)).years
        seasons = {"split": task.split, "years": list(years), "chosen_on": task.chosen_on.split}
    content: dict[str, Any] = {
        "title": facts.title,
        "controller": facts.controller,
        "settings": facts.acts_with,
        "description": facts.description if learnt else _NOT_LEARNT.format(facts.training["steps"]),
        "made": facts.command,
        "sources": list(facts.sources),
        "task": {**ids, "digest": digest_of_tasks(all_tasks), "model": task.model_id},
        "training": {
            **facts.training,
            "recipe": _recipe(facts, all_tasks),
            **seasons,
            **({"sessions": history.sessions} if len(history.sessions) > 1 else {}),
            "finished": datetime.now(UTC).isoformat(timespec="seconds"),
        },
        "best": {
            "steps": history.best_steps,
            "reward": history.best_reward,
            "last_reward": history.last_reward,
            "learnt": learnt,
            "evaluation_seeds": evaluation.seeds(task.chosen_on),
        },
        "wall_seconds": {"total": round(spent.total, 1), **{k: round(v, 1) for k, v in asdict(spent).items()}},
        "share_of_training_time": shares,
        "versions": _versions(task),
        "machine": {"processor": where.processor, "cores": where.cores, "system": where.system},
    }
    if start is not None:
        content["start"] = dict(start)
    if git is not None:
        content["git"] = {"commit": git.commit, "dirty": git.dirty}
    write_atomically(folder / CARD, to_toml(content))
    return content


def _recipe(facts: TrainingFacts, tasks: Sequence[TaskSpec]) -> str:
    """Digest over algorithm, settings, length and tasks, which trainings with other seeds share. Leaderboards join trainings by it."""
    training = facts.training
    length = training.get("generations", training["steps"])
    identity = f"{training['settings_digest']} {length} {digest_of_tasks(tasks)}"
    name = re.sub(r"[^a-z0-9]+", "-", str(training["algorithm"]).lower()).strip("-")
    return f"{name or 'recipe'}-{sha256(identity.encode()).hexdigest()[:16]}"


def read_card(file: Path) -> dict[str, Any] | None:
    """The card, or ``None`` when there is none. Raises ``TrainingError`` when the file is there and no card."""
    try:
        card = tomllib.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, RecursionError) as error:
        refuse(f"Cannot read the card {file}: {reason_of(error)}. Remove it to train again.", TrainingError, error)
    if not {"task", "training", "best"} <= card.keys():
        refuse(f"{file} is not a card of a training. Choose another folder with --out.", TrainingError)
    return card


def to_toml(content: Mapping[str, Any]) -> str:
    """Text, numbers, truth values and lists of them, in tables one deep, as TOML."""
    plain = [f"{key} = {_value(value)}" for key, value in content.items() if not isinstance(value, Mapping)]
    tables = [
        "\n".join(
            [
                f"[{key}]",
                *(
                    f"{name if name.replace('-', '').replace('_', '').isalnum() else json.dumps(name)} = {_value(item)}"
                    for name, item in value.items()
                ),
            ]
        )
        for key, value in content.items()
        if isinstance(value, Mapping)
    ]
    return "\n\n".join(part for part in ["\n".join(plain), *tables] if part) + "\n"


def _value(value: Any) -> str:
    """As TOML, which writes these as JSON does; a string of several lines as it stands when it needs no escapes."""
    if isinstance(value, str) and "\n" in value and '"""' not in value and "\\" not in value:
        return f'"""\n{value}"""'
    return json.dumps(value, ensure_ascii=False)


def _versions(task: TaskSpec) -> dict[str, str]:
    versions = {"glbench": __version__, "model": task.model_id, "python": platform.python_version()}
    for package in _PACKAGES:
        with suppress(PackageNotFoundError):
            versions[package] = version(package)
    return versions


def policy_in(file: Path, task: TaskSpec) -> Actor:
    """The policy in ``file``, of either format.

    Raises ``SubmissionError`` when there is none, and ``TrainingError`` when it cannot act in ``task``.
    """
    policy = read_actor(file)
    reason = policy.why_not(task_card(task))
    if reason is not None:
        refuse(f"Cannot start from {file}: {reason}.", TrainingError)
    return policy


def start_of(file: Path) -> dict[str, Any]:
    """What a card says of the policy that a training starts from: file, digest, and the steps and seconds spent on it, if known.

    This includes what was spent on the policy that it started from itself.
    """
    content: dict[str, Any] = {"file": file.name, "digest": sha256(file.read_bytes()).hexdigest()}
    # A training's own folder, or a baseline's, which keeps policies and cards apart.
    for place in (file.with_name(CARD), file.parent.parent / "training" / f"{file.stem}.toml"):
        try:
            card = read_card(place)
        except TrainingError:  # the card of something else, such as an exported model
            continue
        if card is not None and "wall_seconds" in card:
            before = card.get("start", {})
            steps = card["training"]["steps"] + before.get("steps", 0)
            seconds = card["wall_seconds"]["total"] + before.get("wall_seconds", 0.0)
            return content | {"steps": steps, "wall_seconds": round(seconds, 1)}
    return content
