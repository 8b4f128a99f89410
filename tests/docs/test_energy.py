"""docs/energy.md: its task, its rules and its figures, as they stand on the page."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

from glbench.evaluation import evaluate
from glbench.model import TOMATO_ENERGY
from tests.cli.command_line import Command
from tests.cli.conftest import glbench
from tests.energy import PAGE, write_rules, written

__all__ = ["glbench"]


def test_the_rules_give_what_the_page_shows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("energy.toml").write_text(written(), encoding="utf-8")
    (rules, buffers), (shown, _, costs) = (blocks(kind) for kind in ("python", "text"))
    for example, output in ((rules, shown), (buffers, costs)):
        exec(compile(example, "docs/energy.md", "exec", dont_inherit=True), {})
        assert capsys.readouterr().out == output


def blocks(kind: str) -> list[str]:
    return re.findall(rf"```{kind}\n(.*?)```", PAGE, flags=re.DOTALL)


def test_what_the_rules_cost_is_what_the_page_shows(tmp_path: Path, glbench: Command) -> None:
    task = tmp_path / "energy.toml"
    task.write_text(written(), encoding="utf-8")
    evaluate(task, write_rules(tmp_path, "engine", stores=True, engine=True), out=tmp_path)
    answer = glbench("episodes", "dispatch", tmp_path / "results" / "Energy-v1" / "engine.json")
    printed = [line.rstrip() for line in answer.out.splitlines() if line.strip()]
    shown = [line.rstrip() for line in blocks("text")[1].splitlines() if line.strip()]
    assert "mean of 4 runs" in printed[-2]
    assert [*printed[1:-2], printed[-1]] == shown


def test_the_page_has_the_values_of_the_table_and_every_flow() -> None:
    p = TOMATO_ENERGY.parameters.record(*TOMATO_ENERGY.parameters.default().tolist())
    boiler = p.p_boil / p.a_flr
    assert f"fires the boiler: {boiler:g} W m-2" in PAGE
    engine = f"{p.p_chp_el:g} W m-2 of electricity, and {p.p_chp_el * p.eta_chp_heat / p.eta_chp_el:g} W m-2 of heat"
    assert engine in PAGE
    assert f"to the rail pipes: {p.p_pipe:g} W m-2" in PAGE
    assert f"`eBufEdge` is {p.e_buf_edge:g} MJ m-2, {100 * p.e_buf_edge / p.e_buf_max:.1f} % of the buffer" in PAGE
    assert f"(`etaLampCool`: {p.eta_lamp_cool:g} of their electricity in the benchmark)" in PAGE
    assert f"flue = {p.co2_gas:g} * {boiler:.1f} / {p.eta_boil:g}" in PAGE
    for flow in TOMATO_ENERGY.flows():
        if flow.name not in {"fruit_growth", "fruit_harvested"}:
            assert re.search(rf"^\| .*`{flow.name}`.* \| {re.escape(flow.unit)} \|", PAGE, flags=re.MULTILINE), (
                flow.name
            )


def test_every_table_of_the_page_can_be_read() -> None:
    assert all(tomllib.loads(block) for block in re.findall(r"```toml\n(.*?)```", PAGE, flags=re.DOTALL))
