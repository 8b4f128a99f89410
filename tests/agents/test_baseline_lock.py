"""The shipped baselines are frozen by what they do: their digests, and their actions on recorded inputs (baselines/lock.toml)."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from glbench.agents import baselines, controllers
from glbench.agents.identity import baseline_names
from glbench.agents.rules import FairRuleBasedAgent
from tests.support import baselines_script

ROOT = Path(__file__).resolve().parents[2]


LOCK = baselines_script("lock")
ENTRIES = LOCK.read_lock()


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name in LOCK.PLANNERS else name for name in baseline_names()]
)
def test_a_baseline_does_what_the_lock_says(name: str) -> None:
    assert LOCK.problems_of(name, ENTRIES[name]) == []


def test_the_lock_holds_every_baseline_and_the_digests_of_released_results() -> None:
    assert set(ENTRIES) == set(baseline_names())
    for name in baseline_names():
        for file in (ROOT / "reports" / "released" / "results").glob(f"*/{name}.json"):
            assert json.loads(file.read_bytes())["agent"]["digest"] in LOCK.digests_of(ENTRIES[name]), file
    assert {name.partition("_seed")[0] for name, entry in ENTRIES.items() if "earlier" in entry} <= set(LOCK.GROW)


def test_results_of_a_baseline_that_has_just_grown_are_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """Until the lock is written, its digest is that of the released results, and tables are made in between."""
    today = baselines.shipped_digest("rule_based")
    monkeypatch.setattr(baselines, "shipped_digest", lambda _: today)
    monkeypatch.setattr(baselines, "read_toml", lambda _: {"rule_based": {"digest": "before", "earlier": ["first"]}})
    assert baselines.digests_of_baseline.__wrapped__("rule_based") == (today, "before", "first")


def test_writing_adds_tasks_that_an_entry_lacks_and_keeps_the_others(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    name, other = "rule_based_fair", "Lettuce-v1"
    whole = ENTRIES[name]["actions"]
    rows = [f'"{task}" = {numbers}' for task, numbers in whole.items() if task != other]
    file = tmp_path / "lock.toml"
    file.write_text("\n".join([f"[{name}]", 'digest = "as it was"', f"[{name}.actions]", *rows]), encoding="utf-8")
    monkeypatch.setattr(LOCK, "LOCK", file)
    monkeypatch.setattr(LOCK, "baseline_names", lambda: [name])
    monkeypatch.setattr(sys, "argv", ["lock.py", "--write"])
    assert LOCK.main() == 1, "the digest is another one, and stays"
    entry = LOCK.read_lock()[name]
    assert entry["digest"] == "as it was"
    assert entry["actions"].keys() == whole.keys()
    for task, (value, size) in whole.items():
        assert entry["actions"][task] == pytest.approx([value, size], rel=0.0, abs=0.0 if task != other else LOCK.TOLERANCE * size)


def test_every_controller_is_recorded() -> None:
    cards = {name: baselines._read_card(ROOT / "baselines" / name / "card.toml").controller for name in ENTRIES}
    assert {cards[name] for name, entry in ENTRIES.items() if entry["actions"]} == set(controllers.MODULES)


def test_other_actions_under_the_same_digest_are_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    original = FairRuleBasedAgent.act

    def slightly_off(self: FairRuleBasedAgent, observations: np.ndarray) -> np.ndarray:
        return original(self, observations) * (1.0 - 1e-6)

    monkeypatch.setattr(FairRuleBasedAgent, "act", slightly_off)
    problems = LOCK.problems_of("rule_based_fair", ENTRIES["rule_based_fair"])
    assert problems
    assert all("other actions" in text for text in problems)


def test_another_version_of_a_controller_is_another_agent(monkeypatch: pytest.MonkeyPatch) -> None:
    from dataclasses import replace

    own = controllers.find_controller("rule_based")
    monkeypatch.setitem(controllers.CONTROLLERS, "rule_based", replace(own, version="2"))
    assert any("digest" in text for text in LOCK.problems_of("rule_based", ENTRIES["rule_based"]))
