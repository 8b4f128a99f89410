"""Tuning rules: what it finds, that it can be repeated and continued, that it never sees a test, and what it refuses."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from glbench.agents import load_agent
from glbench.agents.energy_rules import EnergyRuleSettings
from glbench.agents.tuned_rules import RulePage, TunedRuleSettings, read_rule_page, settings_text
from glbench.env import Simulation
from glbench.errors import TaskError, TrainingError
from glbench.resources import data_folder
from glbench.tasks import TaskSpec, get_task
from glbench.training.rule_search import Candidates, RuleSearchSettings, reward_of, shipped_start, tune_rules
from glbench.training.settings import FIRST_TRAINING_SEED, EvaluationPlan
from tests.training.watching import PowerCutError, Watching

pytestmark = pytest.mark.train

SETTINGS = RuleSearchSettings(population=6, seasons=36, sigma=0.1, evaluation=EvaluationPlan(every=288, runs=2, first_seed=20_000_000_000))
"""Six generations of a day, evaluated after every second one."""


@pytest.fixture(scope="module")
def page(day: TaskSpec) -> RulePage:
    """The shipped rules, made worse: a cold house with shut vents."""
    shipped = read_rule_page(shipped_start([day]))
    worse = {"heating_night": 12.0, "vents_humidity_night": 2.0}
    return RulePage(shipped.scope, shipped.numbers.model_copy(update=worse))


@pytest.fixture(scope="module")
def start(page: RulePage, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of that page."""
    file = tmp_path_factory.mktemp("start") / "cold.yml"
    file.write_text(settings_text(page), encoding="utf-8")
    return file


def test_it_finds_better_rules_within_their_bounds(day: TaskSpec, page: RulePage, start: Path, tmp_path: Path) -> None:
    watching = Watching()
    found = tune_rules([day], start, SETTINGS, tmp_path / "run", listeners=[watching])

    assert found.best_reward == max(point.result.reward for point in watching.points) > watching.points[0].result.reward
    assert found.steps == 6 * 6 * 24 == watching.told[-1].steps == watching.told[-1].total_steps
    assert [point.steps for point in watching.points] == [0, 288, 576, 864]
    after = read_rule_page(tmp_path / "run" / "rules.yml")
    assert after.scope == page.scope
    for name, value in after.numbers.model_dump().items():
        low, high = TunedRuleSettings.bounds(name)
        assert low <= value <= high, name
    changed = {name for name, value in after.numbers.model_dump().items() if value != getattr(page.numbers, name)}
    assert len(changed) > 30
    assert changed <= set(TunedRuleSettings.tuned_names())


def test_the_folder_is_an_agent_and_its_card_tells_how_it_was_made(day: TaskSpec, start: Path, tmp_path: Path) -> None:
    tune_rules([day], start, SETTINGS, tmp_path / "run", seed=3)

    card = tomllib.loads((tmp_path / "run" / "card.toml").read_text(encoding="utf-8"))
    assert (card["controller"], card["settings"]) == ("rule_based_tuned", "rules.yml")
    assert (card["task"]["id"], card["task"]["digest"]) == (day.id, day.digest)
    training = card["training"]
    assert (training["seed"], training["generations"], training["seasons"]) == (3, 6, 36)
    assert training["season_seeds"] == [30_000_000_000, 30_000_000_005]
    assert card["best"]["evaluation_seeds"] == [20_000_000_000, 20_000_000_001]
    assert (tmp_path / "run" / "start.yml").read_bytes() == start.read_bytes()
    assert card["start"]["file"] == "cold.yml"
    agent = load_agent(tmp_path / "run")
    assert agent.privileged is False


def test_the_same_seed_finds_the_same_and_another_seed_another(day: TaskSpec, start: Path, tmp_path: Path) -> None:
    numbers = []
    for name, seed in (("a", 0), ("b", 0), ("c", 1)):
        tune_rules([day], start, SETTINGS, tmp_path / name, seed=seed)
        numbers.append(read_rule_page(tmp_path / name / "rules.yml").numbers)
    assert numbers[0] == numbers[1] != numbers[2]


