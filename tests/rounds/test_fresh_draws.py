"""Fresh draws: a result again under a salt of its own, which an agent with carried plans does not survive and a sensible one does."""

from __future__ import annotations

import dataclasses
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from docs.fresh_draws_table import write_carrier
from glbench.agents import identify, load_agent
from glbench.agents.plans import PlanBook
from glbench.control import Scenario, plan_season
from glbench.errors import ResultError, SandboxError, TaskError
from glbench.evaluation import Result, fresh_draws, load_result, prepare, protect, result_path
from glbench.evaluation.evaluation import results_folder
from glbench.evaluation.files import save_result
from glbench.evaluation.fresh_draws import FOLDER, REFERENCES, add_fresh_draws, check_fresh_draws, fresh_actions_path
from glbench.evaluation.jobs import Job, Options
from glbench.evaluation.records import RunResult, summarise
from glbench.evaluation.sandbox.bubblewrap import why_no_sandbox
from glbench.evaluation.sandbox.choosing import Protected, keep_out_of_sight
from glbench.evaluation.sandbox.frames import Prints
from glbench.leaderboard import StoredResult, rank, to_frame, to_markdown
from glbench.leaderboard.catalogue import catalogue
from glbench.leaderboard.fresh_draws import ERROR, FEWEST, drop_beside, fresh_score, fresh_score_over, fresh_words, shift_by_ranks
from glbench.leaderboard.tables import DROP_MARK, FRESH_NOTE, to_json, to_latex
from glbench.report import build_report
from glbench.tasks import Round, TaskSpec, get_task, read_round, task_card
from glbench.tasks.sealed import write_round
from glbench.verification import verify, was_reproduced
from tests.cli.command_line import Command
from tests.evaluation.agent_files import AgentWriter
from tests.rounds.tiny import TINY, tiny_task

NO_SANDBOX = why_no_sandbox()
needs_sandbox = pytest.mark.skipif(NO_SANDBOX is not None, reason=str(NO_SANDBOX))
RUNS = 20


def do(job: Job) -> Result:
    evaluation = job.prepare()
    return evaluation.stored or evaluation.run()


def with_fresh_draws(task: TaskSpec, ref: str | Path, out: Path) -> Path:
    """File of the result of an agent, with fresh draws."""
    job = Job(task, str(ref), protect(ref, "auto"), Options(out))
    do(job)
    add_fresh_draws(job, do)
    return result_path(out, task.id, job.agent_name)


