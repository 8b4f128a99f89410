"""Several seeds at once: each as alone, failures apart, folders that come home whole."""

from __future__ import annotations

from pathlib import Path

import pytest

from glbench.cli.options import numbers_of
from glbench.errors import GlbenchError, TrainingError
from glbench.execution import ProcessExecutor, read_files
from glbench.tasks import TaskSpec
from glbench.training import CurvePoint, TrainingSettings, train
from glbench.training.multi_seed import bring_home, train_seeds
from tests.training.watching import Watching


@pytest.mark.parametrize(("text", "seeds"), [("0-3", [0, 1, 2, 3]), ("7", [7]), ("4, 1,2-3,1", [4, 1, 2, 3]), ("5-5", [5])])
def test_seeds_are_named_in_words(text: str, seeds: list[int]) -> None:
    assert numbers_of(text, "seeds", "0-4") == seeds


@pytest.mark.parametrize("text", ["", "a", "3-1", "-1", "1-", "0-1000", "0,,1"])
def test_what_names_no_seeds_is_refused(text: str) -> None:
    with pytest.raises(GlbenchError, match="--seeds"):
        numbers_of(text, "seeds", "0-4")


@pytest.mark.train
@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["ppo"], indirect=True)
def test_processes_train_what_is_trained_alone_and_one_that_fails_stops_no_other(
    day: TaskSpec, tiny: TrainingSettings, tmp_path: Path
) -> None:
    folders = {seed: tmp_path / f"seed{seed}" for seed in (0, 1, 2)}
    (folders[1] / "checkpoint").mkdir(parents=True)
    (folders[1] / "checkpoint" / "state.json").write_text('{"identity": {"seed": 9}}', encoding="utf-8")
    heard = {seed: Watching() for seed in folders}
    with ProcessExecutor(2) as executor:
        ended = dict(train_seeds(executor, train, day, tiny, folders, listeners=lambda seed: [heard[seed]], tensorboard=False))
    assert isinstance(ended[1], TrainingError)
    assert "another training" in str(ended[1])
    listening = Watching()
    alone = train(day, tiny, tmp_path / "alone", seed=2, tensorboard=False, listeners=[listening])
    found = ended[2]
    assert not isinstance(found, TrainingError)
    assert (found.best_reward, found.steps) == (alone.best_reward, alone.steps)
    policies = [folder / "policy.npz" for folder in (folders[2], alone.folder)]
    assert policies[0].read_bytes() == policies[1].read_bytes()
    told = [[(point.steps, point.result, point.is_best) for point in one.points] for one in (heard[2], listening)]
    assert told[0] == told[1]
    assert len(told[0]) >= 3


class Stopping(Watching):
    """Wants no more after the first evaluation."""

    def on_evaluation(self, point: CurvePoint) -> None:
        super().on_evaluation(point)
        raise TrainingError(str(point.steps))


@pytest.mark.train
@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["ppo"], indirect=True)
def test_a_listener_ends_the_process_that_it_listens_to(day: TaskSpec, tiny: TrainingSettings, tmp_path: Path) -> None:
    folders, listening = {0: tmp_path / "seed0"}, Stopping()
    with ProcessExecutor(1) as executor:
        ((seed, ended),) = train_seeds(executor, train, day, tiny, folders, listeners=lambda _: [listening])
    assert (seed, str(ended), len(listening.points)) == (0, "0", 1)
    assert not (folders[0] / "card.toml").exists()


def test_a_folder_that_came_home_is_the_one_that_was_sent(tmp_path: Path) -> None:
    folder = tmp_path / "home"
    begun = {"settings.yml": b"s", "card.toml": b"old", "best/model.zip": b"1", "checkpoint/state.json": b"{}"}
    went_on = {"settings.yml": b"s", "best/model.zip": b"2", "checkpoint/state.json": b"{ }", "checkpoint/new": b"n"}
    for files in (begun, went_on, {**went_on, "card.toml": b"new", "policy.npz": b"p"}):
        bring_home(folder, files)
        assert read_files(folder) == files
    assert {path.name for path in folder.iterdir()} == {"settings.yml", "card.toml", "policy.npz", "best", "checkpoint"}
