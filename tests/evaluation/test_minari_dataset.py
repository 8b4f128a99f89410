"""Seasons of agents as a Minari dataset: what a learner in the Gymnasium environment would have met, and nothing held out."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from glbench.env import Simulation
from glbench.errors import EpisodeError, GlbenchError, SubmissionError, TaskError
from glbench.evaluation import minari_dataset as exporting
from glbench.evaluation import protect
from glbench.evaluation.minari_dataset import FIRST_SEED, WrittenDataset, check_learnable, trajectories, write_dataset
from glbench.tasks import TaskSpec, get_task
from glbench.tasks.record import FIRST_TRAINING_SEED
from tests.episodes.day import RANDOM
from tests.evaluation.agent_files import GOOD, agent_writer
from tests.support import write_day_task

minari = pytest.importorskip("minari", reason="Minari is not installed (extra 'minari')")

NAME = "glbench/day/mixed-v0"
FAILING = """
    def act(self, observations):
        self.calls += 1
        if self.calls == 5:
            raise RuntimeError("the pump broke")
        return np.zeros((self.n, 6))
"""


@pytest.fixture
def day(tmp_path: Path) -> TaskSpec:
    return get_task(write_day_task(tmp_path))


@pytest.fixture(autouse=True)
def datasets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Minari's folder, of the test's own."""
    folder = tmp_path / "minari"
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(folder))
    return folder


def written(day: TaskSpec, folder: Path, *, name: str = NAME, noise: float = 0.1, **more: Any) -> WrittenDataset:
    write = agent_writer(folder)
    agents = [protect(write(RANDOM, "wavy"), "none"), protect(write(GOOD, "calm", single=False), "none")]
    return write_dataset(name, day, agents, 2, noise=noise, **more)


def arrays(name: str) -> list[tuple[bytes, ...]]:
    """The bits of all episodes of a dataset."""
    return [
        tuple(getattr(one, kind).tobytes() for kind in ("observations", "actions", "rewards", "terminations", "truncations"))
        for one in minari.load_dataset(name)
    ]


def test_the_recovered_environment_gives_every_season_again_to_the_bit(day: TaskSpec, tmp_path: Path) -> None:
    done = written(day, tmp_path)
    dataset = minari.load_dataset(NAME)
    assert (dataset.total_episodes, dataset.total_steps) == (4, 4 * day.steps) == (len(done.seasons), done.steps)
    env = dataset.recover_environment()
    assert env.observation_space == dataset.observation_space
    assert env.action_space == dataset.action_space
    facts = list(dataset.storage.get_episode_metadata(range(4)))
    assert [one["seed"] for one in facts] == list(range(FIRST_SEED, FIRST_SEED + 4))
    assert [one["agent"] for one in facts] == ["wavy", "wavy", "calm", "calm"]
    for episode, fact, season in zip(dataset, facts, done.seasons, strict=True):
        observation, _ = env.reset(seed=fact["seed"])
        met, profit = [observation], 0.0
        for step, action in enumerate(episode.actions):
            observation, reward, terminated, truncated, info = env.step(action)
            met.append(observation)
            assert reward == episode.rewards[step]
            assert (terminated, truncated) == (episode.terminations[step], episode.truncations[step])
            profit += info["epi"]
        assert np.stack(met).tobytes() == episode.observations.tobytes()
        assert episode.observations.dtype == episode.actions.dtype == np.float32
        assert episode.rewards.dtype == np.float64
        assert terminated
        assert fact["return"] == season.reward == episode.rewards.sum()
        assert fact["profit"] == pytest.approx(profit, rel=1e-12)


def test_the_same_arguments_give_the_same_arrays_and_other_seeds_others(day: TaskSpec, tmp_path: Path) -> None:
    for name, more in (("one-v0", {}), ("two-v0", {}), ("other-v0", {"first_seed": FIRST_SEED + 100})):
        written(day, tmp_path, name=name, **more)
    assert arrays("one-v0") == arrays("two-v0")
    assert not set(arrays("one-v0")) & set(arrays("other-v0"))