@pytest.fixture(scope="session")
def honest_reports(tiny: TaskSpec, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("fresh") / "reports"
    with_fresh_draws(tiny, "rule_based_fair", out)
    return out


@pytest.fixture
def honest(honest_reports: Path, tiny: TaskSpec, tmp_path: Path) -> Path:
    """A copy of an honest result with fresh draws."""
    return result_path(Path(shutil.copytree(honest_reports, tmp_path / "fresh")), tiny.id, "rule_based_fair")


def rewrite(path: Path, change: Callable[[dict[str, Any]], None], *, repair: bool = True) -> None:
    """Change the fresh draws in the file; with ``repair`` their digest follows."""
    document = json.loads(path.read_text())
    change(document["fresh_draws"])
    path.write_text(json.dumps(document))
    if repair:
        fresh = load_without_checks(document).fresh_draws
        assert fresh is not None
        document["fresh_draws"]["digest"] = fresh.computed_digest(document["results_digest"])
        path.write_text(json.dumps(document))


def load_without_checks(document: dict[str, Any]) -> Result:
    from glbench.evaluation.records import FreshDraws

    fresh = FreshDraws.model_validate_json(json.dumps(document["fresh_draws"]))
    return Result.model_construct(fresh_draws=fresh)


# What is saved


def test_the_result_has_both_and_the_salt_by_which_anybody_can_repeat_it(honest: Path, tiny: TaskSpec) -> None:
    result = load_result(honest)
    fresh = result.fresh_draws
    assert fresh is not None
    assert [run.seed for run in fresh.runs] == [run.seed for run in result.runs]
    assert {run.metrics["reward"] for run in fresh.runs}.isdisjoint(run.metrics["reward"] for run in result.runs)
    again = prepare(tiny.in_split("test", Round(fresh.salt).secret), "rule_based_fair").run()
    assert again.runs == fresh.runs
    assert [one.name for one in fresh.references] == ["rule_based_tuned", "rule_based_unlit"]
    for one in fresh.references:
        assert one.published == prepare(tiny, one.name).run().values("reward")
    assert fresh_actions_path(honest).is_file()
    plain = prepare(tiny, "rule_based_fair").run()
    assert result.results_digest == plain.results_digest, "the fresh draws are beside what must repeat bit for bit"
    assert "fresh_draws" not in plain.to_json()


def test_nothing_but_the_result_stays_behind(honest: Path) -> None:
    place = honest.parents[2] / FOLDER
    assert list((place / "rounds").rglob("*")) == []
    assert list(place.rglob("*.toml")) == []
    names = {file.name for file in (place / "results" / "Tiny-v1").glob("*.json")}
    assert names == {"rule_based_tuned.json", "rule_based_unlit.json"}


def test_it_is_added_to_a_result_that_is_there_and_asked_for_again_it_stays(
    tiny: TaskSpec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = Job(tiny, "rule_based_fair", protect("rule_based_fair", "auto"), Options(tmp_path))
    before = do(job)
    parts: list[Job] = []
    after = add_fresh_draws(job, lambda part: parts.append(part) or do(part))  # type: ignore[func-returns-value]
    assert (after.created, after.runs) == (before.created, before.runs)
    assert [(part.agent_name, bool(part.task.sealed)) for part in parts] == [
        ("rule_based_fair", True), ("rule_based_tuned", False), ("rule_based_tuned", True), ("rule_based_unlit", False),
        ("rule_based_unlit", True),
    ]  # fmt: skip
    assert add_fresh_draws(job, lambda part: pytest.fail("evaluated again")) == after
    evaluation = job.prepare()
    assert evaluation.stored == after


class KilledError(BaseException):
    """Stands for kill -9."""


@pytest.mark.parametrize("moment", ["before the result", "after the result"])
@pytest.mark.parametrize("again", [False, True])
def test_a_kill_while_the_salt_is_published_leaves_no_salt_for_later(
    tiny: TaskSpec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, moment: str, again: bool
) -> None:
    job = Job(tiny, "rule_based_fair", protect("rule_based_fair", "auto"), Options(tmp_path))
    do(job)
    salts = []

    def killed(result: Result, out: Path) -> None:
        assert result.fresh_draws is not None
        salts.append(result.fresh_draws.salt)
        if moment == "after the result":
            save_result(result, out)
        raise KilledError

    with monkeypatch.context() as patch:
        patch.setattr(fresh_draws, "save_result", killed)
        with pytest.raises(KilledError):
            add_fresh_draws(job, do)
    if again:
        dataclasses.replace(job, options=dataclasses.replace(job.options, fresh=True)).prepare().run()
    result = add_fresh_draws(job, do)
    assert result.fresh_draws is not None
    assert (result.fresh_draws.salt in salts) == (moment == "after the result" and not again)
    assert list((tmp_path / FOLDER).rglob("*.toml")) == []


@pytest.mark.parametrize("again", [False, True])
def test_a_published_salt_that_lies_there_is_not_used(tiny: TaskSpec, honest: Path, again: bool) -> None:
    published = load_result(honest).fresh_draws
    assert published is not None
    out = honest.parents[2]
    file = out / FOLDER / tiny.short_id / "rule_based_fair.toml"
    write_round(Round(published.salt), file)
    folder = results_folder(out / FOLDER, tiny.in_split("test", Round(published.salt).secret))
    folder.mkdir(parents=True)
    job = Job(tiny, "rule_based_fair", protect("rule_based_fair", "auto"), Options(out))
    if again:
        dataclasses.replace(job, options=dataclasses.replace(job.options, fresh=True)).prepare().run()
    result = add_fresh_draws(job, do)
    assert result.fresh_draws is not None
    assert (result.fresh_draws.salt == published.salt) == (not again)
    assert not file.exists()
    assert folder.exists() == again


def test_what_was_interrupted_continues_with_the_same_salt(tiny: TaskSpec, tmp_path: Path) -> None:
    job = Job(tiny, "rule_based_fair", protect("rule_based_fair", "auto"), Options(tmp_path))
    do(job)

    def stop_at_the_references(part: Job) -> Result:
        if part.agent_name != job.agent_name:
            raise KeyboardInterrupt
        return do(part)

    with pytest.raises(KeyboardInterrupt):
        add_fresh_draws(job, stop_at_the_references)
    file = tmp_path / FOLDER / "Tiny-v1" / "rule_based_fair.toml"
    salt = read_round(file).salt
    assert file.stat().st_mode & 0o077 == 0
    parts: list[str] = []
    result = add_fresh_draws(job, lambda part: do(part) if part.prepare().stored is None else stored(part, parts))
    assert parts == ["rule_based_fair"], "what was done is not done again"
    assert result.fresh_draws is not None
    assert result.fresh_draws.salt == salt


def stored(part: Job, parts: list[str]) -> Result:
    parts.append(part.agent_name)
    result = part.prepare().stored
    assert result is not None
    return result


def test_every_evaluation_has_a_salt_of_its_own(tiny: TaskSpec, tmp_path: Path) -> None:
    salts = set()
    for out in ("one", "two"):
        fresh = load_result(with_fresh_draws(tiny, "rule_based_tuned", tmp_path / out)).fresh_draws
        assert fresh is not None
        assert [one.name for one in fresh.references] == ["rule_based_unlit", "rule_based_fair"], "not itself"
        salts.add(fresh.salt)
    assert len(salts) == 2


def test_without_a_result_there_is_nothing_to_add_to(tiny: TaskSpec, tmp_path: Path) -> None:
    job = Job(tiny, "rule_based_fair", protect("rule_based_fair", "auto"), Options(tmp_path))
    with pytest.raises(ResultError, match="Evaluate it first"):
        add_fresh_draws(job, do)


# What is refused


def test_in_the_suite_paper_there_are_no_fresh_draws(glbench: Command, tmp_path: Path) -> None:
    answer = glbench("evaluate", "rule_based", "--suite", "paper", "--fresh-draws", "--out", tmp_path)
    assert answer.code == 1
    assert "may know them by heart" in " ".join(answer.err.split())
    assert list(tmp_path.iterdir()) == [], "it is refused before anything is evaluated"


def test_validation_rounds_and_agents_without_a_sandbox_are_refused(tiny: TaskSpec, tmp_path: Path, write_agent: AgentWriter) -> None:
    rules, mine = protect("rule_based_fair", "auto"), protect(write_agent(), "none")
    for task in (tiny.in_split("test"), tiny):
        check_fresh_draws(Job(task, "", rules, Options(tmp_path)))
        with pytest.raises(SandboxError, match="with --sandbox bubblewrap"):
            check_fresh_draws(Job(task, "", mine, Options(tmp_path)))
    with pytest.raises(TaskError, match="a sealed round"):
        check_fresh_draws(Job(tiny.in_split("test", Round.new().secret), "", rules, Options(tmp_path)))
    three = TINY.replace("[splits.test]", "[splits.validation]\nyears = [2008]\nseasons = 6\n\n[splits.test]")
    (tmp_path / "three").mkdir()
    split = tiny_task(tmp_path / "three", three).in_split("validation")
    with pytest.raises(TaskError, match="the validation split"):
        check_fresh_draws(Job(split, "", rules, Options(tmp_path)))


def test_a_salt_where_the_sandbox_shows_what_is_there_is_refused(tmp_path: Path, write_agent: AgentWriter) -> None:
    agent = write_agent()
    submission = identify(agent)
    assert submission is not None
    sandboxed = Protected(load_agent(agent), "bubblewrap", submission)
    with pytest.raises(SandboxError, match="would see"):
        keep_out_of_sight(Path("/usr/lib/reports") / FOLDER / "Tiny-v1" / "mine.toml", [sandboxed])
    keep_out_of_sight(tmp_path / "reports" / FOLDER / "Tiny-v1" / "mine.toml", [sandboxed])


# What the agent is told


LOOKS = """
def reset(self, task, n_runs):
    import json
    self.n = n_runs
    seen = [repr(task), n_runs, sorted(os.environ.items()), sys.argv, sys.orig_argv, os.getcwd(), sorted(os.listdir("/"))]
    for place in ("/proc/self/mountinfo", "/proc/self/status"):
        lines = open(place).read().splitlines()
        seen.append([line.split()[4:6] for line in lines] if "mount" in place else lines[0])
    files = [os.path.join(place, name) for place, _, names in os.walk("/opt") for name in names]
    seen.append(sorted(files))
    print("TOLD " + json.dumps(seen))
def act(self, observations):
    return np.zeros((self.n, 6))
"""


@needs_sandbox
def test_both_evaluations_tell_the_agent_the_same(tiny: TaskSpec, write_agent: AgentWriter) -> None:
    told = []
    agent = write_agent(LOOKS)
    for task in (tiny.scored, tiny.in_split("test", Round.new().secret)):
        assert repr(task_card(task)) == repr(task_card(tiny))
        evaluation = dataclasses.replace(prepare(task, agent, sandbox="bubblewrap"), prints=Prints(2**22))
        result = evaluation.run()
        assert not result.failed, result.failed
        told.append(next(line for line in evaluation.prints.text().splitlines() if line.startswith("TOLD ")))
    assert len(told[0]) > 1000
    assert told[0] == told[1]


# Verification


def test_an_honest_result_is_reproduced_with_its_fresh_draws_and_reference_agents(honest: Path, glbench: Command) -> None:
    verdict = verify(honest)
    assert (verdict.outcome, verdict.exactness, verdict.runs) == ("reproduced", "bits", 12), verdict
    assert {"fresh_draws", "fresh_draws.references"} <= set(verdict.reproduced)
    assert "fresh_draws.salt" in verdict.stated, "whoever evaluates can choose a salt, and plans for it"
    answer = glbench("verify", honest)
    assert answer.code == 0, answer.err
    assert "as many with fresh draws" in answer.out
    assert "the fresh draws, and the scores of the reference agents with both sets of draws" in answer.out
    assert "was secret before" in " ".join(answer.out.split())
    assert was_reproduced(honest)
    fresh_actions_path(honest).unlink()
    verdict = verify(honest)
    assert (verdict.outcome, verdict.cause) == ("unknown", "no_record")
    assert "The runs with fresh draws" in verdict.reason


def better(run: dict[str, Any]) -> None:
    run["metrics"]["reward"] += 0.01


@pytest.mark.parametrize(
    "change",
    [
        lambda fresh: better(fresh["runs"][2]),
        lambda fresh: fresh.update(salt="1" * 64),
        lambda fresh: fresh["references"][0].update(fresh=[value - 1.0 for value in fresh["references"][0]["fresh"]]),
        lambda fresh: fresh["references"].pop(),
    ],
    ids=["a run", "the salt", "a reference", "one reference less"],
)
def test_edited_fresh_draws_are_no_result(honest: Path, change: Callable[[dict[str, Any]], None]) -> None:
    rewrite(honest, change, repair=False)
    with pytest.raises(ResultError, match="fresh_draws: the digest does not match"):
        load_result(honest)
    assert verify(honest).cause == "inconsistent"


@pytest.mark.parametrize(
    ("change", "cause", "words"),
    [
        (lambda fresh: better(fresh["runs"][2]), "metric", "seed 10002"),
        (lambda fresh: fresh.update(salt="1" * 64), "record_of_other_round", "sealed round"),
        (lambda fresh: fresh["references"][1]["fresh"].__setitem__(3, -9.0), "reference", "rule_based_unlit in the run"),
        (lambda fresh: fresh["references"][0]["published"].__setitem__(0, -9.0), "reference", "of the published draws"),
        (lambda fresh: fresh.update(metric="epi"), "fresh_draws", "another metric"),
    ],
    ids=["a run", "the salt", "a reference", "a published reference", "the metric"],
)  # fmt: skip
def test_fresh_draws_edited_with_their_digest_are_refuted(
    honest: Path, change: Callable[[dict[str, Any]], None], cause: str, words: str
) -> None:
    rewrite(honest, change)
    verdict = verify(honest)
    assert (verdict.outcome, verdict.cause) == ("refuted", cause), verdict
    assert words in verdict.reason


def test_reference_agents_of_another_glbench_are_stated_and_not_checked(honest: Path) -> None:
    rewrite(honest, lambda fresh: fresh["references"][0].update(digest="2" * 64))
    verdict = verify(honest)
    assert verdict.outcome == "reproduced"
    assert "fresh_draws.references" in verdict.stated
    assert any("were not evaluated again" in note for note in verdict.notes)


def test_other_runs_or_seeds_are_no_fresh_draws(honest: Path) -> None:
    text = honest.read_text()
    for change, words in (
        (lambda fresh: fresh["runs"].pop(), "does not have|holds 5"),
        (lambda fresh: fresh["runs"][0].update(seed=7), "seeds"),
        (lambda fresh: fresh["references"][0]["fresh"].pop(), "does not have 6 runs"),
        (lambda fresh: fresh.update(metric="nothing"), "do not have the metric"),
    ):
        honest.write_text(text)
        rewrite(honest, change)
        with pytest.raises(ResultError, match=words):
            load_result(honest)


# The mark


@pytest.fixture(scope="session")
def thirty(tmp_path_factory: pytest.TempPathFactory) -> TaskSpec:
    return tiny_task(
        tmp_path_factory.mktemp("thirty"), TINY.replace("runs = 6", f"runs = {RUNS}").replace("seasons = 6", f"seasons = {RUNS}")
    )


@pytest.fixture(scope="session")
def plans(thirty: TaskSpec) -> PlanBook:
    """Plans of all runs of the test, in which everything is known."""
    book: PlanBook | None = None
    for seed in thirty.evaluation.seeds:
        scenario = Scenario.of(thirty.scored, seed)
        plan = plan_season(scenario, np.tile([0.3, 0.1, 0.3, 0.05, 0.0, 0.0], (thirty.steps, 1)), iterations=3)
        one = PlanBook.of(thirty.scored, [seed], plan.actions(), {})
        book = one if book is None else book.merged(one)
    assert book is not None
    return book


@needs_sandbox
def test_an_agent_that_carries_the_published_plans_is_marked_and_without_them_it_is_not(
    thirty: TaskSpec, plans: PlanBook, tmp_path: Path
) -> None:
    thief = write_carrier(tmp_path / "thief", thirty, plans)
    result = load_result(with_fresh_draws(thirty, thief, tmp_path / "reports"))
    score = fresh_score(result)
    assert score is not None
    assert score.marked
    assert score.low is not None
    assert score.low > score.margin
    for spoilt in (1, 3):
        wide = fresh_score(with_spoilt_runs(result, spoilt))
        assert wide is not None
        assert wide.marked, "runs that it spoils on purpose widen the interval of the mean, and hide nothing"

    shutil.copytree(thief, tmp_path / "without")
    carried = dict(np.load(thief / "carried.npz"))
    np.savez(tmp_path / "without" / "carried.npz", first=carried["first"] + 1e3, actions=carried["actions"])
    sensible = fresh_score(load_result(with_fresh_draws(thirty, tmp_path / "without", tmp_path / "reports")))
    assert sensible is not None
    assert not sensible.marked
    assert score.drop > 3 * abs(sensible.drop)

    stored = [StoredResult(path, load_result(path)) for path in sorted((tmp_path / "reports" / "results").rglob("*.json"))]
    (table,) = rank(stored, {})
    page, frame, paper = to_markdown([table], {}), to_frame([table]).set_index("agent"), to_latex(table)
    (row,) = [line for line in page.splitlines() if line.startswith("| ") and "thief" in line]
    assert DROP_MARK in row
    assert f"{result.summary.mean['reward']:.2f}" in row
    assert f"{score.mean:.2f}" in row
    assert not any(DROP_MARK in line for line in page.splitlines() if line.startswith("| ") and "without" in line)
    assert "Fresh draws" in page
    assert FRESH_NOTE in page
    assert f"{DROP_MARK} With fresh draws thief drops by" in page
    assert r"\P" in paper
    assert frame["fresh_draws_marked"].to_dict() == {"thief": True, "without": False}
    rows = {row["agent"]: row for row in json.loads(to_json([table]))["tasks"][0]["rows"]}
    assert {name: row["fresh_draws"]["marked"] for name, row in rows.items()} == {"thief": True, "without": False}
    facts = {one["agent"]: one["fresh_draws"] for one in build_report(stored).data["results"]}
    assert facts["thief"] == {"mean": pytest.approx(score.mean), "marked": True}


@needs_sandbox
def test_the_command_evaluates_both_says_so_and_the_board_shows_both(
    glbench: Command, thirty: TaskSpec, plans: PlanBook, tmp_path: Path
) -> None:
    thief, out = write_carrier(tmp_path / "thief", thirty, plans), tmp_path / "reports"
    command = ("evaluate", thief, "--task", thirty.source, "--fresh-draws", "--episodes", "none", "--out", out)
    answer = glbench(*command)
    assert answer.code == 0, answer.err
    assert "With fresh draws: " in answer.out
    assert "It may know the published draws." in answer.out
    assert "rule_based_tuned with the published draws" in answer.err
    again = glbench(*command, "--json")
    assert json.loads(again.out)["fresh_draws"]["runs"]
    board = glbench("leaderboard", "--task", thirty.source, "--out", out)
    assert DROP_MARK in board.out
    assert "draws" in board.out
    shown = glbench("show", result_path(out, thirty.id, "thief"))
    assert "With fresh draws" in shown.out
    several = glbench("evaluate", "rule_based_fair", "rule_based_tuned", "--task", thirty.source, "--fresh-draws", "--out", out)
    assert several.code == 0, several.err
    assert several.err.count("with fresh draws reward") == 2


def test_a_board_without_fresh_draws_is_as_it_was(public: Path) -> None:
    (table,) = rank([StoredResult(public, load_result(public))], {})
    for text in (to_json([table]), to_markdown([table], {}), to_latex(table), *to_frame([table]).columns):
        assert "fresh_draws" not in text
        assert "Fresh draws" not in text


# The statistic


def test_the_drop_has_the_interval_of_welchs_test() -> None:
    random = np.random.default_rng(3)
    for _ in range(50):
        one, other = random.normal(0.4, 1.0, 12), random.normal(0.0, 2.0, 9)
        drop, low = drop_beside(one, other, 0.05)
        assert drop == pytest.approx(one.mean() - other.mean())
        p = stats.ttest_ind(one, other, equal_var=False, alternative="greater").pvalue
        assert (low > 0.0) == (p < 0.05)
    assert drop_beside(np.ones(4), np.zeros(4)) == (1.0, 1.0)
    assert drop_beside(np.ones(1), np.zeros(1))[1] == -np.inf


@pytest.mark.parametrize("draw", ["normal", "exponential", "years"])
@pytest.mark.parametrize("runs", [10, 30, 100])
def test_an_agent_that_knows_nothing_is_marked_at_most_as_often_as_stated(draw: str, runs: int) -> None:
    """20,000 agents a case that are worth the same with both draws: skewed, or with two years of another level each."""
    random, samples = np.random.default_rng(7), 20_000

    def values() -> np.ndarray:
        if draw == "normal":
            return random.normal(0.0, 1.0, (samples, runs))
        if draw == "exponential":
            return -random.exponential(1.0, (samples, runs))
        return random.normal(0.0, 1.0, (samples, runs)) + 3.0 * random.integers(0, 2, (samples, runs))

    alarms = sum(low > 0.0 for low in (drop_beside(*pair)[1] for pair in zip(values(), values(), strict=True)))
    # The upper 99.9 % point of a binomial with the stated chance: a test with that error passes.
    assert alarms <= stats.binom.ppf(0.999, samples, ERROR)


def with_spoilt_runs(result: Result, number: int) -> Result:
    """``result`` with so many fresh runs that lose 424 EUR/m2, as a run of Spring-v1 that crashes at once."""
    fresh = result.fresh_draws
    assert fresh is not None
    lost = [run.model_copy(update={"metrics": run.metrics | {"reward": -424.0}}) for run in fresh.runs[:number]]
    runs = (*lost, *fresh.runs[number:])
    return result.model_copy(update={"fresh_draws": fresh.model_copy(update={"runs": runs})})


@pytest.mark.parametrize("spoilt", [0, 1, 2, 5, 20])
def test_spoilt_runs_do_not_hide_a_drop(spoilt: int) -> None:
    random = np.random.default_rng(5)
    published, fresh = random.normal(4.3, 0.5, 100), random.normal(0.0, 0.5, 100)
    fresh[:spoilt] = -424.0
    assert shift_by_ranks(published, fresh) > 3.5
    assert (drop_beside(published, fresh)[1] > 0.0) == (spoilt not in (1, 2, 5)), "the mean alone would not tell"
    assert shift_by_ranks(published[:10], fresh[:10]) == -np.inf


@pytest.mark.parametrize("draw", [np.random.Generator.standard_normal, np.random.Generator.standard_cauchy])
def test_the_interval_by_ranks_has_the_error_of_the_test_of_mann_and_whitney(draw: Any) -> None:
    random = np.random.default_rng(9)
    for _ in range(200):
        one, other = draw(random, 30) + 0.4, draw(random, 25)
        p = stats.mannwhitneyu(one, other, alternative="greater", method="asymptotic").pvalue
        assert (shift_by_ranks(one, other, 0.05) > 0.0) == (p < 0.05)


def test_a_drop_that_is_there_is_seen() -> None:
    random = np.random.default_rng(11)
    seen = [drop_beside(random.normal(0.7, 1.0, 100), random.normal(0.0, 1.0, 100))[1] > 0.0 for _ in range(500)]
    assert np.mean(seen) > 0.9


def changed(result: Result, runs: int, drop: float) -> Result:
    """``result`` with ``runs`` of its runs, and so much less with its fresh draws."""
    fresh = result.fresh_draws
    assert fresh is not None
    few: tuple[RunResult, ...] = tuple(
        run.model_copy(update={"metrics": run.metrics | {"reward": run.metrics["reward"] - drop}}) for run in fresh.runs[:runs]
    )
    references = tuple(one.model_copy(update={"published": one.published[:runs], "fresh": one.fresh[:runs]}) for one in fresh.references)
    update = {"fresh_draws": fresh.model_copy(update={"runs": few, "references": references}), "runs": result.runs[:runs]}
    return result.model_copy(update=update | {"summary": summarise(result.runs[:runs])})


def test_few_runs_mark_nobody_and_every_reference_agent_has_to_agree(honest: Path) -> None:
    result = load_result(honest)
    plain = fresh_score(changed(result, 6, 0.0))
    large = fresh_score(changed(result, 6, 100.0))
    assert plain is not None
    assert large is not None
    assert not plain.marked
    assert large.marked
    few = fresh_score(changed(result, FEWEST - 1, 100.0))
    assert few is not None
    assert (few.marked, few.low) == (False, None)
    worse = changed(result, 6, 100.0)
    assert worse.fresh_draws is not None
    first, second = worse.fresh_draws.references
    fell = second.model_copy(update={"fresh": tuple(value - 100.0 for value in second.fresh)})
    fresh = worse.fresh_draws.model_copy(update={"references": (first, fell)})
    beside = fresh_score(worse.model_copy(update={"fresh_draws": fresh}))
    assert beside is not None
    assert not beside.marked, "a sensible agent fell as deep"
    assert beside.reference == second.name


def test_a_training_without_fresh_draws_hides_no_mark(honest: Path) -> None:
    plain, large = (fresh_score(changed(load_result(honest), 6, drop)) for drop in (0.0, 100.0))
    assert plain is not None
    assert large is not None
    assert fresh_score_over([plain, None]) is None
    assert fresh_score_over([plain, large, None]) == large.model_copy(update={"mean": (plain.mean + large.mean) / 2})


def test_runs_that_failed_with_fresh_draws_are_said(honest: Path) -> None:
    result = changed(load_result(honest), 6, 100.0)
    fresh = result.fresh_draws
    assert fresh is not None
    lost = tuple(run.model_copy(update={"status": "crashed", "reason": "the pump broke"}) for run in fresh.runs)
    failing = result.model_copy(update={"fresh_draws": fresh.model_copy(update={"runs": lost})})
    metric = catalogue(get_task("Spring-v1")).score
    assert "6 of its runs with fresh draws failed" in fresh_words(failing, metric)
    assert "It may know the published draws" in fresh_words(result, metric)
    assert "no more than chance explains" in fresh_words(load_result(honest), metric)


def test_reference_agents_are_baselines_that_do_not_know_the_scenario() -> None:
    for name in REFERENCES:
        assert load_agent(name).sees != "scenario"


@pytest.mark.slow
@needs_sandbox
def test_the_published_plans_of_the_default_task_are_caught(tmp_path: Path) -> None:
    from docs.fresh_draws_table import evaluated

    score = fresh_score(evaluated("carries_plans", 25, tmp_path))  # a quarter of the runs is enough
    assert score is not None
    assert score.marked
    assert score.drop > 3.0
