"""The search keeps what it finds, goes on where it was, and finds the same everywhere; a better plan takes the place of a known one."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from glbench.agents.plans import PlanBook, PlanFolder, read_book
from glbench.bounds import Search, agent_controls, candidates, group_by_conditions, replay_plans, submit
from glbench.bounds import submitting as submitting_module
from glbench.control import Iteration
from glbench.errors import GlbenchError, SubmissionError
from glbench.evaluation import evaluate, protect
from glbench.resources import data_folder
from glbench.tasks import TaskSpec, get_task

SEEDS = (20_001, 20_002)
MY_AGENT = data_folder("submissions") / "my_agent.py"
ENERGY_AGENT = data_folder("submissions") / "energy_agent.py"


def a_search(task: TaskSpec, folder: Path, **options: int) -> Search:
    return Search(task, SEEDS, protect(MY_AGENT, "none"), folder, **{"iterations": 2, **options})  # type: ignore[arg-type]


def books(folder: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in folder.iterdir()}


def test_runs_in_which_the_same_is_given_share_a_plan(nominal: TaskSpec, drawn: TaskSpec) -> None:
    assert group_by_conditions(nominal, (4, 9, 2)) == ((4, 9, 2),)
    assert group_by_conditions(drawn, (4, 9, 2)) == ((4,), (9,), (2,))


@pytest.mark.parametrize("seed", [4, 9])
def test_a_plan_for_one_run_serves_all_with_the_same_conditions(nominal: TaskSpec, tmp_path: Path, seed: int) -> None:
    about = {"reward": 1.0, "epi": 1.0, "penalty": 0.0}
    PlanBook.of(nominal, (seed,), np.zeros((nominal.steps, 6)), about).save(tmp_path / f"{seed}.npz")
    search = Search(nominal, (4, 9, 2), MY_AGENT, tmp_path)
    (outcome,) = search.stored()
    assert outcome.seeds == (4, 9, 2)
    assert read_book(tmp_path / f"{seed}.npz").seeds == (2, 4, 9)
    assert search.jobs() == [], "planned once, whichever run of the group it was made for"


def test_machines_that_are_off_or_on_are_planned(tmp_path: Path) -> None:
    task = get_task("SpringEnergy-v1").replace({"id": "my/Energy-v1", "weather.days": 2}).in_split("validation")
    search = Search(task, (10000,), protect(ENERGY_AGENT, "none"), tmp_path, iterations=4)
    (outcome,) = search.run(search.jobs())
    start = evaluate(task, protect(ENERGY_AGENT, "none"), runs=1).runs[0].metrics["reward"]
    assert outcome.value is not None
    assert outcome.value.reward > start
    engine = [action.name for action in task.actions].index("uChp")
    assert np.unique(read_book(tmp_path / "10000.npz").plan(10000)[:, engine]).size > 1


def test_a_search_finds_better_plans_keeps_them_and_goes_on(drawn: TaskSpec, tmp_path: Path) -> None:
    search = a_search(drawn, tmp_path)
    told: list[tuple[int, Iteration]] = []
    first = next(found := search.run(search.jobs(), listener=lambda seed, one: told.append((seed, one))))
    assert first.seeds == (SEEDS[0],)
    found.close()  # as when somebody interrupts it
    assert [(seed, one.number) for seed, one in told] == [(SEEDS[0], 1), (SEEDS[0], 2)]
    assert [one.seeds for one in search.stored()] == [(SEEDS[0],)]

    before = books(tmp_path)
    rest = list(search.run(search.jobs()))
    assert [one.seeds for one in rest] == [(SEEDS[1],)]
    assert books(tmp_path).items() >= before.items()
    assert search.jobs() == []
    start = evaluate(drawn, MY_AGENT, runs=2, first_seed=SEEDS[0])
    for one, run in zip(search.stored(), start.runs, strict=True):
        assert one.value is not None
        assert one.value.reward > run.metrics["reward"]
        book = read_book(search.place(one.seeds))
        assert replay_plans(drawn, book, one.seeds)[one.seeds[0]] == one.value
        assert book.about_run(one.seeds[0])["start"] == "my_agent"


def test_processes_find_the_same_plans(drawn: TaskSpec, tmp_path: Path) -> None:
    alone, two = a_search(drawn, tmp_path / "alone"), a_search(drawn, tmp_path / "two", workers=2)
    told: list[int] = []
    for search in (alone, two):
        list(search.run(search.jobs(), listener=lambda seed, _one: told.append(seed)))
    assert books(tmp_path / "alone") == books(tmp_path / "two")
    assert sorted(told) == sorted([*SEEDS, *SEEDS] * 2)


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="Ray is not installed")
@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.filterwarnings("ignore::FutureWarning")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_ray_finds_the_same_plans(drawn: TaskSpec, tmp_path: Path) -> None:
    alone, ray = a_search(drawn, tmp_path / "alone"), a_search(drawn, tmp_path / "ray", workers=2)
    list(alone.run(alone.jobs()))
    list(ray.run(ray.jobs(), engine="ray"))
    assert books(tmp_path / "alone") == books(tmp_path / "ray")


def test_what_cannot_be_planned_is_said(drawn: TaskSpec, tmp_path: Path, nominal: TaskSpec) -> None:
    search = a_search(drawn, tmp_path)
    order = search.jobs()[0]
    with pytest.raises(GlbenchError, match="no engine 'gpu'"):
        list(search.run([order], engine="gpu"))
    (found,) = search.run([replace(order, task=replace(order.task, digest="0" * 64))])
    assert found.value is None
    assert "the task has a different digest" in found.reason
    (found,) = search.run([replace(order, controls=order.controls[1:])])
    assert "shape (48, 6)" in found.reason
    assert not list(tmp_path.iterdir())
    PlanBook.of(nominal, SEEDS, np.zeros((48, 6)), {}).save(search.place(SEEDS))
    with pytest.raises(GlbenchError, match="are not for test/Drawn-v1: they are for test/Nominal-v1"):
        search.stored()
    place = search.place(SEEDS)
    place.write_bytes(place.read_bytes()[:700])
    with pytest.raises(GlbenchError, match=r"npz is no book of plans, or a damaged one.* Remove the file to plan these runs again\."):
        search.stored()


def test_an_agent_that_fails_is_no_start(drawn: TaskSpec, tmp_path: Path) -> None:
    agent = tmp_path / "late.py"
    agent.write_text(
        "import numpy as np\nclass A:\n    def reset(self, task, n):\n        self.n, self.k = n, 0\n"
        "    def act(self, o):\n        self.k += 1\n        return np.full((self.n, 6), np.nan if self.k == 9 else 0.0)\n"
        "def make_agent(task):\n    return A()\n"
    )
    with pytest.raises(GlbenchError, match=r"'late' fails in the run with the seed 7.*--start"):
        agent_controls(drawn, protect(agent, "none"), [7])


@pytest.fixture
def published(monkeypatch: pytest.MonkeyPatch, drawn: TaskSpec) -> TaskSpec:
    """The short task, found by its id as published ones are."""
    monkeypatch.setattr(submitting_module, "get_task", lambda name: drawn if name == drawn.id else get_task(name))
    return drawn


def plan_of(task: TaskSpec, seed: int, change: float) -> PlanBook:
    actions = np.zeros((task.steps, 6))
    actions[:5, 0] = change
    return PlanBook.of(task, [seed], actions, {"method": f"heat by {change}"})


def test_only_better_plans_take_the_places_of_the_best_known(published: TaskSpec, known: PlanFolder, tmp_path: Path) -> None:
    changes = (0.0, 0.05, 0.5)
    earned = {change: replay_plans(published, plan_of(published, 3, change), [3])[3].reward for change in changes}
    worst, middle, best = sorted(changes, key=lambda change: earned[change])

    def handed_in(change: float, seed: int = 3) -> bool:
        file = tmp_path / "in" / f"{seed}.npz"
        plan_of(published, seed, change).save(file)
        (compared,) = submit([file], known)
        assert compared.value.reward == pytest.approx(earned[change], abs=1e-9 if seed == 3 else 10.0)
        return compared.is_better

    assert handed_in(middle)
    assert not handed_in(worst)
    assert not handed_in(middle)  # the same is no better
    assert handed_in(best)
    assert handed_in(worst, seed=4)
    book = known.book(published)
    assert book is not None
    assert book.seeds == (3, 4)
    assert book.about_run(3)["method"] == f"heat by {best}"
    assert book.about_run(4)["method"] == f"heat by {worst}"


def test_a_result_of_any_agent_may_be_handed_in(published: TaskSpec, known: PlanFolder, tmp_path: Path) -> None:
    result = evaluate(published, MY_AGENT, runs=2, first_seed=20, out=tmp_path)
    path = next(tmp_path.rglob("my_agent.json"))
    ((task, book),) = candidates(path)
    assert (task.digest, book.seeds) == (published.digest, (20, 21))
    compared = list(submit([path], known))
    adopted = read_book(known.place(published))
    for one in compared:
        assert adopted.about_run(one.seed)["reward"] == one.value.reward  # what `glbench bound` shows beside new plans
    assert all(one.is_better for one in compared)
    # Rounded actions earn nearly what the agent earned.
    for one, run in zip(compared, result.runs, strict=True):
        assert one.value.reward == pytest.approx(run.metrics["reward"], abs=0.02)


def test_controls_past_the_actuation_are_no_plan(published: TaskSpec, known: PlanFolder, tmp_path: Path) -> None:
    evaluate(published, "rule_based", runs=1, out=tmp_path)
    path = next(tmp_path.rglob("rule_based.json"))
    with pytest.raises(SubmissionError, match="past the task's actuation"):
        list(submit([path], known))
    (tmp_path / "nothing").mkdir()
    with pytest.raises(SubmissionError, match="no plans in"):
        list(submit([tmp_path / "nothing"], known))
    assert not known.files
