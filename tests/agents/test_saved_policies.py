"""Saved policies are submissions: they act as where they were trained, a row alone as among others, and say what does not fit."""

from __future__ import annotations

import importlib.util
import shutil
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from numpy.typing import NDArray

from glbench import extras
from glbench.agents import load_agent
from glbench.agents.saved_policies import PolicyAgent
from glbench.errors import SubmissionError
from glbench.tasks import TaskCard
from tests.agents.saved_policies import ALGORITHMS, NORMALISED, Anything, network, save_model, save_onnx, save_torchscript


def lacks(*modules: str) -> bool:
    return any(importlib.util.find_spec(module) is None for module in modules)


needs_sb3 = pytest.mark.skipif(lacks("stable_baselines3", "sb3_contrib"), reason="Stable-Baselines3 is not installed")
needs_torch = pytest.mark.skipif(lacks("torch"), reason="torch is not installed")
needs_onnx = pytest.mark.skipif(lacks("onnx", "onnxruntime"), reason="onnx or onnxruntime is not installed")


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder a model, ``my-PPO`` and so on: the bare names are too like those of baselines."""
    folder = tmp_path_factory.mktemp("models")
    for algorithm in ALGORITHMS:
        save_model(folder / f"my-{algorithm}", algorithm)
    return folder


def made(path: Path, card: TaskCard) -> PolicyAgent:
    agent = load_agent(path).make(card)
    assert isinstance(agent, PolicyAgent)
    return agent


def refusal(path: Path, card: TaskCard) -> str:
    with pytest.raises(SubmissionError) as caught:
        load_agent(path).make(card)
    return str(caught.value)


def dialogue(steps: int = 12, n: int = 30) -> NDArray[np.float32]:
    return (np.random.default_rng(1).standard_normal((steps, n, 22)) * 10 + 5).astype(np.float32)


def answers(agent: PolicyAgent, card: TaskCard, seen: NDArray[np.float32]) -> NDArray[np.float64]:
    agent.reset(card, seen.shape[1])
    return np.array([agent.act(observations) for observations in seen])


@needs_sb3
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_a_model_acts_as_its_own_library_makes_it_act(models: Path, card: TaskCard, algorithm: str) -> None:
    model, venv = save_model(models / f"again-{algorithm}", algorithm)
    seen = dialogue(6, 3)
    if algorithm in NORMALISED:
        venv.training = False
    state, expected = None, []
    for step, observations in enumerate(seen):
        shown = venv.normalize_obs(observations) if algorithm in NORMALISED else observations
        start = np.full(3, step == 0)
        action, state = model.predict(shown, state=state, episode_start=start, deterministic=True)
        expected.append(action)
    np.testing.assert_allclose(answers(made(models / f"again-{algorithm}", card), card, seen), expected, atol=1e-5)


@needs_sb3
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_a_model_decides_for_a_run_alone_as_among_others_to_the_last_bit(models: Path, card: TaskCard, algorithm: str) -> None:
    agent, seen = made(models / f"my-{algorithm}", card), dialogue()
    together = answers(agent, card, seen)
    for row in (0, 7, 29):
        assert answers(agent, card, seen[:, row : row + 1]).tobytes() == together[:, row : row + 1].tobytes()


@needs_sb3
def test_a_reset_forgets_what_a_recurrent_model_remembers(models: Path, card: TaskCard) -> None:
    agent, seen = made(models / "my-RecurrentPPO", card), dialogue()
    first = answers(agent, card, seen)
    assert answers(agent, card, seen).tobytes() == first.tobytes()
    assert not np.array_equal(answers(agent, card, seen[1:])[0], first[1])


@needs_sb3
def test_loading_a_model_opens_no_pickle_before_the_agent_is_made(models: Path, tmp_path: Path, card: TaskCard) -> None:
    shutil.copytree(models / "my-PPO", tmp_path / "my-PPO")
    (tmp_path / "my-PPO" / "vecnormalize.pkl").write_bytes(b"cos\nmkdir\n(S'%s'\ntR." % str(tmp_path / "was-run").encode())
    loaded = load_agent(tmp_path / "my-PPO")
    assert not (tmp_path / "was-run").exists()
    with pytest.raises(SubmissionError, match="expected VecNormalize"):
        loaded.make(card)
    assert (tmp_path / "was-run").exists()


@needs_sb3
@pytest.mark.parametrize("place", ["beside", "named", "deeper"])
def test_statistics_are_found_and_are_part_of_the_digest(models: Path, tmp_path: Path, place: str) -> None:
    folder = tmp_path / "mine"
    folder.mkdir()
    shutil.copy(models / "my-PPO" / "model.zip", folder / "model.zip")
    where = {"beside": "vecnormalize.pkl", "named": "model_vecnormalize.pkl", "deeper": "env/vecnormalize.pkl"}[place]
    without = load_agent(folder)
    (folder / where).parent.mkdir(exist_ok=True)
    shutil.copy(models / "my-PPO" / "vecnormalize.pkl", folder / where)
    found = load_agent(folder)
    assert found.submission is not None
    assert found.submission.statistics == (folder / where).resolve()
    assert found.digest != without.digest
    if place != "deeper":
        single = load_agent(folder / "model.zip").submission
        assert single is not None
        assert (folder / where).resolve() in single.files


@needs_sb3
def test_missing_statistics_are_told_before_anything_is_run(models: Path, tmp_path: Path, card: TaskCard) -> None:
    save_model(tmp_path / "bare", "PPO", statistics=False)
    assert "was trained with VecNormalize, and its statistics are missing" in refusal(tmp_path / "bare", card)


@needs_sb3
def test_models_of_other_spaces_are_refused_in_words(tmp_path: Path, card: TaskCard) -> None:
    save_model(tmp_path / "wide", "A2C", env=Anything(263))
    assert "model.zip sees 263 columns, the task shows 22 (air_temperature, co2" in refusal(tmp_path / "wide", card)
    save_model(tmp_path / "choice", "DQN", env=Anything(actions=gymnasium.spaces.Discrete(4)))
    message = refusal(tmp_path / "choice", card)
    assert "The actions of model.zip (DQN) are one choice out of several" in message
    assert "such as PPO or SAC" in message
    save_model(tmp_path / "few", "A2C", env=Anything(actions=gymnasium.spaces.Box(-1, 1, (3,), np.float32)))
    assert "model.zip gives 3 actions, the task has 6 (uBoil, uCo2" in refusal(tmp_path / "few", card)
    save_model(tmp_path / "unit", "A2C", env=Anything(actions=gymnasium.spaces.Box(0, 1, (6,), np.float32)))
    assert "lie between 0 and 1, those of the task between -1 and 1" in refusal(tmp_path / "unit", card)


@pytest.mark.parametrize(
    ("name", "content", "complaint"),
    [
        ("model.zip", b"no archive", "cannot be read as a model of Stable-Baselines3"),
        ("policy.pt", b"no archive", "it is not even an archive"),
        pytest.param("policy.onnx", b"nothing", "cannot be loaded as ONNX", marks=needs_onnx),
    ],
)
def test_files_of_other_content_are_refused_in_words(tmp_path: Path, card: TaskCard, name: str, content: bytes, complaint: str) -> None:
    (tmp_path / name).write_bytes(content)
    assert complaint in refusal(tmp_path / name, card)


@needs_torch
@pytest.mark.parametrize("width", [24, 37])
def test_torchscript_acts_the_same_alone_and_among_others(tmp_path: Path, card: TaskCard, width: int) -> None:
    import torch

    module = network(width)
    agent, seen = made(save_torchscript(tmp_path / "policy.pt", module), card), dialogue()
    together = answers(agent, card, seen)
    with torch.inference_mode():
        np.testing.assert_allclose(together[3], module(torch.from_numpy(seen[3])).numpy(), atol=1e-5)
    for row in (0, 7, 29):
        assert answers(agent, card, seen[:, row : row + 1]).tobytes() == together[:, row : row + 1].tobytes()


@needs_torch
def test_torchscript_of_other_shapes_and_mere_weights_are_refused(tmp_path: Path, card: TaskCard) -> None:
    import torch

    wide = save_torchscript(tmp_path / "wide.pt", network(columns=30))
    assert "wide.pt fails on observations of 22 columns" in refusal(wide, card)
    few = save_torchscript(tmp_path / "few.pt", network(actions=4))
    assert "answers a row of 22 observations with 4 numbers, the task has 6 actions" in refusal(few, card)
    torch.save(network().state_dict(), tmp_path / "weights.pt")
    assert "holds weights or a pickled module" in refusal(tmp_path / "weights.pt", card)


@needs_onnx
@pytest.mark.parametrize("rows", ["n", 1, 8])
def test_onnx_acts_the_same_alone_and_among_others(tmp_path: Path, card: TaskCard, rows: int | str) -> None:
    agent, seen = made(save_onnx(tmp_path / "policy.onnx", rows=rows), card), dialogue()
    together = answers(agent, card, seen)
    assert together.shape == (12, 30, 6)
    for row in (0, 7, 29):
        assert answers(agent, card, seen[:, row : row + 1]).tobytes() == together[:, row : row + 1].tobytes()


@needs_onnx
def test_onnx_of_other_shapes_is_refused(tmp_path: Path, card: TaskCard) -> None:
    assert "takes observations of shape (n, 30)" in refusal(save_onnx(tmp_path / "wide.onnx", columns=30), card)
    assert "with 4 numbers, the task has 6 actions" in refusal(save_onnx(tmp_path / "few.onnx", actions=4), card)


@needs_onnx
def test_a_card_normalises_and_clips(tmp_path: Path, card: TaskCard) -> None:
    file, seen = save_onnx(tmp_path / "policy.onnx", gain=1.0), dialogue(2)
    plain = answers(made(file, card), card, (seen - 5) / 10)
    base = 'name = "x"\nauthors = ["A"]\nlicence = "MIT"\ninformation = ["observations"]\n'
    table = f"[normalisation]\nmean = {[5.0] * 22}\nstd = {[10.0] * 22}\n"
    (tmp_path / "policy.toml").write_text(base + "clip_actions = true\n" + table)
    np.testing.assert_allclose(answers(made(file, card), card, seen), plain, atol=1e-4)
    (tmp_path / "policy.toml").write_text(base + "[normalisation]\nmean = [0.0]\nstd = [1.0]\n")
    assert "[normalisation] is of 1 columns, the task shows 22" in refusal(file, card)


def test_a_missing_package_is_named_with_the_extra_that_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def gone(name: str) -> object:
        raise ModuleNotFoundError(name=name)

    monkeypatch.setattr(extras.importlib, "import_module", gone)
    with pytest.raises(SubmissionError, match=r"needs onnxruntime, which is not installed here.*glbench\[onnx\]"):
        extras.need("onnxruntime", "The ONNX policy")


def test_a_folder_with_two_policies_asks_which_one(tmp_path: Path) -> None:
    (tmp_path / "a.onnx").touch()
    (tmp_path / "b.pt").touch()
    with pytest.raises(SubmissionError, match=r'several saved policies \(a.onnx, b.pt\).*model = "a.onnx"'):
        load_agent(tmp_path)