@pytest.mark.parametrize("generations", [1, 4, 5])
def test_a_search_that_was_killed_goes_on_to_the_same_rules(day: TaskSpec, start: Path, tmp_path: Path, generations: int) -> None:
    tune_rules([day], start, SETTINGS, tmp_path / "whole")
    with pytest.raises(PowerCutError):
        tune_rules([day], start, SETTINGS, tmp_path / "cut", listeners=[Watching(generations)])
    watching = Watching()
    tune_rules([day], start, SETTINGS, tmp_path / "cut", listeners=[watching])

    assert len(watching.told) == 6 - generations  # no generation is simulated twice
    for name in ("rules.yml", "start.yml", "settings.yml"):
        assert (tmp_path / "cut" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    with np.load(tmp_path / "cut" / "search.npz") as cut, np.load(tmp_path / "whole" / "search.npz") as whole:
        assert cut["rewards"].tobytes() == whole["rewards"].tobytes()
    assert tune_rules([day], start, SETTINGS, tmp_path / "cut").already_done


def test_more_seasons_go_on_from_fewer(day: TaskSpec, start: Path, tmp_path: Path) -> None:
    tune_rules([day], start, SETTINGS.model_copy(update={"seasons": 12}), tmp_path / "run")
    more = Watching()
    tune_rules([day], start, SETTINGS, tmp_path / "run", listeners=[more])
    assert len(more.told) == 4
    tune_rules([day], start, SETTINGS, tmp_path / "whole")
    assert (tmp_path / "run" / "rules.yml").read_bytes() == (tmp_path / "whole" / "rules.yml").read_bytes()


def test_another_search_is_not_continued(day: TaskSpec, start: Path, tmp_path: Path) -> None:
    with pytest.raises(PowerCutError):
        tune_rules([day], start, SETTINGS, tmp_path / "run", listeners=[Watching(2)])
    other = tmp_path / "other.yml"
    other.write_text(start.read_text(encoding="utf-8").replace("heating_night: 12.0", "heating_night: 12.5"), encoding="utf-8")
    with pytest.raises(TrainingError, match="holds another search"):
        tune_rules([day], other, SETTINGS, tmp_path / "run")


def test_candidates_of_a_generation_share_their_seasons_and_those_of_no_test(
    day: TaskSpec, start: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spring = get_task("Spring-v1")
    seen: list[tuple[str | None, list[int]]] = []
    reset = Simulation.reset

    def watched(simulation: Simulation, seeds: list[int]) -> object:
        seen.append((simulation.task.split, list(seeds)))
        return reset(simulation, seeds)

    monkeypatch.setattr(Simulation, "reset", watched)
    tune_rules([day], start, SETTINGS.model_copy(update={"seasons": 12}), tmp_path / "paper")
    tuning = [seeds for _, seeds in seen if len(seeds) == 6]
    assert tuning == [[30_000_000_000] * 6, [30_000_000_001] * 6]
    assert min(seed for _, seeds in seen for seed in seeds) >= FIRST_TRAINING_SEED

    seen.clear()
    few = SETTINGS.model_copy(update={"population": 4, "seasons": 4})
    with monkeypatch.context() as short:
        short.setattr("glbench.training.periodic_evaluation.season_sums", lambda simulation, seeds, _: _begin(simulation, seeds))
        short.setattr("glbench.training.periodic_evaluation.season_sums", lambda simulation, seeds, _: _begin(simulation, seeds))
        tune_rules([spring], shipped_start([spring]), few, tmp_path / "spring")
    assert [split for split, _ in seen] == ["validation", "training", "validation"]
    assert min(seed for _, seeds in seen for seed in seeds) >= FIRST_TRAINING_SEED
    card = tomllib.loads((tmp_path / "spring" / "card.toml").read_text(encoding="utf-8"))
    assert (card["training"]["split"], card["training"]["chosen_on"]) == ("training", "validation")
    assert card["training"]["years"] == [2008, 2009, 2010]


def _begin(simulation: Simulation, seeds: list[int]) -> dict[str, object]:
    """A season cut short: its runs are begun, and that is all."""
    simulation.reset(seeds)
    return {"reward": np.arange(float(len(seeds))), "epi": np.zeros(len(seeds)), "penalty": np.zeros(len(seeds))}


def test_a_test_is_never_tuned_for(start: Path, tmp_path: Path) -> None:
    spring = get_task("Spring-v1")
    for split in ("test", "validation"):
        with pytest.raises(TrainingError, match=f"was given in its split '{split}'"):
            tune_rules([spring.in_split(split)], start, SETTINGS, tmp_path / split)
    with pytest.raises(TaskError, match="has no training split"):
        tune_rules([get_task("Transfer-Miami-v1")], start, SETTINGS, tmp_path / "transfer")
    with pytest.raises(ValueError, match="is not a seed for training"):
        RuleSearchSettings(first_seed=666)
    with pytest.raises(TrainingError, match="name one with --task"):
        tune_rules([], start, SETTINGS, tmp_path / "none")


def test_rewards_of_several_tasks_are_averaged_when_they_are_of_one_kind(day: TaskSpec, start: Path, tmp_path: Path) -> None:
    dim = day.replace(id="test/Dim-v1", uncertainty={"delta": 0.0})
    settings = SETTINGS.model_copy(update={"seasons": 12})
    found = tune_rules([day, dim], start, settings, tmp_path / "both")
    assert found.steps == 2 * 6 * 24
    card = tomllib.loads((tmp_path / "both" / "card.toml").read_text(encoding="utf-8"))
    assert card["task"]["ids"] == [day.id, dim.id]
    assert tune_rules([day, dim], start, settings, tmp_path / "both").already_done
    with pytest.raises(TrainingError, match=r"different rewards cannot be added up .*epi, scaled_penalty"):
        reward_of([day, get_task("Spring-v1")])
    with pytest.raises(TrainingError, match="named twice"):
        reward_of([day, day])


def test_a_search_begins_with_the_shipped_rules_for_the_reward(day: TaskSpec, start: Path, tmp_path: Path) -> None:
    rules = data_folder("baselines") / "rule_based_tuned" / "rules"
    assert shipped_start([day]) == rules / "paper.yml"
    assert shipped_start([get_task("SpringYears-v1"), get_task("Spring-v1")]) == rules / "spring.yml"


def test_where_power_has_an_hourly_price_the_energy_rules_are_tuned(tmp_path: Path) -> None:
    task = get_task("SpringEnergy-v1")
    rules = data_folder("baselines") / "rule_based_energy" / "rules"
    assert shipped_start([task]) == rules / "springenergy.yml"
    with pytest.raises(TrainingError, match=r"No rules are shipped for test/Day-v1. Give a page"):
        shipped_start([task.replace({"id": "test/Day-v1"})])
    day = task.replace({"id": "test/Day-v1", "weather.days": 1})
    watching = Watching()
    settings = SETTINGS.model_copy(update={"evaluation": EvaluationPlan(every=1152, runs=2)})
    found = tune_rules([day], rules / "springenergy.yml", settings, tmp_path / "run", listeners=[watching])

    assert found.best_reward == max(point.result.reward for point in watching.points)
    page = read_rule_page(tmp_path / "run" / "rules.yml", EnergyRuleSettings)
    assert page.scope == ("test/Day-v1",)
    for name, value in page.numbers.model_dump().items():
        low, high = EnergyRuleSettings.bounds(name)
        assert low <= value <= high, name
    card = tomllib.loads((tmp_path / "run" / "card.toml").read_text(encoding="utf-8"))
    assert (card["controller"], card["settings"]) == ("rule_based_energy", "rules.yml")
    assert load_agent(tmp_path / "run").privileged is False


def test_what_was_spent_on_the_start_is_told(day: TaskSpec, start: Path, tmp_path: Path) -> None:
    few = SETTINGS.model_copy(update={"seasons": 12})
    tune_rules([day], start, few, tmp_path / "first")
    tune_rules([day], tmp_path / "first" / "rules.yml", few, tmp_path / "second")
    card = tomllib.loads((tmp_path / "second" / "card.toml").read_text(encoding="utf-8"))
    assert (card["start"]["file"], card["start"]["steps"]) == ("rules.yml", 2 * 6 * 24)


def test_candidates_are_numbers_between_their_bounds(page: RulePage) -> None:
    candidates = Candidates(page)
    tuned = TunedRuleSettings.tuned_names()
    assert candidates.page(candidates.mean).numbers == page.numbers
    lowest, highest = candidates.numbers(np.full(len(tuned), -1.0)), candidates.numbers(np.full(len(tuned), 2.0))
    for name in tuned:
        assert (getattr(lowest, name), getattr(highest, name)) == pytest.approx(TunedRuleSettings.bounds(name))
    assert lowest.lamps_until == page.numbers.lamps_until
