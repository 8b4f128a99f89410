"""A folder holds one training, nothing in it is overwritten by another, and only one process works there."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from glbench.errors import TrainingError
from glbench.tasks import TaskSpec
from glbench.training import TrainingSettings, read_settings, train
from glbench.training.folder import folder_lock
from glbench.training.season_search import SearchSettings, search
from tests.training.conftest import PPO

pytestmark = pytest.mark.train


@pytest.fixture(scope="module")
def settings(day: TaskSpec, tmp_path_factory: pytest.TempPathFactory) -> TrainingSettings:
    file = tmp_path_factory.mktemp("settings") / "tiny.yml"
    file.write_text(PPO, encoding="utf-8")
    return read_settings(file, "ppo", day.id).model_copy(update={"n_timesteps": 200})


@pytest.fixture(scope="module")
def finished(day: TaskSpec, settings: TrainingSettings, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("finished") / "run"
    train(day, settings, folder, tensorboard=False)
    return folder


@pytest.fixture
def run(finished: Path, tmp_path: Path) -> Path:
    """A finished training of one's own."""
    return shutil.copytree(finished, tmp_path / "run")


def contents(folder: Path) -> dict[str, bytes]:
    return {str(file): file.read_bytes() for file in sorted(folder.rglob("*")) if file.is_file()}


def plan(policy: Path, generations: int = 1) -> SearchSettings:
    wanted = SearchSettings.of(policy)
    small = {"population": 4, "directions": 2, "generations": generations}
    return wanted.model_copy(update={**small, "evaluation": wanted.evaluation.model_copy(update={"runs": 2})})


def test_a_search_does_not_overwrite_a_training_nor_a_training_a_search(
    day: TaskSpec, settings: TrainingSettings, run: Path, finished: Path, tmp_path: Path
) -> None:
    before = contents(run)
    with pytest.raises(TrainingError, match="would be overwritten"):
        search(day, plan(run / "policy.npz"), run)
    with pytest.raises(TrainingError, match="holds another training"):
        search(day, plan(finished / "policy.npz"), run)
    assert contents(run) == before

    tuned = tmp_path / "tuned"
    search(day, plan(finished / "policy.npz"), tuned)
    before = contents(tuned)
    for resume in (False, True):
        with pytest.raises(TrainingError, match="holds another training"):
            train(day, settings, tuned, resume=resume, tensorboard=False)
    (tuned / "card.toml").unlink()
    with pytest.raises(TrainingError, match="holds another training"):
        train(day, settings, tuned, resume=True, tensorboard=False)
    assert contents(tuned).items() <= before.items()


def test_a_finished_training_without_its_checkpoint_stays_as_it_is(day: TaskSpec, settings: TrainingSettings, run: Path) -> None:
    shutil.rmtree(run / "checkpoint")
    before = contents(run)
    with pytest.raises(TrainingError, match="holds another training"):
        train(day, settings, run, seed=1, tensorboard=False)
    with pytest.raises(TrainingError, match="not its last state"):
        train(day, settings.model_copy(update={"n_timesteps": 400}), run, resume=True, tensorboard=False)
    assert train(day, settings, run, tensorboard=False).already_done
    assert contents(run) == before


def test_settings_that_are_refused_are_not_written(day: TaskSpec, settings: TrainingSettings, run: Path) -> None:
    before = contents(run)
    other = settings.model_copy(update={"hyperparameters": {**settings.hyperparameters, "gamma": 0.5}})
    with pytest.raises(TrainingError, match="settings_digest"):
        train(day, other, run, resume=True, tensorboard=False)
    assert contents(run) == before


def test_a_policy_that_was_not_written_any_more_is_made_by_the_next_call(day: TaskSpec, settings: TrainingSettings, run: Path) -> None:
    policy = (run / "policy.npz").read_bytes()
    (run / "policy.npz").unlink()
    assert train(day, settings, run, tensorboard=False).already_done
    assert (run / "policy.npz").read_bytes() == policy


def test_only_one_process_works_in_a_folder(day: TaskSpec, settings: TrainingSettings, run: Path) -> None:
    with folder_lock(run), pytest.raises(TrainingError, match="Another process is at work"):
        train(day, settings, run, tensorboard=False)
    assert train(day, settings, run, tensorboard=False).already_done


def test_a_disk_that_refuses_is_explained(tmp_path: Path) -> None:
    with pytest.raises(TrainingError, match=r"No space left.*--resume"), folder_lock(tmp_path):
        raise OSError(28, "No space left on device")
