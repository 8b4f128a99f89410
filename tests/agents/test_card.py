"""``submission.toml``: what it may say, and that everything wrong in it is told at once."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from glbench.agents import identify, load_agent
from glbench.agents.card import SubmissionCard, check_card, read_card
from glbench.errors import SubmissionError
from glbench.evaluation.records import AgentRecord

Write = Callable[[str, str], Path]

CARD = """
name = "Anna's controller"
authors = ["Anna", "Otto"]
licence = "MIT"
link = "https://example.org/anna"
information = ["observations", "model"]
algorithm = "PPO"
seed = 3
requires = ["torch"]

[training]
steps = 1_000_000
wall_hours = 2
"""
STILL = """
import numpy as np
class Still:
    def reset(self, task, n_runs): self.shape = (n_runs, len(task.actions))
    def act(self, observations): return np.zeros(self.shape)
def make_agent(task):
    return Still()
"""


def test_a_card_is_read_with_its_training_and_in_words(write: Write) -> None:
    card = read_card(write("submission.toml", CARD))
    assert card.authors == ("Anna", "Otto")
    assert card.training is not None
    assert (card.training.steps, card.training.wall_hours) == (1_000_000, 2.0)
    assert card.information == ("observations", "model")


def test_a_card_comes_back_from_a_result_as_it_went_in(write: Write) -> None:
    card = read_card(write("submission.toml", CARD))
    record = AgentRecord(name="a", kind="submission", digest="0" * 64, privileged=False, information="observations", card=card)
    assert AgentRecord.model_validate_json(record.model_dump_json()).card == card


def test_results_without_a_card_still_load() -> None:
    old = {"name": "a", "kind": "submission", "digest": "0" * 64, "privileged": False, "information": "observations"}
    assert AgentRecord.model_validate_json(json.dumps(old)).card is None


def test_everything_wrong_is_told_at_once_with_what_it_should_look_like(write: Write) -> None:
    text = 'nam = "x"\nauthors = "Anna"\nlicence = "MIT"\ninformation = ["observation"]\nseed = "one"\nlink = "example"\n'
    card, problems = check_card(write("submission.toml", text))
    assert card is None
    told = "\n".join(problems)
    assert "'name' is missing, such as name = \"Anna's controller\"" in told
    assert "'nam' is not a key of a card. Did you mean 'name'" in told
    assert "'authors' is 'Anna'" in told
    assert 'authors = ["Anna Example"]' in told
    assert "'information.0' is 'observation', expected one of observations, forecast, weather, model, privileged" in told
    assert "'seed' is 'one'" in told
    assert "'link'" in told


@pytest.mark.parametrize(
    ("more", "complaint"),
    [
        ('agent = "agent.py"\nmodel = "model.zip"', "not both"),
        ('agent = "agent.py"\nclip_actions = true', "for saved policies"),
        ("[normalisation]\nmean = [0.0, 1.0]\nstd = [1.0]", "mean has 2 values and std 1"),
        ("[normalisation]\nmean = [0.0]\nstd = [0.0]", "every std must be above 0"),
        ("[normalisation]\nmean = [0.0, 0.0]\nstd = [1.0, 1e-300]", "std of column 1 is 1e-300, expected 1e-12 to"),
        ("[normalisation]\nmean = [-1e20]\nstd = [1.0]", "mean of column 0 is -1e+20, expected -1e+12 to"),
        ("[normalisation]\nmean = [0.0]\nstd = [1.0]\nclip = 1e-320", "greater than or equal to 0.000001"),
        ("[training]\nstep = 3", "'step' is not a key of a card. Did you mean 'steps'"),
        ("[training]\nsteps = -3", "'training.steps' is -3"),
        ("wall = [", "no valid TOML"),
        ('agent = "../agent.py"', "'agent' is '../agent.py'"),
    ],
)
def test_what_does_not_fit_together_is_refused(write: Write, more: str, complaint: str) -> None:
    base = 'name = "x"\nauthors = ["A"]\nlicence = "MIT"\ninformation = ["observations"]\n'
    with pytest.raises(SubmissionError) as caught:
        read_card(write("submission.toml", base + more + "\n"))
    assert complaint in str(caught.value)


def test_a_card_lies_in_the_folder_or_beside_the_file_and_is_part_of_the_digest(write: Write) -> None:
    file = write("anna.py", STILL)
    alone = load_agent(file)
    assert alone.submission is not None
    assert alone.submission.card is None
    beside = write("anna.toml", CARD)
    with_card = load_agent(file)
    assert with_card.submission is not None
    assert with_card.submission.card == read_card(beside)
    assert set(with_card.submission.files) == {file.resolve(), beside.resolve()}
    assert with_card.digest != alone.digest
    folder = write("mine/agent.py", STILL).parent
    write("mine/submission.toml", CARD)
    assert load_agent(folder).submission.card == read_card(beside)  # type: ignore[union-attr]


def test_the_card_says_which_file_of_a_folder_is_run(write: Write) -> None:
    folder = write("mine/other.py", STILL).parent
    write("mine/submission.toml", CARD.replace("algorithm", 'agent = "other.py"\nalgorithm'))
    found = identify(folder)
    assert found is not None
    assert found.entry == (folder / "other.py").resolve()
    write("mine/submission.toml", CARD.replace("algorithm", 'agent = "gone.py"\nalgorithm'))
    with pytest.raises(SubmissionError, match=r"names the file 'gone.py', and the folder has none"):
        identify(folder)


@pytest.mark.parametrize(
    ("key", "complaint"),
    [
        ('model = "anna.py"', "it is a Python code: write agent"),
        ('agent = "otto.py"', "Name anna.py there"),
        ('normalisation = "x.pkl"', "for saved policies"),
    ],
)
def test_a_card_that_speaks_of_another_file_is_refused(write: Write, key: str, complaint: str) -> None:
    file = write("anna.py", STILL)
    write("anna.toml", CARD.replace("algorithm", f"{key}\nalgorithm"))
    with pytest.raises(SubmissionError) as caught:
        load_agent(file)
    assert complaint in str(caught.value)


def test_the_card_has_no_field_that_the_guide_does_not_explain() -> None:
    guide = (Path(__file__).parents[2] / "docs" / "submit.md").read_text(encoding="utf-8")
    assert [name for name in SubmissionCard.model_fields if f"`{name}`" not in guide] == []


def test_trainings_of_a_recipe_need_a_seed(tmp_path: Path) -> None:
    file = tmp_path / "anna.toml"
    text = 'name = "x"\nauthors = ["A"]\nlicence = "MIT"\ninformation = ["observations"]\nrecipe = "mine"\n'
    file.write_text(text)
    card, problems = check_card(file)
    assert (card, problems) == (
        None,
        ["a 'recipe' needs a 'seed', because trainings of one recipe differ in their seed: add, for example, seed = 1"],
    )
    file.write_text(f"{text}seed = 0\n")
    assert read_card(file).recipe == "mine"
    file.write_text(text.replace('"mine"', '"my recipe"') + "seed = 0\n")
    assert "'recipe' is 'my recipe'" in check_card(file)[1][0]
