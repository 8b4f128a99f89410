"""docs/submit.md tells the truth: names, numbers and the snippet that runs."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from glbench.evaluation.limits import TimeLimits
from glbench.tasks import TaskCard

ROOT = Path(__file__).parents[2]
GUIDE = (ROOT / "docs" / "submit.md").read_text(encoding="utf-8")


def test_the_guide_names_every_observation_and_its_number(card: TaskCard) -> None:
    assert [name for name in card.observation_names if f"`{name}`" not in GUIDE] == []
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
