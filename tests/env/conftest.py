"""Short tasks of one's own, made from a shipped file, and words that are forgotten after a test."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from glbench.env import ACTUATIONS, DISTRIBUTIONS, REWARDS, observations
from glbench.model import paper
from glbench.resources import data_folder
from glbench.tasks import TaskSpec, get_task
from glbench.tasks.vocabulary import ACTUATION_KINDS, OBSERVATION_MODULES, REWARD_MODULES
from glbench.tasks.vocabulary import DISTRIBUTIONS as DISTRIBUTION_WORDS
from tests.env.stepping import StillKernel

MakeTask = Callable[..., TaskSpec]


@pytest.fixture(scope="session")
def make_task(tmp_path_factory: pytest.TempPathFactory) -> MakeTask:
    """Task of one day from a shipped file, with lines replaced: ``make_task(("delta = 0.10", "delta = 0.0"))``."""
    folder = tmp_path_factory.mktemp("tasks")
    made: dict[tuple[object, ...], TaskSpec] = {}

    def make(*replacements: tuple[str, str], base: str = "schiphol2010-delta10-v1", days: int = 1) -> TaskSpec:
        key = (replacements, base, days)
        if key not in made:
            text = (data_folder("tasks") / f"{base}.toml").read_text(encoding="utf-8")
            changes = [("days = 60", f"days = {days}"), *replacements]
            if not any(old.startswith("id =") for old, _ in changes):
                changes.append(('id = "glbench/', f'id = "tests/N{len(made)}'))
            for old, new in changes:
                assert old in text, f"{old!r} is not in {base}.toml"
                text = text.replace(old, new, 1)
            path = folder / f"task{len(made)}.toml"
            path.write_text(text, encoding="utf-8")
            made[key] = get_task(str(path))
        return made[key]

    return make


@pytest.fixture(scope="session")
def day(make_task: MakeTask) -> TaskSpec:
    """The task with 10 % uncertainty, cut to one day of 96 steps."""
    return make_task()


@pytest.fixture
def own_words(monkeypatch: pytest.MonkeyPatch) -> None:
    """Words and models that a test registers are forgotten after it."""
    registries = (OBSERVATION_MODULES, REWARD_MODULES, ACTUATION_KINDS, DISTRIBUTION_WORDS)
    for registry in registries:
        monkeypatch.setattr(registry, "_entries", dict(registry._entries))
    for parts in (REWARDS, ACTUATIONS, DISTRIBUTIONS):
        monkeypatch.setattr(parts, "_makers", dict(parts._makers))
    monkeypatch.setattr(observations, "_MAKERS", dict(observations._MAKERS))
    monkeypatch.setattr(paper, "_MODELS", dict(paper._MODELS))


@pytest.fixture
def still() -> StillKernel:
    return StillKernel()
