"""docs/energy.md, energy-dispatch.md and heat-harvesting.md: their tasks, rules and figures, as they stand there."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

from glbench.evaluation import evaluate
from glbench.model import TOMATO_ENERGY, TOMATO_HEAT_PUMP
from glbench.model.heat_harvesting import cooler
from tests.cli.command_line import Command
from tests.cli.conftest import glbench
from tests.energy import ENGINE, HARVESTING, PAGE, write_rules, written

__all__ = ["glbench"]

EXAMPLES, TEXTS = (re.findall(rf"```{kind}\n(.*?)```", PAGE, flags=re.DOTALL) for kind in ("python", "text"))
COSTS = TEXTS[1]
SHOWN = [text for text in TEXTS if text != COSTS]


@pytest.mark.parametrize(("example", "shown"), [*zip(EXAMPLES, SHOWN, strict=True)], ids=["engine", "larger buffers", "heat pump"])
def test_the_rules_give_what_the_page_shows(
    example: str, shown: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("energy.toml").write_text(written(), encoding="utf-8")
    Path("heat-pump.toml").write_text(written("mylab/HeatPump-v1"), encoding="utf-8")
    exec(compile(example, "docs/energy.md and its sisters", "exec", dont_inherit=True), {})
    assert capsys.readouterr().out == shown


def test_what_the_rules_cost_is_what_the_page_shows(tmp_path: Path, glbench: Command) -> None:
    task = tmp_path / "energy.toml"
    task.write_text(written(), encoding="utf-8")
    evaluate(task, write_rules(tmp_path, "engine", stores=True, engine=True), out=tmp_path)
    answer = glbench("episodes", "dispatch", tmp_path / "results" / "Energy-v1" / "engine.json")
    printed = [line.rstrip() for line in answer.out.splitlines() if line.strip()]
    shown = [line.rstrip() for line in COSTS.splitlines() if line.strip()]
    assert "mean of 4 runs" in printed[-2]
    assert [*printed[1:-2], printed[-1]] == shown


def test_the_page_has_the_values_of_the_table_and_every_flow() -> None:
    p = TOMATO_ENERGY.parameters.record(*TOMATO_ENERGY.parameters.default().tolist())
    boiler = p.p_boil / p.a_flr
    assert f"fires the boiler: {boiler:g} W m-2" in ENGINE
    engine = f"{p.p_chp_el:g} W m-2 of electricity, and {p.p_chp_el * p.eta_chp_heat / p.eta_chp_el:g} W m-2 of heat"
    assert engine in ENGINE
    assert f"to the rail pipes: {p.p_pipe:g} W m-2" in ENGINE
    assert f"`eBufEdge` is {p.e_buf_edge:g} MJ m-2, {100 * p.e_buf_edge / p.e_buf_max:.1f} % of the buffer" in ENGINE
    assert f"(`etaLampCool`: {p.eta_lamp_cool:g} of their electricity in the benchmark)" in ENGINE
    assert f"flue = {p.co2_gas:g} * {boiler:.1f} / {p.eta_boil:g}" in ENGINE
    for flow in TOMATO_ENERGY.flows():
        if flow.name not in {"fruit_growth", "fruit_harvested"}:
            assert re.search(rf"^\| .*`{flow.name}`.* \| {re.escape(flow.unit)} \|", ENGINE, flags=re.MULTILINE), flow.name


def test_the_page_on_heat_harvesting_has_the_values_of_the_table_and_every_flow() -> None:
    p = TOMATO_HEAT_PUMP.parameters.record(*TOMATO_HEAT_PUMP.parameters.default().tolist())
    power = p.cop_mech * p.p_mech
    pumped = p.cop_heat_pump * p.p_heat_pump
    assert f"up to {power:g} W m-2 from the air, as heat and as vapour, and uses {p.eta_mech * p.p_mech:g} W m-2" in HARVESTING
    taken = f"{p.p_heat_pump:.1f} W m-2 of electricity and {pumped - p.p_heat_pump:.1f} W m-2 from the cold buffer"
    assert f"{taken} become {pumped:.1f} W m-2 in the hot one" in HARVESTING
    assert f"to the rail pipes: {p.p_buf_hot:g} W m-2" in HARVESTING
    assert f"{p.e_buf_cold_max:g} MJ m-2 cold and {p.e_buf_hot_max:g} MJ m-2 hot" in HARVESTING
    assert f"in {1e6 * p.e_buf_cold_max / power / 60:.0f} minutes" in HARVESTING
    assert 1e6 * p.e_buf_hot_max / p.p_buf_hot / 3600 == pytest.approx(1.5, abs=0.06)
    _, sensible, condensed, latent = cooler(20.0, 2000.0, power, p.L, p)
    assert f"\n{sensible:.0f} W m-2 as heat and {latent:.0f} W m-2 as vapour, {3600 * condensed:.2f} litres" in HARVESTING
    for flow in TOMATO_HEAT_PUMP.flows():
        if flow.name not in {"fruit_growth", "fruit_harvested"}:
            assert re.search(rf"^\| .*`{flow.name}`.* \|", HARVESTING, flags=re.MULTILINE), flow.name
    for parameter in ("electricity_cooler", "electricity_heat_pump", "heat_harvested", "heat_delivered"):
        unit = next(flow.unit for flow in TOMATO_HEAT_PUMP.flows() if flow.name == parameter)
        assert f"| `{parameter}` | {unit} |" in HARVESTING


def test_every_table_of_the_page_can_be_read() -> None:
    assert all(tomllib.loads(block) for block in re.findall(r"```toml\n(.*?)```", PAGE, flags=re.DOTALL))
