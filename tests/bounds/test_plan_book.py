"""Books of plans: small, exact where it matters, refused where they do not fit, and carried out as they are."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from glbench.agents.plans import HALF_SCALE, PlanBook, PlanFolder, read_book
from glbench.bounds import replay_plans
from glbench.env import Simulation
from glbench.errors import GlbenchError, ShapeError, SubmissionError
from glbench.evaluation import evaluate
from glbench.kernel import StepFailure
from glbench.tasks import TaskSpec, get_task

ABOUT = {"method": "made up", "iterations": 3}


def actions(task: TaskSpec, seed: int = 1) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Changes as a plan has them: many small ones, some at the bounds, some of nothing."""
    rng = np.random.default_rng(seed)
    small = rng.normal(0.0, 0.1, (task.steps, len(task.actions)))
    return np.clip(np.where(rng.random(small.shape) < 0.1, 5.0 * small, small) * (rng.random(small.shape) < 0.8), -1.0, 1.0)


def test_a_book_reads_back_and_has_the_same_bytes(drawn: TaskSpec, tmp_path: Path) -> None:
    book = PlanBook.of(drawn, [3, 5], actions(drawn), ABOUT)
    book.save(tmp_path / "book.npz")
    read = read_book(tmp_path / "book.npz")
    assert read.to_bytes() == book.to_bytes() == (tmp_path / "book.npz").read_bytes()
    assert (read.seeds, read.about_run(5)) == ((3, 5), ABOUT)
    assert np.array_equal(read.plan(3), book.plan(5))
    assert read.why_not(drawn) is None


def test_rounding_never_adds_up(drawn: TaskSpec) -> None:
    """What is left over goes into the next step: the controls stay where the plan has them. Nothing stays nothing."""
    wanted = actions(drawn)
    plan = PlanBook.of(drawn, [3], wanted, ABOUT).plan(3)
    assert np.abs(plan).max() <= 1.0
    assert np.abs(np.cumsum(plan - wanted, axis=0)).max() <= 0.51 / HALF_SCALE
    still = PlanBook.of(drawn, [3], np.zeros_like(wanted), ABOUT).plan(3)
    assert (still == 0.0).all()


def test_actions_that_are_no_changes_are_rounded_each_for_itself(drawn: TaskSpec) -> None:
    direct = drawn.replace(id="test/Direct-v1", actuation={"kind": "set_point"})
    wanted = np.random.default_rng(2).random((direct.steps, 6))
    wanted[7], wanted[8] = 0.0, 1.0
    plan = PlanBook.of(direct, [3], wanted, ABOUT).plan(3)
    assert np.abs(plan - wanted).max() <= 0.25 / HALF_SCALE + 1e-12
    assert (plan[7] == 0.0).all()
    assert (plan[8] == 1.0).all()


def test_books_of_a_task_go_together(drawn: TaskSpec, nominal: TaskSpec) -> None:
    first, second = (PlanBook.of(drawn, [3, 5], actions(drawn, 1), ABOUT), PlanBook.of(drawn, [5, 7], actions(drawn, 2), ABOUT))
    both = first.merged(second)
    assert both.seeds == (3, 5, 7)
    assert np.array_equal(both.plan(3), first.plan(3))
    assert np.array_equal(both.plan(5), second.plan(5))
    assert len(both.about) == 2
    assert both.merged(PlanBook.of(drawn, [3], actions(drawn, 3), ABOUT)).actions.shape[0] == 2  # nobody needs the first any more
    assert both.only([7]).seeds == (7,)
    with pytest.raises(SubmissionError, match="do not go together"):
        first.merged(PlanBook.of(nominal, [9], actions(nominal), ABOUT))


def test_what_is_no_plan_is_refused(drawn: TaskSpec, tmp_path: Path) -> None:
    wanted = actions(drawn)
    with pytest.raises(ShapeError, match=r"shape \(48, 6\); got \(47, 6\)"):
        PlanBook.of(drawn, [3], wanted[1:], ABOUT)
    wanted[4, 2] = np.nan
    with pytest.raises(ShapeError, match="finite"):
        PlanBook.of(drawn, [3], wanted, ABOUT)
    book = PlanBook.of(drawn, [3], actions(drawn), ABOUT)
    with pytest.raises(ShapeError, match="above 2000"):
        replace(book, actions=book.actions + 2001)
    with pytest.raises(ShapeError, match="do not belong together"):
        replace(book, runs={3: 1})
    (tmp_path / "cut.npz").write_bytes(book.to_bytes()[:-40])
    (tmp_path / "text.npz").write_text("plans")
    np.savez(tmp_path / "other.npz", format=np.int64(9))
    for name, reason in {"cut": "damaged", "text": "damaged", "other": "has format 9", "missing": "There is no "}.items():
        with pytest.raises(SubmissionError, match=reason):
            read_book(tmp_path / f"{name}.npz")


