"""``baselines/compare_pages.py``: every page plays as it would alone, in the same seasons, and wrong numbers are refused."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from glbench.agents.energy_rules import EnergyRuleSettings
from glbench.agents.tuned_rules import read_rule_page
from glbench.errors import SubmissionError
from glbench.tasks import get_task
from tests.support import baselines_script

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "baselines" / "rule_based_energy" / "rules" / "springenergy.yml"


@pytest.fixture(scope="module")
def script() -> ModuleType:
    return baselines_script("compare_pages")


def test_a_change_replaces_the_numbers_that_it_names(script: ModuleType) -> None:
    page = read_rule_page(PAGE, EnergyRuleSettings).numbers
    after = script.changed(page, "co2_bought=0,lamps_fruit=0.1")
    assert after.model_dump() == page.model_dump() | {"co2_bought": 0.0, "lamps_fruit": 0.1}
    for text, said in {
        "co2_bought": "has no value",
        "co2_bought=x": "not a number",
        "co2_bought=2": "co2_bought",
        "co2_bougt=0": "Did you mean 'co2_bought'",
    }.items():
        with pytest.raises(SubmissionError, match=said):
            script.changed(page, text)


def test_pages_side_by_side_earn_what_each_earns_alone(
    script: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    day = tmp_path / "day.toml"
    day.write_text('base = "glbench/SpringEnergy-v1"\nid = "test/Day-v1"\ntitle = "A day"\nweather.days = 1\n', encoding="utf-8")
    task, page = get_task(day).in_split("training"), read_rule_page(PAGE, EnergyRuleSettings).numbers
    pages, seeds = [page, script.changed(page, "heating_day=16,engine_price=0.3")], [30_000_001_000, 30_000_001_001]
    both = script.played(task, pages, seeds, "fast")["reward"]
    np.testing.assert_array_equal(both[1:], script.played(task, pages[1:], seeds, "fast")["reward"])
    assert np.all(both[0] != both[1])
    out = tmp_path / "sums.csv"
    arguments = ["--change", "heating_day=16,engine_price=0.3", "--other", str(PAGE), "--seasons", "2", "--out", str(out)]
    monkeypatch.setattr(sys, "argv", ["compare_pages.py", str(day), str(PAGE), *arguments])
    assert script.main() == 0
    said = capsys.readouterr().out
    assert "training split, seeds 30000001000 to 30000001001" in said
    assert f"+0.00 (+0.00 to +0.00) EUR/m2, in 0 of 2: {PAGE}" in said
    assert len(out.read_text(encoding="utf-8").splitlines()) == 1 + 3 * 2
