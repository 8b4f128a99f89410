"""What can be recorded as an agent, and what not."""

from __future__ import annotations

import pytest

from glbench.errors import EpisodeError
from glbench.evaluation import evaluate, result_path
from glbench.evaluation.saving import write_recording
from tests.episodes.day import FAILING
from tests.evaluation.agent_files import agent_writer


def test_what_cannot_be_recorded_is_refused_in_words(day_task, tmp_path):
    agent = agent_writer(tmp_path)(FAILING, "stumbling")
    evaluate(day_task, agent, out=tmp_path)
    path = result_path(tmp_path, day_task.id, "stumbling")
    with pytest.raises(EpisodeError, match=r"no run with seed 10000. Its seeds: 666, 667, 668"):
        write_recording(path, 10000, tmp_path / "new")
    with pytest.raises(EpisodeError, match=r"seed 667 .* failed"):
        write_recording(path, 667, tmp_path / "new")
    evaluate(day_task, "rule_based", out=tmp_path)
    with pytest.raises(EpisodeError, match="rule_based sets controls directly"):
        write_recording(result_path(tmp_path, day_task.id, "rule_based"), 666, tmp_path / "new")
    evaluate(day_task, "rule_based_fair", out=tmp_path)
    fair = result_path(tmp_path, day_task.id, "rule_based_fair")
    with pytest.raises(EpisodeError, match="is there already"):
        write_recording(fair, 666, tmp_path)
