"""docs/submit.md and docs/scale.md tell the truth: names, numbers, and the snippets that run."""

from __future__ import annotations

import importlib.util
import re
import warnings
from pathlib import Path

import pytest

from glbench.agents import load_agent, read_card
from glbench.agents.loading import KINDS
from glbench.agents.saved_policies import PolicyAgent
from glbench.evaluation.limits import TimeLimits
from glbench.tasks import DEFAULT_TASK, TaskCard, get_task, task_card

ROOT = Path(__file__).parents[2]
GUIDE = (ROOT / "docs" / "submit.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def card() -> TaskCard:
    """Card of the default task, which the guide tells of."""
    return task_card(get_task(DEFAULT_TASK))


def test_the_guide_names_every_observation_and_its_number(card: TaskCard) -> None:
    told = [re.sub(r"_in_\d+h$", "_in_1h", name) for name in card.observation_names]
    assert [name for name in told if f"`{name}`" not in GUIDE] == []
    hours = sorted({int(found[1]) for name in card.observation_names if (found := re.search(r"_in_(\d+)h$", name))})
    assert f"the same for {', '.join(map(str, hours[1:-1]))} and {hours[-1]} h: the forecast" in GUIDE
    papers = [column.name for column in get_task("Schiphol2010-Delta10-v1").observed()]
    assert f"The tasks of the paper show {len(papers)} columns, exactly" in GUIDE
    assert [name for name in papers if f"`{name}`" not in GUIDE] == []
    assert f"(n_runs, {len(card.observations)}) in, (n_runs, {len(card.actions)}) out" in GUIDE


def test_the_guide_names_fields_that_the_card_has(card: TaskCard) -> None:
    section = GUIDE.split("**The task card**")[1].split("Nothing else")[0]
    named = set(re.findall(r"`([a-z_]+)`", section)) - {"task", "make_agent", "reset"}
    assert len(named) >= 10
    assert [name for name in sorted(named) if not hasattr(card, name)] == []


def test_the_guide_states_the_limits_that_hold(card: TaskCard) -> None:
    assert f"longer than {TimeLimits().step:g} s for one decision" in GUIDE
    assert f"`max_change` ({card.max_change:g} of its range)" in GUIDE


def test_the_guides_check_of_actions_runs_and_finds_nothing_wrong_with_the_template(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    snippet = next(code for code in re.findall(r"```python\n(.*?)```", GUIDE, re.DOTALL) if "action_problems" in code)
    monkeypatch.chdir(ROOT)
    exec(compile(snippet, "docs/submit.md", "exec"), {})
    assert capsys.readouterr().out == "{}\n"


@pytest.mark.parametrize("file", ["README.md", "docs/submit.md", *sorted(f"submissions/templates/{kind}" for kind in KINDS)])
def test_whoever_tries_things_out_is_sent_to_the_validation_split(file: str) -> None:
    path = ROOT / file
    for page in [path] if path.is_file() else [*path.glob("*.md"), *path.glob("agent.py")]:
        text = page.read_text(encoding="utf-8")
        trials = re.findall(r"^.*glbench evaluate .*--runs.*$", text, re.MULTILINE)
        assert trials, page
        assert [line for line in trials if "--split validation" not in line] == []
    get_task(DEFAULT_TASK).in_split("validation")


def snippet(guide: str, language: str, word: str) -> str:
    return next(code for code in re.findall(rf"```{language}\n(.*?)```", guide, re.DOTALL) if word in code)


def test_the_guides_card_is_one(tmp_path: Path) -> None:
    (tmp_path / "submission.toml").write_text(snippet(GUIDE, "toml", "authors"), encoding="utf-8")
    assert read_card(tmp_path / "submission.toml").model == "model.zip"


def test_the_guide_names_every_template() -> None:
    assert [kind for kind in KINDS if f"| `{kind}`" not in GUIDE] == []


@pytest.mark.parametrize(
    ("word", "saved", "packages"), [("model.save", "learner", ("stable_baselines3",)), ("torch.jit.script", "policy.pt", ("torch",))]
)
def test_the_guides_ways_to_save_a_policy_make_submissions(
    card: TaskCard, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, word: str, saved: str, packages: tuple[str, ...]
) -> None:
    for package in packages:
        if importlib.util.find_spec(package) is None:
            pytest.skip(f"{package} is not installed")
    monkeypatch.chdir(tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        exec(compile(snippet(GUIDE, "python", word), "docs/submit.md", "exec"), {})
    assert isinstance(load_agent(tmp_path / saved).make(card), PolicyAgent)


@pytest.mark.slow
def test_the_example_of_the_page_on_scale_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    page = (ROOT / "docs" / "scale.md").read_text(encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    exec(compile(snippet(page, "python", "LocalEngine"), "docs/scale.md", "exec"), {})
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == ["rule_based", "rule_based_fair"]
    assert all(float(line.split()[1]) > 1000 for line in lines)
