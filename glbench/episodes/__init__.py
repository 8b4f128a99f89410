"""Records of episodes: what happened in every step of a run, where it comes from, and how to run it again.

``read(path)`` gives a DataFrame; ``docs/episodes.md`` explains the files.
"""

from glbench.episodes.action_log import ActionLog, is_action_log, log_bytes, read_log
from glbench.episodes.episode import Episode, EpisodeWriter, by_week, episode_bytes, read, read_episode, recover, write_episode
from glbench.episodes.header import AgentFacts, Provenance, RunFacts, TaskFacts, provenance_of
from glbench.episodes.recorder import (
    Recorder,
    Replay,
    Trace,
    actions_path,
    chosen_rows,
    episode_path,
    episodes_folder,
    parse_selection,
    replayed_episodes,
)
from glbench.episodes.signals import Column, Group

__all__ = [
    "ActionLog", "AgentFacts", "Column", "Episode", "EpisodeWriter", "Group", "Provenance", "Recorder", "Replay", "RunFacts", "TaskFacts",
    "Trace", "actions_path", "by_week", "chosen_rows", "episode_bytes", "episode_path", "episodes_folder", "is_action_log", "log_bytes",
    "parse_selection", "provenance_of", "read", "read_episode", "read_log", "recover", "replayed_episodes", "write_episode",
]  # fmt: skip
