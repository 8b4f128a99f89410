"""What newcomers read first names the default task, not one that was the default once."""

from __future__ import annotations

from pathlib import Path

import pytest

from glbench.tasks import DEFAULT_TASK

ROOT = Path(__file__).resolve().parents[2]
SHORT_ID = DEFAULT_TASK.removeprefix("glbench/")
NAMED = [
    ("README.md", f"**`{SHORT_ID.removesuffix('-v1')}`** (default)"),
    ("README.md", f'gymnasium.make("glbench:{DEFAULT_TASK}")'),
    ("docs/start.md", f"reports/results/{SHORT_ID}/my_agent.json"),
    ("docs/tasks.md", f"The default task, when none is named, is `{DEFAULT_TASK}`."),
    ("docs/submit.md", f"columns of the default task, `{DEFAULT_TASK}`"),
    ("docs/submit.md", f'gymnasium.make("glbench:{DEFAULT_TASK}")'),
    ("docs/submit.md", f'tasks = ["{DEFAULT_TASK}"]'),
    ("docs/environment.md", f'gymnasium.make("glbench:{DEFAULT_TASK}")'),
    ("docs/observations.md", f'gymnasium.make("glbench:{DEFAULT_TASK}", normalise=True)'),
    ("docs/training.md", f"glbench evaluate runs/ppo-{SHORT_ID}-seed0"),
    ("docs/training.md", f"glbench evaluate runs/rules-{SHORT_ID}-seed0"),
    ("docs/report.md", "glbench story my_agent  "),
    ("docs/serve.md", f"glbench serve {SHORT_ID}"),
    ("docs/growers.md", f"This is `{SHORT_ID}`"),
    ("docs/maintain.md", f"--task {DEFAULT_TASK} --round"),
    (".ci/submission", f"${{TASK:-{DEFAULT_TASK}}}"),
    (".github/pull_request_template.md", f"reports/results/{SHORT_ID}/NAME.json"),
    (".github/ISSUE_TEMPLATE/task.yml", f'base = "{DEFAULT_TASK}"'),
    *(
        (f"docs/notebooks/{name}.ipynb", f"`{DEFAULT_TASK}`")
        for name in ("first_agent", "own_task", "read_a_season", "train_and_beat_the_rules")
    ),
]


@pytest.mark.parametrize(("file", "words"), NAMED)
def test_the_default_task_is_the_one_that_is_named(file: str, words: str) -> None:
    assert words in (ROOT / file).read_text(encoding="utf-8")
