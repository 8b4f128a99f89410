"""docs/extending.md: its examples run, one after the other, as they stand on the page."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from glbench.agents.controllers import CONTROLLERS
from glbench.env import Simulation
from glbench.episodes.signals import signals_of
from glbench.leaderboard.catalogue import catalogue, charts_of
from glbench.model import get_model
from glbench.tasks import get_task, task_card

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "extending.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", PAGE, flags=re.DOTALL)


@pytest.mark.usefixtures("own_words")
def test_the_examples_run_and_say_what_the_page_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (whole,) = (block for block in blocks("toml") if "mylab/Basil-v1" in block)
    Path("basil.toml").write_text(whole, encoding="utf-8")
    names: dict[str, object] = {}
    for example in blocks("python"):
        exec(compile(example, "docs/extending.md", "exec", dont_inherit=True), names)
        said = capsys.readouterr().out.splitlines()
        told = re.findall(r"^print\(.*\)  # (.*)$", example, flags=re.MULTILINE)
        exact = [text for text in told if not text.startswith(("g m-2", "EUR", "True:"))]
        assert [line for line in said if line in exact] == exact

    changes = {
        "greenlight-basil-1.0.0": "greenlight-tomato-water-1.0.0",
        "seedlings": "mature_crop",
        '"lue"': '"sla"',
        'stock = "basil"': 'stock = "fruit"\namount = "fruit_dry"\nunit = "kg m-2"\nfactor = 1e-6',
        '"uBlScr"]': '"uBlScr", "uTap"]',
        '"crop",': '"crop", "canopy_excess",',
    }
    tank = whole
    for old, new in changes.items():
        assert old in tank
        tank = tank.replace(old, new)
    (cost,) = (block for block in blocks("toml") if "cost_water" in block)
    Path("tank.toml").write_text(f"{tank}\n{cost}", encoding="utf-8")
    task = get_task("tank.toml")
    watered = Simulation(task, 2)
    watered.reset([1, 2])
    result = watered.step([[0.0] * 6 + [1.0]] * 2)

    assert "cost_water" not in {quantity.name for quantity in get_task("basil.toml").quantities}
    assert result.quantities["cost_water"] == pytest.approx([0.1 * 1e-3 * 900 * 0.002] * 2)
    assert {"energy/water"} <= {curve.path for curve in signals_of(task).curves}
    assert {"Water"} <= {line.title for line in signals_of(task).accounts}
    words = catalogue(task)
    assert (words.metrics["water"].headed, words.metrics["cost_water"].label) == ("Water [kg/m²]", "Water")
    assert charts_of(task).series["water"]["label"] == "Water"
    assert not watered.fused  # a part in Python
    assert "canopy_above_air" in {column.name for column in task.observed()}

    changes |= {"greenlight-basil-1.0.0": "mylab-buffered-1.0.0", '"uBlScr"]': '"uBlScr", "uPipe"]', '"crop",': '"crop",'}
    (heat,) = (block for block in blocks("toml") if "heat_into_tank" in block)
    before, _, after = whole.partition("[ledger.cost_heat]")
    buffered = f"{before}{after[after.index('[reward]') :]}\n{heat}"
    for old, new in changes.items():
        buffered = buffered.replace(old, new)
    Path("buffered.toml").write_text(buffered, encoding="utf-8")
    task = get_task("buffered.toml")
    heated = Simulation(task, 2)
    heated.reset([1, 2])
    tank = task.model_value.state_index("eTank")
    first = heated.x[:, tank].copy()
    result = heated.step([[1.0] + [0.0] * 6] * 2)
    gained = heated.x[:, tank] - first

    assert heated.fused
    assert len(set(first)) == 2
    assert ((first >= 0.75) & (first <= 2.25)).all()
    assert (gained > 0).all()  # the valve to the pipes is shut: all that is bought stays in the tank
    assert result.quantities["heat_bought"] == pytest.approx(gained / 3.6)
    assert result.quantities["cost_heat"] == pytest.approx(0.05 * gained / 3.6)
    assert {one.name: one.quantity for one in task.capacities()}["uPipe"] == "pipe_heat"

    card, heater = task_card(get_task("Spring-v1")), names["heater"]
    heater.reset(card, 2)  # type: ignore[attr-defined]
    actions = heater.act(np.full((2, len(card.observations)), 5.0, np.float32))  # type: ignore[attr-defined]
    assert actions[:, card.action_names.index("uBoil")].tolist() == [1.0, 1.0]
    monkeypatch.delitem(CONTROLLERS, "heater")

    names["register"]()  # type: ignore[operator]  # as an entry point, with BASIL registered already
    assert get_model("greenlight-basil-1.0.0") == names["BASIL"]


def test_every_table_of_the_page_can_be_read() -> None:
    assert all(tomllib.loads(block) for block in blocks("toml"))
