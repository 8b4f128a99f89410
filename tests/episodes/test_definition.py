"""The definition of a task inside a record defines the same task."""

from __future__ import annotations

import pytest

from glbench.episodes.header import definition_json, task_of
from glbench.errors import EpisodeError
from glbench.tasks import list_tasks


@pytest.mark.parametrize("task", list_tasks(), ids=lambda task: task.short_id)
def test_every_shipped_task_survives_the_record(task):
    again = task_of(definition_json(task))
    assert again.digest == task.digest
    assert definition_json(again) == definition_json(task)


def test_a_broken_definition_is_refused_in_words():
    with pytest.raises(EpisodeError, match="cannot be read"):
        task_of(b'{"weather": {}}')