def test_a_season_does_not_depend_on_those_beside_it(day: TaskSpec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    agent = protect(agent_writer(tmp_path)(GOOD), "none")
    together = list(trajectories(day, agent, range(FIRST_SEED, FIRST_SEED + 3), noise=0.2))
    monkeypatch.setattr("glbench.evaluation.minari_dataset._TOGETHER", 1)
    for one, alone in zip(together, trajectories(day, agent, range(FIRST_SEED, FIRST_SEED + 3), noise=0.2), strict=True):
        assert one.actions.tobytes() == alone.actions.tobytes()
        assert one.observations.tobytes() == alone.observations.tobytes()


def test_without_noise_actions_are_those_of_the_agent(day: TaskSpec, tmp_path: Path) -> None:
    agent = protect(agent_writer(tmp_path)("def act(self, observations):\n    return np.full((self.n, 6), 0.1)"), "none")
    (plain,) = trajectories(day, agent, [FIRST_SEED])
    assert (plain.actions == np.float32(0.1)).all()
    (noisy,) = trajectories(day, agent, [FIRST_SEED], noise=0.05)
    assert 0.03 < (noisy.actions - plain.actions).std() < 0.07
    (wild,) = trajectories(day, agent, [FIRST_SEED], noise=2.0)
    assert (np.abs(wild.actions) <= 1.0).all()
    assert (np.abs(wild.actions) == 1.0).any()


def test_a_season_that_cannot_be_simulated_ends_there(day: TaskSpec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    agent, take = protect(agent_writer(tmp_path)(GOOD), "none"), Simulation.step

    def ends(simulation: Simulation, actions: Any) -> Any:
        result = take(simulation, actions)
        if simulation.k[0] == 7:
            simulation.end([0])
            result.terminated.flags.writeable = True
            result.terminated[0] = True
        return result

    monkeypatch.setattr(Simulation, "step", ends)
    short, whole = trajectories(day, agent, [FIRST_SEED, FIRST_SEED + 1])
    assert (len(short.rewards), len(short.observations), len(whole.rewards)) == (7, 8, day.steps)
    for one in (short, whole):
        assert one.terminations[-1]
        assert not one.terminations[:-1].any()


def test_the_metadata_say_who_acted_where_and_under_which_licences(day: TaskSpec, tmp_path: Path) -> None:
    written(day, tmp_path, about={"author": "A. Grower", "code_permalink": "https://example.org/code"})
    facts = minari.load_dataset(NAME).storage.metadata
    assert facts["algorithm_name"] == "wavy, calm"
    assert facts["author"] == {"A. Grower"}
    assert facts["code_permalink"] == "https://example.org/code"
    assert facts["requirements"][0].startswith("glbench==")
    assert "BSD-3-Clause" in facts["licence"]
    assert "Royal Netherlands Meteorological Institute" in facts["licence"]
    assert facts["licence"] in facts["description"]
    assert facts["glbench"]["task"] == {"id": day.id, "digest": day.digest, "split": None}
    assert facts["glbench"]["noise"] == 0.1
    assert NAME in minari.list_local_datasets()


def test_a_task_with_splits_shows_its_training_split_and_is_evaluated_on_validation() -> None:
    spring = get_task("Spring-v1")
    spec, evaluated = exporting._spec(spring), exporting._spec(spring.chosen_on)
    assert spec is not None
    assert evaluated is not None
    made, judged = gymnasium.make(spec).unwrapped, gymnasium.make(evaluated).unwrapped
    assert (made.task.split, judged.task.split) == ("training", "validation")  # type: ignore[attr-defined]
    assert made.task.digest == spring.digest  # type: ignore[attr-defined]


@pytest.mark.parametrize("split", ["validation", "test"])
def test_what_is_held_out_is_refused(split: str) -> None:
    with pytest.raises(TaskError, match=f"in its {split} split, which is held out"):
        check_learnable(get_task("Spring-v1").in_split(split), FIRST_SEED, 1)


def test_a_dataset_of_no_seasons_is_refused(day: TaskSpec) -> None:
    with pytest.raises(GlbenchError, match="A dataset needs at least one season"):
        check_learnable(day, FIRST_SEED, 0)


def test_seeds_that_score_are_refused(day: TaskSpec) -> None:
    check_learnable(day, FIRST_TRAINING_SEED, 1)
    with pytest.raises(GlbenchError, match="666 to 668 are not for learning"):
        check_learnable(day, 666, 3)
    with pytest.raises(GlbenchError, match="not for learning"):
        check_learnable(day, FIRST_TRAINING_SEED - 1, 1)
    check_learnable(day, 2**53, 1)
    with pytest.raises(GlbenchError, match=r"are too large\. Use seeds from 10,000,000,000 to 9,007,199,254,740,992"):
        check_learnable(day, 2**53, 2)


def test_a_task_with_a_test_alone_is_refused() -> None:
    with pytest.raises(TaskError, match="no training split"):
        check_learnable(get_task("Transfer-Miami-v1"), FIRST_SEED, 1)


def test_a_controller_that_sets_controls_is_refused(day: TaskSpec, datasets: Path) -> None:
    with pytest.raises(SubmissionError, match="'rule_based' sets controls past the task's actuation"):
        write_dataset(NAME, day, [protect("rule_based", "none")], 1)
    assert not datasets.exists()


def test_two_agents_of_one_name_are_refused(day: TaskSpec) -> None:
    agent = protect("rule_based_fair", "none")
    with pytest.raises(SubmissionError, match="'rule_based_fair' is named twice"):
        write_dataset(NAME, day, [agent, agent], 1)


def test_an_agent_that_fails_leaves_nothing(day: TaskSpec, datasets: Path, tmp_path: Path) -> None:
    agent = protect(agent_writer(tmp_path)(FAILING, "broken"), "none")
    with pytest.raises(SubmissionError, match=r"'broken' failed in all seasons: .*the pump broke"):
        write_dataset(NAME, day, [agent], 2)
    assert not [file for file in datasets.rglob("*") if file.is_file()]
    assert not minari.list_local_datasets()


def test_an_interruption_leaves_nothing_and_the_same_command_then_writes_it(day: TaskSpec, datasets: Path, tmp_path: Path) -> None:
    def stop(_: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        written(day, tmp_path, progress=stop)
    assert not list(datasets.rglob("*"))
    written(day, tmp_path)
    assert len(arrays(NAME)) == 4


def test_a_dataset_that_exists_stays(day: TaskSpec, tmp_path: Path) -> None:
    before = written(day, tmp_path)
    content = json.loads((before.folder / "data" / "metadata.json").read_text(encoding="utf-8"))
    with pytest.raises(EpisodeError, match=f"{NAME} exists"):
        written(day, tmp_path, noise=0.5)
    assert json.loads((before.folder / "data" / "metadata.json").read_text(encoding="utf-8")) == content


@pytest.mark.parametrize("name", ["no-version", "-", "a b-v0", "../../out-v0", "x/abc-v0"])
def test_a_name_that_minari_does_not_know_is_refused(day: TaskSpec, tmp_path: Path, name: str) -> None:
    with pytest.raises(EpisodeError, match=r"not a valid name for a Minari dataset: it is made of letters, .*namespaces of two"):
        written(day, tmp_path, name=name)


def test_a_place_of_all_datasets_that_cannot_be_made_is_named(day: TaskSpec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "taken").touch()
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "taken"))
    with pytest.raises(EpisodeError, match=r"Cannot make .*taken: .*Set MINARI_DATASETS_PATH to a folder that you can write to"):
        written(day, tmp_path)
