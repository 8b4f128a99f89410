"""What an agent says that it is a training of, and the digest that tells its policy from others."""

from __future__ import annotations

import io
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest

from glbench.agents import load_agent
from glbench.agents.baselines import shipped_training
from glbench.agents.identity import baseline_like, baseline_names, policy_digest, read_identity
from glbench.agents.naming import skeleton, skeletons, without_seed
from glbench.errors import SubmissionError
from glbench.evaluation.evaluation import agent_record
from glbench.evaluation.records import AgentRecord
from glbench.resources import data_folder

CARD = 'name = "x"\nauthors = ["A"]\nlicence = "MIT"\ninformation = ["observations"]\nseed = 3\nrecipe = "mine"\n'
AGENT = "def make_agent(task): ...\n"


def weights(*values: float) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, layer=np.array(values))
    return buffer.getvalue()


def repacked(content: bytes) -> bytes:
    """The same members in another archive: compressed, and of another day."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as new:
        for item in old.infolist():
            new.writestr(zipfile.ZipInfo(item.filename, (2020, 2, 2, 2, 2, 2)), old.read(item))
    assert buffer.getvalue() != content
    return buffer.getvalue()


def folder(place: Path, policy: bytes | None, *, code: str = AGENT, card: str = CARD) -> Path:
    place.mkdir()
    (place / "agent.py").write_text(code)
    (place / "submission.toml").write_text(card)
    if policy is not None:
        (place / "weights.npz").write_bytes(policy)
    return place


def test_another_card_name_or_archive_makes_no_other_policy(tmp_path: Path) -> None:
    one = read_identity(folder(tmp_path / "a", weights(1.0, 2.0))).training
    assert one is not None
    assert (one.recipe, one.seed, one.form) == ("mine", 3, "python")
    card = CARD.replace('"x"', '"another title"').replace("seed = 3", "seed = 4")
    other = folder(tmp_path / "b", repacked(weights(1.0, 2.0)), code=f"# {AGENT}", card=card)
    assert read_identity(other).digest != read_identity(tmp_path / "a").digest
    training = read_identity(other).training
    assert training is not None
    assert (training.seed, training.policy) == (4, one.policy)
    third = read_identity(folder(tmp_path / "c", weights(1.0, 2.5))).training
    assert third is not None
    assert third.policy != one.policy


def test_without_files_of_weights_there_is_no_digest_of_them(tmp_path: Path) -> None:
    training = read_identity(folder(tmp_path / "a", None)).training
    assert training is not None
    assert training.policy is None
    assert policy_digest([]) is None


def test_an_agent_without_a_recipe_is_no_training_and_its_record_is_as_before(tmp_path: Path) -> None:
    agent = load_agent(folder(tmp_path / "a", None, card=CARD.replace('recipe = "mine"\n', "")))
    written = agent_record(agent).model_dump(mode="json")
    assert "training" not in written
    assert "recipe" not in written["card"]
    assert AgentRecord.model_validate_json(agent_record(agent).model_dump_json()) == agent_record(agent)


def test_a_folder_of_settings_is_the_training_that_its_card_names(tmp_path: Path) -> None:
    """As `glbench train` writes it; a shipped baseline's own record stays as it was."""
    assert agent_record(load_agent("ppo_fast_seed1")).training is None
    copy = tmp_path / "mine-seed1"
    shutil.copytree(data_folder("baselines") / "ppo_fast_seed1", copy)
    training = agent_record(load_agent(copy)).training
    assert training is not None
    assert (training.recipe, training.seed, training.form) == ("ppo_fast", 1, "actor")
    assert training.policy == policy_digest((data_folder("baselines") / "ppo_fast_seed1" / "weights").glob("*.npz"))


@pytest.mark.parametrize("table", ['recipe = "a b"\nseed = 1', 'recipe = "a"', 'recipe = "a"\nseed = "1"'])
def test_a_wrong_recipe_of_a_folder_of_settings_is_refused(tmp_path: Path, table: str) -> None:
    copy = tmp_path / "mine"
    shutil.copytree(data_folder("baselines") / "rule_based", copy)
    with (copy / "card.toml").open("a") as file:
        file.write(f"\n[training]\n{table}\n")
    with pytest.raises(SubmissionError, match=r"The card .* cannot be used: 'training\.(recipe|seed)'"):
        load_agent(copy)


def test_shipped_trainings_name_their_recipe_and_seed() -> None:
    stated = {name: shipped_training(name) for name in baseline_names()}
    found = {name: (one.recipe, one.seed) for name, one in stated.items() if one is not None}
    assert {name for name in found if name.rpartition("_")[0] != found[name][0]} == {
        "ppo", "sac", "ppo_tuned", "ppo_fast", "ppo_memory", "ppo_long", "sac_fast", "outdoor", "ppo_greenhouse", "ppo_memory_greenhouse",
        "ppo_energy", "ppo_energy_tuned", "ppo_harvest", "imitation_lettuce", "ppo_lettuce", "sac_lettuce", "td3_lettuce",
        "ppo_two_crops", "ppo_one_crop",
    }  # fmt: skip
    assert all(name == (f"{recipe}_seed{seed}" if seed or name != recipe else recipe) for name, (recipe, seed) in found.items())
    assert {name for name in baseline_names() if (data_folder("baselines") / name / "weights").is_dir()} == set(found)
    assert shipped_training("anna") is None


@pytest.mark.parametrize(
    "name",
    [
        "PPO",
        "p.p-o",
        "PP0",
        "ppo_seed7",
        "ppo-Seed_7",
        "ppo_s33d7",
        "ppo_seed1_seed2",
        "\u0440\u0440\u043e",
        "5ac",
        "grovver",
        "9rower",
        "ppoo",
        "mppc",
        "ppo_seed2_seed69",
    ],
)
def test_names_that_look_like_a_baseline(name: str) -> None:
    assert baseline_like(name) in {"ppo", "sac", "grower", "mpc"}


@pytest.mark.parametrize("name", ["anna", "ppo2", "my_ppo", "oracle", "reseed", "seed1"])
def test_names_that_look_like_no_baseline(name: str) -> None:
    assert baseline_like(name) is None


@pytest.mark.parametrize(
    ("one", "other"), [("6est_plan", "best_plan"), ("club", "dub"), ("tunned", "tuned"), ("zed", "2ed"), ("a_seed26", "a_seed9")]
)
def test_names_that_look_like_each_other(one: str, other: str) -> None:
    assert skeletons(one) & skeletons(other)


@pytest.mark.parametrize(("one", "other"), [("agent_1", "agent_11"), ("plan_2", "plan_3"), ("phased", "pha"), ("v2.0", "v2.00")])
def test_names_that_can_be_told_apart(one: str, other: str) -> None:
    assert not skeletons(one) & skeletons(other)


def test_no_two_shipped_agents_look_alike() -> None:
    names = [*baseline_names(), *(file.stem for file in data_folder("submissions").glob("*.py"))]
    assert len({skeleton(name) for name in names}) == len(names)


def test_a_name_without_its_seed() -> None:
    assert [without_seed(name) for name in ("a_seed1", "a-seed12", "seed1", "a")] == ["a", "a", "seed1", "a"]
    assert skeletons("Anna_seed3") & skeletons("ann4-seed9")
