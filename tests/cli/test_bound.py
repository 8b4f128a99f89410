"""``glbench bound``: what it says, keeps, and takes over."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from glbench.agents.plans import PlanFolder
from glbench.bounds import submitting
from glbench.cli import bound as bound_command
from glbench.tasks import get_task
from tests.cli.command_line import Command


@pytest.mark.usefixtures("here")
def test_a_search_of_two_runs_and_again(glbench: Command) -> None:
    line = ("bound", "day.toml", "--scenario", "3", "--scenario", "4", "--iterations", "1", "--workers", "1", "--start", "steady.py")
    first = glbench(*line)
    assert first.code == 0, first.err
    assert "2 to plan, each with 1 iteration, beginning as steady does" in first.err
    assert "seed 3: reward" in first.err
    assert "Mean reward of 2 runs" in first.out
    assert sorted(file.name for file in Path("runs/bound/Day-v1").iterdir()) == ["3.npz", "4.npz", "card.toml"]
    assert "each file says from which agent's actions, and in how many iterations" in Path("runs/bound/Day-v1/card.toml").read_text()
    again = glbench(*line)
    assert "0 to plan" in again.err
    assert "kept" not in again.err
    assert again.out == first.out
    longer = glbench(*(option if option != "1" else "2" for option in line[:-4]), *line[-4:])
    assert "2 plans of another --start or --iterations kept" in " ".join(longer.err.split())
    assert longer.out == first.out

    # The advice for a task of one's own works as it is printed.
    advice = first.err.split("Evaluate the plans with: glbench ")[1].split()
    assert advice == ["evaluate", "runs/bound/Day-v1", "--task", "day.toml", "--seed", "3", "--runs", "2"]
    played = glbench(*advice, "--json")
    assert played.code == 0, played.err
    mean = json.loads(played.out)["summary"]["mean"]["reward"]
    assert f"Mean reward of 2 runs: {mean:,.3f}" in first.out


@pytest.mark.usefixtures("here")
def test_an_interrupted_search_says_how_many_plans_it_kept(glbench: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(bound_command, "_plans", stop)
    stopped = glbench("bound", "day.toml", "--scenario", "3", "--iterations", "1", "--start", "steady.py")
    assert "0 plans kept. Run the same command again to continue." in stopped.err


@pytest.mark.usefixtures("here")
def test_a_search_that_begins_with_a_result_finds_the_plan_of_one_that_begins_with_its_agent(glbench: Command) -> None:
    assert glbench("evaluate", "steady.py", "--task", "day.toml", "--sandbox", "none", "--runs", "2", "--seed", "3").code == 0
    result = next(Path("reports").rglob("steady.json"))
    line = ("bound", "day.toml", "--scenario", "4", "-n", "1", "--workers", "1")
    of_agent = glbench(*line, "--start", "steady.py", "--sandbox", "none", "--out", "plans/agent")
    of_result = glbench(*line, "--start", str(result), "--out", "plans/result")
    assert of_result.code == 0, of_result.err
    assert "beginning as actions_of_steady does" in of_result.err
    assert of_result.out == of_agent.out

    other = glbench("bound", "day.toml", "--scenario", "7", "-n", "1", "--start", str(result), "--out", "plans/other")
    assert other.code == 1
    assert "There is no plan for the run of test/Day-v1 with the seed 7" in " ".join(other.err.split())


@pytest.mark.usefixtures("here")
def test_plans_for_a_task_of_ones_own_never_become_those_of_a_published_one(
    glbench: Command, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """``mine/Spring-v1`` is not ``glbench/Spring-v1``, whatever the last part of its name."""
    Path("spring.toml").write_text(Path("day.toml").read_text().replace("test/Day-v1", "mine/Spring-v1"))
    shipped = tmp_path / "baselines" / "best_known" / "plans"
    shipped.mkdir(parents=True)
    monkeypatch.setattr(submitting, "best_known", lambda: PlanFolder(shipped))
    monkeypatch.setattr(submitting, "data_folder", lambda name: tmp_path / name)
    assert glbench("evaluate", "steady.py", "--task", "spring.toml", "--sandbox", "none", "--runs", "1").code == 0
    line = ("bound", "spring.toml", "--scenario", "3", "-n", "1", "--workers", "1", "--start", "steady.py")
    assert glbench(*line, "--sandbox", "none").code == 0
    result = next(Path("reports").rglob("steady.json"))
    for handed_in in (str(result), "runs/bound/Spring-v1"):
        refused = glbench("bound", "--submit", handed_in)
        assert refused.code == 1
        assert "Best known plans are those of published tasks, and mine/Spring-v1" in " ".join(refused.err.split())
    assert not list(shipped.iterdir())
    place = PlanFolder(shipped).place(get_task(Path("spring.toml")))
    assert place.name == f"Spring-v1-{get_task(Path('spring.toml')).digest[:12]}.npz"
    assert PlanFolder(shipped).place(get_task("Spring-v1")).name == "Spring-v1.npz"


@pytest.mark.usefixtures("here")
def test_plans_of_runs_that_are_not_scored_are_not_handed_in(glbench: Command, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Neither those of another split, nor those of other seeds of the test."""
    shipped = tmp_path / "baselines" / "best_known" / "plans"
    shipped.mkdir(parents=True)
    monkeypatch.setattr(submitting, "best_known", lambda: PlanFolder(shipped))
    monkeypatch.setattr(submitting, "data_folder", lambda name: tmp_path / name)
    line = ("bound", "SpringYears-v1", "-n", "1", "--workers", "1", "--start", "steady.py", "--sandbox", "none")
    made = glbench(*line, "--split", "training", "--scenario", "3", "--out", "training")
    assert made.code == 0, made.err
    assert "Hand in plans" not in made.err
    refused = glbench("bound", "--submit", "training")
    assert refused.code == 1
    assert (
        "Best known plans are for scored runs only, and some of these plans for glbench/SpringYears-v1 are for other runs"
        in refused.err.replace("\n", " ")
    )
    assert not list(shipped.iterdir())


