"""The study of factors: its design, the tasks of its cells, verdicts and effects of made-up results, a small study that is continued."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import factors, factors_table
from benchmarks.factors import Cell, Change, Corners, Design, Study, cells_of, choose, in_split_of_evaluations, read_design, run, task_file
from benchmarks.factors_table import Scores, contrast, effects_of, verdicts, write_tables
from glbench.errors import GlbenchError
from glbench.evaluation import load_result
from glbench.kernel import why_not_compiled
from glbench.leaderboard.statistics import estimate_difference
from glbench.tasks import get_task, list_tasks

SHIPPED = read_design(factors.DESIGN)
CELLS = cells_of(SHIPPED)
TASKS = {cell.task: cell for cell in CELLS.values()}
OF_FACTOR = {
    "draw": ("scenario.parameters",),
    "house": ("scenario.parameters",),
    "sensors": ("sensors", "outdoor_sensors", "samples"),
    "forecast": ("observation",),
    "price": ("reward.violation_price", "evaluation.failed_step"),
}
"""What each factor may change of a task."""

SMALL = """
split = "test"
runs = 3
trainings = 2
steps = 400
evaluations = 2
pairs = [["small", "rules"], ["fair", "rules"]]
recipes = { small = "small.yml" }

[bases.day]
task = "DAY"
agent_runs = { fair = 2 }
agents = { rules = "rule_based_tuned", fair = "rule_based_fair" }

[bases.day.factors.price]
title = "price of violations"
centre = "1"
levels."1" = {}
levels."2".task.reward.penalty_scale.air_temperature.value = 7.5

[bases.day.factors.budget]
title = "training steps"
centre = "1"
levels."1" = {}
levels."0.5".steps = 0.5
"""
RECIPE = """
default:
  learner: compiled
  n_envs: 8
  n_steps: 12
  batch_size: 48
  net_arch: [8]
  scenarios: 2
  places: 4
  evaluation: {every: 100, runs: 1, first_seed: 20_000_000_000}
"""


def leaves(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Values by their full names."""
    values: dict[str, Any] = {}
    for key, value in table.items():
        values |= leaves(value, f"{prefix}{key}.") if isinstance(value, Mapping) else {f"{prefix}{key}": value}
    return values


def changed_keys(folder: Path, cell: Cell) -> set[str]:
    """Full names of what the task of a cell has other than its base, but for id and title."""
    base = SHIPPED.bases[cell.base].task
    (folder / "cell.toml").write_text(task_file(SHIPPED, cell), encoding="utf-8")
    one, other = (leaves(task.file.content(task.source)) for task in (get_task(base), get_task(folder / "cell.toml")))
    keys = {key for key in {*one, *other} if one.get(key) != other.get(key)}
    return {key for key in keys if key.partition(".")[0] not in ("id", "title", "description", "suites")}


def test_the_design_has_the_centre_every_level_and_corners_of_resolution_iv() -> None:
    assert (len(CELLS), len(TASKS)) == (38, 34)
    for name, base in SHIPPED.bases.items():
        alone = {(factor, level) for factor, one in base.factors.items() for level in one.levels if level != one.centre}
        assert {f"{name}.centre", *(f"{name}.{factor}-{level}" for factor, level in alone)} <= {*CELLS}
    corners = SHIPPED.bases["spring"].corners
    signs = np.array([list(row.values()) for row in corners.signs()])
    assert signs.shape == (16, 6)
    np.testing.assert_array_equal(signs.T @ signs, 16 * np.eye(6))
    for one in range(6):
        for first in range(6):
            for second in range(first):
                assert one in (first, second) or signs[:, one] @ (signs[:, first] * signs[:, second]) == 0


@pytest.mark.parametrize("key", [key for key, cell in CELLS.items() if cell.signs is None])
def test_a_cell_differs_from_its_base_in_its_factor_alone(tmp_path: Path, key: str) -> None:
    cell = CELLS[key]
    factor = cell.name.partition("-")[0]
    keys = changed_keys(tmp_path, cell)
    assert all(name.startswith(OF_FACTOR.get(factor, ())) for name in keys)
    assert bool(keys) == (factor in OF_FACTOR)


