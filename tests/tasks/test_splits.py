"""Tasks with splits: which scenarios a run is drawn from, while the task and its digest stay the same."""

from __future__ import annotations

import pickle
from pathlib import Path

import gymnasium
import pytest

import glbench.env  # noqa: F401  # registers the shipped tasks
from glbench.env import GreenhouseEnv, Simulation, Snapshot
from glbench.env.snapshot import _FORMAT
from glbench.errors import GlbenchError, TaskError
from glbench.tasks import TaskSpec, get_task
from tests.env.spring import SCENARIO, SPLITS, spring
from tests.env.stepping import StillKernel, walk


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("splits")


@pytest.fixture(scope="module")
def task(folder: Path) -> TaskSpec:
    return spring(folder / "spring.toml")


def test_a_task_stands_in_its_training_split_and_counts_in_its_test(task: TaskSpec) -> None:
    assert task.split == "training"
    assert (task.scored.split, task.chosen_on.split) == ("test", "validation")
    assert task.scored.scored == task.scored
    assert task.in_split("training") is task
    assert len({task, task.scored, task.chosen_on, task.in_split("test", "secret")}) == 4
    assert task.scored == task.in_split("test") == task.chosen_on.in_split("test")
    assert task.in_split("test", "secret").scored.sealed == "secret"
    for other in (task.scored, task.chosen_on):
        assert (other.digest, other.id, other.observed()) == (task.digest, task.id, task.observed())
        assert pickle.loads(pickle.dumps(other)) == other
        assert other.model_copy({"title": "Another"}).split == other.split


def test_the_published_tasks_have_none() -> None:
    task = get_task("Schiphol2010-Delta10-v1")
    assert (task.split, task.splits, task.scored, task.chosen_on) == (None, None, task, task)
    with pytest.raises(TaskError, match=r"has no split 'foo'\. It has training, validation, test\.$"):
        get_task("Spring-v1").in_split("foo")
    with pytest.raises(TaskError, match=r"has no split 'test'\. All its runs share their seasons"):
        task.in_split("test")
    with pytest.raises(TaskError, match="no split"):
        gymnasium.make("glbench/Schiphol2010-Delta10-v1", split="test")


def test_a_task_without_validation_is_chosen_on_its_training(folder: Path) -> None:
    test_only = SPLITS[SPLITS.index("[splits.test]") :]
    training = SPLITS[: SPLITS.index("[splits.validation]")]
    two = spring(folder / "two.toml", splits=training + test_only)
    assert two.chosen_on is two
    one = spring(folder / "one.toml", splits=test_only)
    assert (one.split, one.scored, one.chosen_on) == ("test", one, one)


def test_an_unknown_split_is_named(task: TaskSpec) -> None:
    with pytest.raises(TaskError, match=r"no split 'tests'.*Did you mean 'test'.*training, validation, test"):
        task.in_split("tests")
    with pytest.raises(TaskError, match="no split"):
        GreenhouseEnv(task, split="exam")


@pytest.mark.parametrize("split", ["training", "validation", "test"])
def test_environments_take_the_split_they_are_asked_for(task: TaskSpec, split: str) -> None:
    env = GreenhouseEnv(task, kernel=StillKernel(), split=split)
    assert env.task.split == split
    assert env.task.scenario.generated is not None
    assert env.task.scenario.generated.years == getattr(task.splits, split).years
    assert GreenhouseEnv(task).task.split == "training"
    assert GreenhouseEnv(task.in_split(split)).task.split == split


def test_a_snapshot_goes_on_in_its_own_split_only(task: TaskSpec) -> None:
    simulation = Simulation(task, 2, StillKernel())
    simulation.reset([666, 667])
    simulation.step(walk(1, 1, 2)[0])
    read = Snapshot.from_bytes(simulation.snapshot().to_bytes())
    assert read.split == "training"
    again = Simulation(task.in_split("training"), 2, StillKernel())
    assert again.restore(read).tobytes() == simulation.observe().tobytes()
    other = Simulation(task.in_split("test"), 2, StillKernel())
    with pytest.raises(TaskError, match="split training, this is its split test: the same seeds stand for other scenarios"):
        other.restore(read)
    env = GreenhouseEnv(task, kernel=StillKernel(), split="validation")
    with pytest.raises(TaskError, match="split training, this is its split validation"):
        env.reset(options={"state": read.take(0)})


def test_a_snapshot_under_a_secret_salt_does_not_go_on_under_another_and_does_not_tell_it(task: TaskSpec) -> None:
    one, other = (Simulation(task.in_split("test", salt), 1, StillKernel()) for salt in ("my secret", "another"))
    one.reset([1])
    data = one.snapshot().to_bytes()
    assert "my" not in Snapshot.from_bytes(data).split
    with pytest.raises(TaskError, match="secret salt"):
        other.restore(Snapshot.from_bytes(data))
    with pytest.raises(TaskError, match="secret salt"):
        Simulation(task.in_split("test"), 1, StillKernel()).restore(Snapshot.from_bytes(data))
    assert (Simulation(task.in_split("test", "my secret"), 1, StillKernel()).restore(Snapshot.from_bytes(data)) == one.observe()).all()


def test_copies_of_a_simulation_stay_in_their_split(task: TaskSpec) -> None:
    simulation = Simulation(task.in_split("validation"), 1, "fast")
    simulation.reset([700])
    copied = pickle.loads(pickle.dumps(simulation))
    assert copied.task.split == "validation"
    for action in walk(2, 5, 1):
        assert copied.step(action).observations.tobytes() == simulation.step(action).observations.tobytes()


def test_snapshots_of_earlier_formats_have_no_split() -> None:
    task = get_task("Schiphol2010-Delta10-v1")
    simulation = Simulation(task, 1, StillKernel())
    simulation.reset([1])
    assert simulation.snapshot().split == ""
    assert _FORMAT == 3


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("years = [2011, 2012]", "years = [2010, 2012]", "training and test share the year 2010"),
        ("years = [2011, 2012]", "years = [2011, 2011]", "different years"),
        ("years = [2011, 2012]", "years = []", "different years"),
        ("seasons = 7", "", r"\[splits.test\] must say how many seasons"),
        ("seasons = 7", "seasons = 0", "a whole number"),
        ("[splits.test]", "[splits.exam]", "exam"),
        (SPLITS, "", "needs .splits."),
    ],
)
def test_mistakes_in_splits_are_named(folder: Path, old: str, new: str, says: str) -> None:
    assert old in SPLITS
    with pytest.raises(TaskError, match=says):
        spring(folder / "wrong.toml", splits=SPLITS.replace(old, new))


@pytest.mark.parametrize(
    ("scenario", "says"),
    [
        (SCENARIO.replace("generated = true", ""), "goes with generated seasons"),
        (SCENARIO.replace("generated = true", "generated = true\nyears = [2008]"), r"Keep those of \[splits\]"),
        (SCENARIO.replace("low = 390.0", "low = 430.0"), "co2_range"),
    ],
)
def test_mistakes_in_a_scenario_with_splits_are_named(folder: Path, scenario: str, says: str) -> None:
    with pytest.raises(GlbenchError, match=says):
        spring(folder / "wrong.toml", scenario=scenario)
