"""A recording of what an agent did in one run, as a folder that can be evaluated like any agent."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from glbench.agents.identity import CARD_FILE
from glbench.agents.plans import Recording
from glbench.errors import EpisodeError
from glbench.evaluation.episodes import recorded_actions, task_of_result
from glbench.evaluation.files import load_result
from glbench.resources import write_atomically
from glbench.tasks import task_card

ACTIONS_FILE = "actions.npz"


def write_recording(result: Path, seed: int, folder: Path) -> Recording:
    """Write the actions of the run with ``seed`` of the stored ``result`` as an agent into the new folder ``folder``.

    Raises
    ------
    EpisodeError
        When there is no such run, it failed, its record is missing or damaged, the agent set controls directly, or the folder is not empty.
    """
    loaded = load_result(result)
    log = recorded_actions(loaded, result)
    agent, card = log.provenance.agent, task_card(task_of_result(loaded, result))
    if agent.acts != "actions":
        msg = f"{agent.name} sets controls directly and takes no actions that another agent could replay. Record an agent that acts."
        raise EpisodeError(msg)
    if seed not in log.seeds:
        msg = f"{result} has no run with seed {seed}. Its seeds: {', '.join(str(one) for one in log.seeds)}."
        raise EpisodeError(msg)
    row = log.seeds.index(seed)
    run = log.runs[row]
    if run.status != "ok":
        msg = f"The run with seed {seed} of {result} failed ({run.reason}). Record one that did not."
        raise EpisodeError(msg)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        msg = f"{folder} is there already. Choose another folder with --out."
        raise EpisodeError(msg)
    recording = Recording(
        actions=log.actions[: run.actions, row].astype(np.float32),
        names=card.action_names,
        low=tuple(action.low for action in card.actions),
        high=tuple(action.high for action in card.actions),
        actuation=card.actuation,
        about={
            "agent": agent.name,
            "agent_digest": agent.digest,
            "task": loaded.task.id,
            "task_digest": loaded.task.digest,
            "seed": seed,
        },
    )
    write_atomically(folder / ACTIONS_FILE, recording.to_bytes())
    write_atomically(folder / CARD_FILE, _card(agent.name, loaded.task.id, seed))
    return recording


def _card(agent: str, task: str, seed: int) -> str:
    """The text of the folder's card."""
    card = {
        "title": f"Recording of {agent}, seed {seed}",
        "controller": "recording",
        "settings": ACTIONS_FILE,
        "description": f"The actions that {agent} took in the run with seed {seed} of {task}, replayed without looking at any observation. "
        f"What it earns beside {agent} tells what feedback is worth there.",
        "made": f"glbench evaluate {agent} --task {task} --seed {seed} --runs 1, then glbench episodes recording RESULT --run {seed}",
    }
    # A string of JSON is one of TOML; names come from a result, which may be a stranger's.
    return (
        "".join(f"{key} = {json.dumps(value, ensure_ascii=False)}\n" for key, value in card.items()) + "sources = []\n"
    )
