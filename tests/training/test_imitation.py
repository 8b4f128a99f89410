"""A policy that imitates a controller: what is learnt, how it continues, and what is refused."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from baselines.imitate import Classroom, ImitationSettings, imitate, loss_of, main, read_imitation
from glbench.agents import load_agent
from glbench.agents.network_policy import read_policy
from glbench.errors import TrainingError
from glbench.tasks import TaskSpec, task_card
from glbench.training.periodic_evaluation import CurvePoint, Listener

pytestmark = pytest.mark.train
SMALL: Mapping[str, Any] = {
    "teacher": "rule_based_tuned", "rounds": 3, "runs": 4, "first_env_seed": 10_000_000_000, "net_arch": [32], "updates": 1500,
    "batch_size": 64, "learning_rate": 5e-3, "clip_observations": 10.0,
    "evaluation": {"every": 1, "runs": 2, "first_seed": 20_000_000_000}, "kernel_preset": "fast",
}  # fmt: skip


@pytest.fixture(scope="module")
def settings() -> ImitationSettings:
    return ImitationSettings(**SMALL)


@pytest.fixture(scope="module")
def trained(day: TaskSpec, settings: ImitationSettings, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a finished imitation of the tuned rules."""
    folder = tmp_path_factory.mktemp("imitation")
    imitate(day, settings, folder)
    return folder


class StopAfterFirstRound(Listener):
    """Interrupts a training after its first policy."""

    def on_evaluation(self, point: CurvePoint) -> None:
        """As Ctrl-C does."""
        raise KeyboardInterrupt


def test_the_policy_does_what_its_teacher_would(day: TaskSpec, settings: ImitationSettings, trained: Path) -> None:
    """In seasons that it has not learnt from, better than always the teacher's mean action."""
    policy, classroom = read_policy(trained / "policy.npz"), Classroom(day, settings)
    lesson = classroom.play(settings.rounds, policy)  # a round more
    off = np.square(policy.act(lesson.observations) - lesson.actions).mean()
    assert off < 0.2 * lesson.actions.var(axis=0).mean()


def test_in_the_first_round_the_teacher_acts_and_later_the_policy(day: TaskSpec, settings: ImitationSettings, trained: Path) -> None:
    classroom, policy = Classroom(day, settings), read_policy(trained / "policy.npz")
    own, other = classroom.play(0, None), classroom.play(0, policy)
    assert own.observations.shape == other.observations.shape == (day.steps * settings.runs, len(task_card(day).observation_names))
    np.testing.assert_array_equal(own.observations[: settings.runs], other.observations[: settings.runs])  # the same seasons
    assert np.abs(own.observations - other.observations).max() > 1e-3
    teacher = load_agent(settings.teacher).make(task_card(day))
    teacher.reset(task_card(day), settings.runs)
    first = np.clip(teacher.act(other.observations[: settings.runs]), -1.0, 1.0)
    np.testing.assert_array_equal(other.actions[: settings.runs], first.astype(np.float32))


def test_rounds_have_seeds_of_their_own(day: TaskSpec, settings: ImitationSettings) -> None:
    classroom = Classroom(day, settings)
    seeds = [seed for number in range(settings.rounds) for seed in classroom.seeds(number)]
    assert len({*seeds}) == len(seeds) == settings.rounds * settings.runs
    assert not {*seeds} & {*day.evaluation.seeds}
    assert not {*seeds} & {*settings.evaluation.seeds(day)}


def test_an_interrupted_imitation_continues_to_the_same_policy(
    day: TaskSpec, settings: ImitationSettings, trained: Path, tmp_path: Path
) -> None:
    with pytest.raises(KeyboardInterrupt):
        imitate(day, settings, tmp_path, listeners=[StopAfterFirstRound()])
    rounds = sorted(file.name for file in tmp_path.glob("round-*.npz"))
    assert rounds == ["round-0.npz"]
    imitate(day, settings, tmp_path)
    assert (tmp_path / "policy.npz").read_bytes() == (trained / "policy.npz").read_bytes()
    assert imitate(day, settings, tmp_path).already_done


def test_another_seed_gives_another_policy(day: TaskSpec, trained: Path, tmp_path: Path) -> None:
    one_round = ImitationSettings(**{**SMALL, "rounds": 1})
    for seed in (0, 1):
        imitate(day, one_round, tmp_path / str(seed), seed=seed)
    assert (tmp_path / "0" / "policy.npz").read_bytes() != (tmp_path / "1" / "policy.npz").read_bytes()


def test_the_card_says_whom_it_imitates(day: TaskSpec, settings: ImitationSettings, trained: Path) -> None:
    card = tomllib.loads((trained / "card.toml").read_text(encoding="utf-8"))
    assert card["title"] == "Imitation of rule_based_tuned on test/Day-v1, seed 0"
    assert card["training"]["teacher"] == "rule_based_tuned"
    assert card["training"]["steps"] == settings.rounds * settings.runs * day.steps
    assert card["training"]["settings_digest"] == settings.digest
    lines = (trained / "learning_curve.csv").read_text(encoding="utf-8").splitlines()
    assert len(lines) == 1 + settings.rounds


def test_another_training_in_the_folder_is_refused(day: TaskSpec, trained: Path) -> None:
    with pytest.raises(TrainingError, match="holds another training"):
        imitate(day, ImitationSettings(**{**SMALL, "updates": 3}), trained)


def test_beyond_an_advised_bound_nothing_is_lost() -> None:
    output = torch.tensor([[1.7, -1.7, 1.7, 0.5]], requires_grad=True)
    loss = loss_of(output, torch.tensor([[1.0, -1.0, -1.0, 0.0]]), torch.full((4,), -1.0), torch.ones(4))
    loss.backward()
    assert loss.item() == pytest.approx((0.0 + 0.0 + 2.7**2 + 0.5**2) / 4)
    assert output.grad is not None
    assert (output.grad[0] != 0.0).tolist() == [False, False, True, True]  # a wrong bound still pulls


def test_rounds_of_another_imitation_are_refused(day: TaskSpec, settings: ImitationSettings, tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        imitate(day, settings, tmp_path, listeners=[StopAfterFirstRound()])
    with pytest.raises(TrainingError, match=r"round-0\.npz is of another imitation .*--out"):
        imitate(day, ImitationSettings(**{**SMALL, "updates": 3}), tmp_path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("teacher: mpc_true_state", r"mpc_true_state sees more than observations.*Choose another teacher"),
        ("teacher: nobody_at_all", r"nobody_at_all"),
        ("rounds: 0", r"'rounds'"),
        ("first_env_seed: 10000", r"'first_env_seed'"),
        ("roundz: 3", r"'roundz'"),
    ],
)
def test_settings_that_cannot_be_used_are_refused(
    change: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    key = change.partition(":")[0]
    lines = [f"{name}: {value}" for name, value in SMALL.items() if name != key]
    file = tmp_path / "imitation.yml"
    file.write_text("\n".join([*lines, change]), encoding="utf-8")
    monkeypatch.setattr("sys.argv", ["imitate.py", str(file), "--task", "Spring-v1", "--out", str(tmp_path / "out")])
    assert main() == 1
    assert "Error: " in capsys.readouterr().err
    with pytest.raises(Exception, match=message):
        read_imitation(file)