@pytest.mark.usefixtures("here")
def test_set_points_are_refused_before_the_search(glbench: Command) -> None:
    Path("pc.toml").write_text('base = "glbench/Spring-v1"\nid = "my/PC-v1"\ntitle = "PC"\n[actuation]\nkind = "process_computer"\n')
    answer = glbench("bound", "pc.toml", "--start", "steady.py")
    assert answer.code == 1
    assert "A plan gives controls, and the actions of my/PC-v1 are of the kind 'process_computer'" in answer.err.replace("\n", " ")
    assert "Planning" not in answer.err


def test_better_plans_are_taken_over(glbench: Command, here: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    day = get_task(here / "day.toml")
    known = PlanFolder(tmp_path / "known")
    monkeypatch.setattr(submitting, "get_task", lambda _name: day)
    monkeypatch.setattr(submitting, "best_known", lambda: known)
    made = glbench("bound", "day.toml", "--scenario", "3", "--iterations", "1", "--workers", "1", "--start", "steady.py", "--out", "plans")
    assert made.code == 0, made.err
    taken = glbench("bound", "--submit", "plans")
    assert "1 of 1 plans for test/Day-v1 are better than the best known" in taken.out
    assert "0 of 1" in glbench("bound", "--submit", "plans/3.npz").out
    book = known.book(day)
    assert book is not None
    assert book.seeds == (3,)


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    ("line", "said"),
    [
        ((), "Name the task to plan for"),
        (("day.toml", "--submit", "x.npz"), "Name the task to plan for"),
        (("day.toml", "--split", "training"), "has no split 'training' to plan for"),
        (("Transfer-Miami-v1", "--split", "preview"), "has no split 'preview' to plan for"),
        (("Spring-v1", "--split", "winter"), "no split 'winter'"),
        (("--submit", "x.npz"), "There is no x.npz. `glbench bound` writes books of plans."),
        (("--submit", "x.npz", "--scenario", "3"), "--submit hands in existing plans."),
        (("--submit", "x.npz", "--iterations", "3"), "Leave out --scenario, --start, --iterations, --workers and --out."),
        (("--submit", "x.npz", "--workers", "1"), "Leave out --scenario, --start, --iterations, --workers and --out."),
        (("day.toml", "--start", "nobody"), "nobody"),
        (("day.toml", "--start", "steady.py", "--out", "day.toml"), "Cannot write into day.toml"),
    ],
)
def test_what_cannot_be_is_said(glbench: Command, line: tuple[str, ...], said: str) -> None:
    answer = glbench("bound", *line)
    assert answer.code == 1
    assert said in answer.err.replace("\n", " ")
    assert "Traceback" not in answer.err


def test_help_loads_no_optimiser(glbench: Command) -> None:
    before = set(sys.modules)
    assert "Search for the best plan" in glbench("bound", "--help").out
    assert not {name for name in set(sys.modules) - before if name.startswith("glbench.control")}