def test_groups_keep_what_a_level_does_not_change(tmp_path: Path) -> None:
    """Their names are those of their streams, so that a run has the same draws in all cells."""
    base = get_task("Spring-v1")
    (tmp_path / "corner.toml").write_text(task_file(SHIPPED, CELLS["spring.corner-110001"]), encoding="utf-8")
    task = get_task(tmp_path / "corner.toml")
    assert (task.scenario.family, task.id) == (base.scenario.family, "factors/spring.corner-11000-v1")
    assert [(one.name, one.redraw, one.half_width) for one in task.scenario.groups] == [
        ("crop", "step", 0.10), ("leaf", "step", 0.10), ("house", "step", 0.40),
    ]  # fmt: skip
    assert [one.parameters for one in task.scenario.groups] == [one.parameters for one in base.scenario.groups]
    assert "weather_forecast" not in task.observation.modules


def test_trainings_see_the_training_split_and_evaluations_that_of_the_design(tmp_path: Path) -> None:
    (task,) = Study(SHIPPED, factors.DESIGN, tmp_path).tasks([CELLS["spring.sensors-true"]]).values()
    splits = [in_split_of_evaluations(task, split).split for split in ("test", "validation")]
    assert [task.split, *splits] == ["training", "test", "validation"]
    settings = Study(SHIPPED, factors.DESIGN, tmp_path).settings(CELLS["spring.budget-0.1"], "ppo")
    assert (settings.n_timesteps, settings.evaluation.every, settings.accrual is None) == (500_000, 50_000, False)


