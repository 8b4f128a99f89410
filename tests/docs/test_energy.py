"""docs/energy.md: its task, its rules and its figures, as they stand on the page."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

from glbench.model import TOMATO_ENERGY
from tests.energy import PAGE, written


def test_the_rules_give_what_the_page_shows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("energy.toml").write_text(written(), encoding="utf-8")
    ((example,), (shown,)) = (re.findall(rf"```{kind}\n(.*?)```", PAGE, flags=re.DOTALL) for kind in ("python", "text"))
    exec(compile(example, "docs/energy.md", "exec", dont_inherit=True), {})
    assert capsys.readouterr().out == shown


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