def test_plans_are_for_one_task_with_known_draws_in_one_split(drawn: TaskSpec) -> None:
    book = PlanBook.of(drawn, [3], actions(drawn), ABOUT)
    assert "digest" in str(book.why_not(drawn.replace(uncertainty={"delta": 0.2})))
    spring = get_task("Spring-v1")
    test, training = spring.in_split("test"), spring.in_split("training")
    of_test = PlanBook.of(test, [10_000], np.zeros((test.steps, 6)), ABOUT)
    assert of_test.why_not(test) is None
    assert of_test.why_not(training) == "they are for the test split, and this is the training one"
    assert "secret" in str(of_test.why_not(spring.in_split("test", "12" * 32)))


def test_an_evaluation_carries_out_the_plan_of_each_run(drawn: TaskSpec, tmp_path: Path) -> None:
    """As the simulation does, whatever the other runs are; and the record says that it is privileged and acts through the actuation."""
    folder = tmp_path / "planned"
    plans = PlanFolder(folder / "plans")
    seeds = range(10, 13)
    for seed in seeds:
        book = PlanBook.of(drawn, [seed], actions(drawn, seed), ABOUT)
        known = plans.book(drawn)
        (book if known is None else known.merged(book)).save(plans.place(drawn))
    (folder / "card.toml").write_text(
        'title = "p"\ncontroller = "plans"\nsettings = "plans"\ndescription = "d"\nmade = "m"\nsources = []\n'
    )
    result = evaluate(drawn, folder, runs=3, first_seed=10, out=tmp_path / "out")
    assert not result.failed
    assert result.agent.privileged
    book = plans.book(drawn)
    assert book is not None
    earned = replay_plans(drawn, book, list(seeds))
    for run in result.runs:
        assert run.metrics["reward"] == earned[run.seed].reward
        assert run.metrics["epi"] == earned[run.seed].epi
        alone = Simulation(drawn, 1)
        alone.reset([run.seed])
        assert sum(float(alone.step(action[None]).rewards[0]) for action in book.plan(run.seed)) == pytest.approx(run.metrics["reward"])
    with pytest.raises(SubmissionError, match="no plan for the run of test/Drawn-v1 with the seed 99"):
        evaluate(drawn, folder, runs=1, first_seed=99)


def test_without_plans_the_controller_says_how_to_get_some(nominal: TaskSpec) -> None:
    with pytest.raises(SubmissionError, match=rf"there are none for its digest {nominal.digest[:12]}"):
        evaluate(nominal, "best_known", runs=1)


FIRST_RUNS = {"glbench/FullSeason-v1": 10, "glbench/FullSeasonEnergy-v1": 10}
"""Tasks of which the first runs alone have plans, and how many."""


def test_shipped_plans_belong_to_the_shipped_tasks() -> None:
    from glbench.bounds import best_known

    files = best_known().files
    assert files
    for file in files:
        book = read_book(file)
        task = get_task(book.task_id)
        assert book.why_not(task.in_split("test") if task.splits is not None else task) is None
        assert set(book.runs) == set(task.scored.evaluation.seeds[: FIRST_RUNS.get(book.task_id)])
        assert all({"method", "reward", "epi", "penalty", "glbench"} <= set(about) for about in book.about)


def test_an_error_of_a_plan_is_told_with_its_step(drawn: TaskSpec, monkeypatch: pytest.MonkeyPatch) -> None:
    book = PlanBook.of(drawn, [3], actions(drawn), ABOUT)
    real = Simulation.step

    def breaking(self: Simulation, given: object) -> object:
        outcome = real(self, given)  # type: ignore[arg-type]
        if self.k[0] == 5:
            outcome = replace(outcome, failed=[StepFailure(0, "too hot")])
        return outcome

    monkeypatch.setattr(Simulation, "step", breaking)
    with pytest.raises(GlbenchError, match="Step 5 of the plan for the seed 3 cannot be simulated: too hot"):
        replay_plans(drawn, book, [3])