def test_no_cell_has_a_published_id() -> None:
    texts = [task_file(SHIPPED, cell) for cell in TASKS.values()]
    ids = {line for text in texts for line in text.splitlines() if line.startswith("id = ")}
    assert len(ids) == len(TASKS)
    assert not ids & {f'id = "{task.id}"' for task in list_tasks()}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"pairs": [["ppo", "rulez"]]}, "has no agent 'rulez', which is compared. Did you mean 'rules'?"),
        ({"split": "training"}, "split"),
        ({"runs": 1}, "runs"),
    ],
)
def test_a_design_with_mistakes_is_refused(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(GlbenchError, match=words.replace("?", r"\?")):
        read_design(factors.DESIGN, changes)


def test_two_factors_may_not_change_the_same_key() -> None:
    content = SHIPPED.model_dump()
    content["bases"]["spring"]["factors"]["sensors"]["levels"]["true"]["task"] = {"observation": {"forecast": {"error": "low"}}}
    content["bases"]["spring"]["corners"]["levels"] |= {"sensors": ("erring", "true"), "forecast": ("erring", "perfect")}
    design = Design.model_validate(content)
    with pytest.raises(GlbenchError, match="Two factors change 'error'"):
        task_file(design, cells_of(design)["spring.corner-001110"])


def test_cells_are_chosen_by_names_and_patterns() -> None:
    assert [cell.key for cell in choose(CELLS, "spring.draw-step, real.house-*")] == ["spring.draw-step", "real.house-0.5", "real.house-1"]
    assert len(choose(CELLS, None)) == len(CELLS)
    with pytest.raises(GlbenchError, match=r"no cell 'spring.draw-stp'. Did you mean 'spring.draw-step'"):
        choose(CELLS, "spring.centre,spring.draw-stp")
    with pytest.raises(GlbenchError, match="no cell ''"):  # an unset variable of the shell is not the whole design
        choose(CELLS, "")


def test_verdicts_are_on_the_sign_of_the_centre() -> None:
    noise = np.random.default_rng(3).normal(0.0, 0.2, 40)
    rules = np.zeros(40)

    def lead(of: float) -> Any:
        return estimate_difference([of + noise], [rules])

    others = {"same": lead(0.8), "other sign": lead(-0.8), "open": lead(0.01)}
    assert verdicts(lead(1.0), others) == {"same": "survives", "other sign": "turns", "open": "not resolved"}
    assert verdicts(lead(-1.0), others) == {"same": "turns", "other sign": "survives", "open": "not resolved"}
    assert verdicts(lead(0.001), others) == {}


def test_an_effect_is_what_was_put_in() -> None:
    """Seasons that differ much cancel, because all cells have the same; trainings that differ widen the interval."""
    random = np.random.default_rng(5)
    seasons = random.normal(0.0, 5.0, 30)

    def of_cell(mean: float, between: float) -> dict[str, Scores]:
        trainings = mean + between * random.normal(0.0, 1.0, (4, 1)) + random.normal(0.0, 0.05, (4, 30))
        return {"ppo": Scores(seasons + trainings, (0, 1, 2)), "rules": Scores((seasons + random.normal(0.0, 0.05, 30))[None])}

    for between, widest in ((0.0, 0.1), (0.5, 3.0)):
        one = contrast([of_cell(2.0, between)], [of_cell(1.0, between)], ("ppo", "rules"))
        assert one is not None
        assert one[1].low < 1.0 < one[1].high
        assert one[1].high - one[1].low < widest
    assert contrast([of_cell(2.0, 0.0)], [{}], ("ppo", "rules")) is None
    alone = contrast([of_cell(2.0, 0.0)], [of_cell(1.0, 0.0)], ("ppo",))
    assert alone is not None
    assert alone[1].value == pytest.approx(1.0, abs=0.05)


def test_trainings_are_paired_by_their_seeds() -> None:
    all_three, two = np.array([[0.0], [10.0], [20.0]]) + np.arange(4.0), np.array([[10.0], [20.0]]) + np.arange(4.0)
    rules = Scores(np.arange(4.0)[None])
    centre, other = {"ppo": Scores(all_three, (0, 1, 2)), "rules": rules}, {"ppo": Scores(two, (1, 2)), "rules": rules}
    for kinds in (("ppo",), ("ppo", "rules")):
        effect = contrast([other], [centre], kinds)
        assert effect is not None
        assert effect[1].value == 0.0  # the training with seed 0 is missing, and nothing else differs
    assert contrast([{"ppo": Scores(two[:1], (3,))}], [centre], ("ppo",)) is None


def test_corners_separate_main_effects_from_one_another_and_from_those_of_two_factors() -> None:
    base = SHIPPED.bases["spring"]
    cells = {key: cell for key, cell in CELLS.items() if cell.base == "spring"}
    size = {"draw": 0.5, "house": -0.2, "budget": 1.0}
    rules = Scores(np.zeros((1, 10)))
    effects = {one.words: one for one in effects_of("spring", base, cells)}

    def scores(cell: Cell) -> dict[str, Scores]:
        signs = cell.signs or {}
        value = sum(size.get(name, 0.0) * sign / 2.0 for name, sign in signs.items()) + 0.3 * signs["draw"] * signs["sensors"] / 2.0
        return {"ppo": Scores(np.full((1, 10), value) + np.arange(10), (0,)), "rules": rules}

    def of(words: str) -> float:
        one = effects[words]
        estimate = contrast([scores(CELLS[key]) for key in one.high], [scores(CELLS[key]) for key in one.low], ("ppo", "rules"))
        assert estimate is not None
        return estimate[1].value

    for name, levels in base.corners.levels.items():
        assert of(f"{name}: {levels[0]} to {levels[1]}, in the corners") == pytest.approx(size.get(name, 0.0))
    assert of("draw × sensors or house × price") == pytest.approx(0.3)
    assert effects["budget: 0.1 to 1, in the corners"].of_trainings
    assert len([words for words in effects if "×" in words]) == 7


@pytest.fixture
def small(tmp_path: Path, day_file: Path) -> Path:
    (tmp_path / "small.yml").write_text(RECIPE, encoding="utf-8")
    (tmp_path / "small.toml").write_text(SMALL.replace("DAY", day_file.as_posix()), encoding="utf-8")
    return tmp_path


def study(folder: Path, **changes: Any) -> Study:
    return Study(read_design(folder / "small.toml", changes), folder / "small.toml", folder / "work")


def test_what_cannot_be_is_refused_before_anything_is_computed(small: Path, capfd: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("jax", reason="JAX is not installed (extra 'jax')")
    command = ["run", "--design", str(small / "small.toml"), "--work", str(small / "work")]
    assert factors.main([*command, "--cells", "day.centr"]) == 1
    assert "There is no cell 'day.centr'. Did you mean 'day.centre'" in capfd.readouterr().err
    assert factors.main([*command, "--split", "validation"]) == 1  # a task without splits
    (small / "small.yml").unlink()
    assert factors.main(command) == 1
    assert "The recipe 'small' is missing" in capfd.readouterr().err
    assert factors.main(["run", "--work", str(small / "none"), "--workers", "0"]) == 1
    assert "--workers is 0: it must be at least 1" in capfd.readouterr().err
    assert factors.main(["table", "--work", str(small / "nothing")]) == 1
    assert "There is no study in" in capfd.readouterr().err
    assert not (small / "work" / "trainings").exists()


def assert_tables_are_added(small: Path) -> None:
    """Cells that another folder played count as one's own, unless another design or version of glbench played them."""
    other, played = small / "other", small / "work" / "factors.json"
    other.mkdir()
    shutil.copy(small / "work" / "design.json", other)
    assert factors.main(["table", "--work", str(other), "--add", str(played)]) == 0
    assert (other / "factors.json").read_text(encoding="utf-8") == played.read_text(encoding="utf-8")
    figures = json.loads(played.read_text(encoding="utf-8"))
    (other / "older.json").write_text(json.dumps(figures | {"glbench": "0.0.9"}), encoding="utf-8")
    with pytest.raises(GlbenchError, match=r"other glbench \(0\.0\.9, here "):
        write_tables(other, [other / "older.json"])
    (other / "longer.json").write_text(json.dumps(figures | {"design": figures["design"] | {"steps": 500}}), encoding="utf-8")
    with pytest.raises(GlbenchError, match="it has other steps"):
        write_tables(other, [other / "longer.json"])
    with pytest.raises(GlbenchError, match=r"There is no .*nothing\.json"):
        write_tables(other, [other / "nothing.json"])


@pytest.mark.slow
@pytest.mark.train
@pytest.mark.skipif(why_not_compiled() is not None, reason=str(why_not_compiled()))
def test_a_small_study_is_carried_out_continued_and_tabulated(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("jax", reason="JAX is not installed (extra 'jax')")
    one = study(small)
    cells = cells_of(one.design)
    assert [*cells] == ["day.centre", "day.price-2", "day.budget-0.5"]
    assert run(one, [cells["day.centre"]], 1) == 0
    first = load_result(small / "work" / "results" / "day.centre-v1" / "small-400-seed1.json")
    capsys.readouterr()
    assert run(one, [*cells.values()], 2) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].endswith("6 trainings, 10 evaluations")
    assert len([line for line in lines if "was trained" in line or "was evaluated" in line]) == 2 + 4
    assert lines[-1].partition("  ")[2].startswith("16/16")
    assert load_result(small / "work" / "results" / "day.centre-v1" / "small-400-seed1.json").created == first.created

    page = write_tables(small / "work")
    figures = json.loads((small / "work" / "factors.json").read_text(encoding="utf-8"))["bases"]["day"]
    assert [*figures["cells"]] == [*cells]
    assert figures["cells"]["day.budget-0.5"]["agents"]["small"]["trainings"] == 2
    assert np.shape(figures["cells"]["day.budget-0.5"]["agents"]["small"]["values"]) == (2, 3)
    assert figures["cells"]["day.centre"]["agents"]["small"]["values"][1] == list(first.values("reward"))
    pair = figures["cells"]["day.centre"]["pairs"]["fair - rules"]
    folders = [small / "work" / place / "day.centre-v1" for place in ("results", "trials/results")]
    rules, fair = (
        load_result(folder / f"rule_based_{name}.json").values("reward") for folder, name in zip(folders, ("tuned", "fair"), strict=True)
    )
    assert (pair["runs"], len(fair), len(rules)) == (2, 2, 3)  # fewer runs than those of the task are kept elsewhere
    assert pair["value"] == pytest.approx(np.mean(fair) - np.mean(rules[:2]))
    assert "fair - rules" not in figures["cells"]["day.budget-0.5"]["pairs"]  # the same agents on the same task as in the centre
    assert {effect["effect"] for effect in figures["effects"]} == {"price: 1 to 2, from the centre", "budget: 1 to 0.5, from the centre"}
    assert "| day.price-2 |" in page
    assert page == (small / "work" / "factors.md").read_text(encoding="utf-8")
    assert_tables_are_added(small)

    rules = load_result(small / "work" / "results" / "day.centre-v1" / "rule_based_tuned.json")
    assert factors._holds(rules, in_split_of_evaluations(one.tasks(cells.values())["day.centre"], "test"), rules.agent.digest, 3)
    assert not factors._holds(rules, in_split_of_evaluations(one.tasks(cells.values())["day.centre"], "test"), "0" * 64, 3)

    assert run(study(small, runs=2), [cells["day.centre"]], 1) == 0  # fewer runs do not replace more
    assert len(load_result(small / "work" / "results" / "day.centre-v1" / "rule_based_tuned.json").runs) == 3
    with pytest.raises(GlbenchError, match="holds a study with steps = 400"):
        run(study(small, steps=500), [cells["day.centre"]], 1)


def test_a_budget_is_a_factor_of_trainings_alone() -> None:
    budgets = {name: [factor for factor, one in base.factors.items() if one.is_budget] for name, base in SHIPPED.bases.items()}
    assert budgets == {"spring": ["budget"], "real": ["budget"]}
    assert Corners(levels={}).signs() == [{}]
    assert Change().steps == 1.0
    assert factors_table.VERDICTS == ("survives", "turns", "not resolved")
