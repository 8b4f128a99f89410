"""The information ladder from made-up results whose answers are known."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import stdtrit

from docs.ladder_table import LARGEST, kept, section
from glbench.leaderboard.ladder import (
    Ladder,
    Rung,
    rows_of,
    separation_of,
    share_of,
    table_cells,
    table_notes,
    verdict_lines,
    verdict_words,
    verdicts_of,
)
from glbench.leaderboard.statistics import estimate_difference

RUNS = 30
NOISE = np.random.default_rng(7).normal(size=(8, RUNS))
SEASON = NOISE[0]  # what all agents share in a run


def rung(name: str, mean: float, *, kind: str = "other", trainings: int = 0, scatter: float = 0.0, noise: float = 0.1) -> Rung:
    """An agent with a mean of exactly ``mean`` over ``trainings`` that are ``scatter`` apart, with noise of its own in each run."""
    own = NOISE[1 + sum(map(ord, name)) % 7]
    base = mean + SEASON - SEASON.mean() + noise * (own - own.mean())
    offsets = scatter * (np.arange(max(trainings, 1)) - (max(trainings, 1) - 1) / 2.0)
    values = [(base + offset).tolist() for offset in offsets]
    return Rung.model_validate({"name": name, "kind": kind, "columns": None, "seeds": range(trainings), "values": values})


UNLIT, RULES = rung("rule_based_unlit", -1.0), rung("rule_based_tuned", 2.0)
ZERO_AND_RULES = ("rule_based_unlit", "rule_based_tuned")


def ladder_of(rungs: list[Rung], zero: str, rules: str) -> Ladder:
    """A ladder of these rungs."""
    return Ladder(
        task="test/T-v1", task_digest="0", split="validation", seeds=tuple(range(RUNS)), metric="reward", unit="EUR m-2", digits=2,
        steps=10, observed=50, zero=zero, rules=rules, rungs=tuple(rungs), rows=rows_of(rungs, zero),
        verdicts=verdicts_of(rungs, rules, zero), separation=separation_of(rungs, rules),
    )  # fmt: skip


def fieller(lead: NDArray[np.float64], whole: NDArray[np.float64]) -> tuple[float, float]:
    """Both roots of the quadratic of Fieller (1954) for pairs."""
    n, t = len(lead), float(stdtrit(len(lead) - 1.0, 0.975))
    (v11, v12), (_, v22) = np.cov(lead, whole) / n
    a, b, c = whole.mean() ** 2 - t**2 * v22, lead.mean() * whole.mean() - t**2 * v12, lead.mean() ** 2 - t**2 * v11
    root = np.sqrt(b**2 - a * c)
    return (b - root) / a, (b + root) / a


def test_the_interval_of_a_share_is_that_of_fieller() -> None:
    strongest, blind = rung("mpc", 3.0, kind="mpc", noise=1.0), rung("mpc_blind", 0.6, kind="mpc", noise=0.8)
    share = share_of(blind, strongest, UNLIT)
    assert share is not None
    assert share.value == pytest.approx(0.4)
    zero = UNLIT.matrix[0]
    assert (share.low, share.high) == pytest.approx(fieller(blind.matrix[0] - zero, strongest.matrix[0] - zero), abs=1e-7)
    assert share.words == f"0.40 ({share.low:.2f} to {share.high:.2f})"


def test_trainings_that_scatter_widen_a_share_and_more_of_them_narrow_it() -> None:
    widths = []
    for trainings, scatter in ((3, 0.0), (3, 0.5), (10, 0.15)):
        pair = [rung(name, mean, kind="ppo", trainings=trainings, scatter=scatter) for name, mean in (("sensors", 3.0), ("blind", 0.6))]
        share = share_of(pair[1], pair[0], UNLIT)
        assert share is not None
        assert share.low is not None
        assert share.high is not None
        widths.append(share.high - share.low)
    assert widths[0] < widths[2] < widths[1]


def test_a_lead_that_may_be_none_has_no_share_or_one_without_end() -> None:
    assert share_of(UNLIT, rung("mpc", -2.0, kind="mpc"), UNLIT) is None
    share = share_of(rung("blind", -0.9, kind="ppo", trainings=2), rung("sensors", -0.8, kind="ppo", trainings=2, scatter=2.0), UNLIT)
    assert share is not None
    assert None in (share.low, share.high)
    assert "unbounded" in share.words


@pytest.mark.parametrize(
    ("blind", "scatter", "half", "below"),
    [(0.0, 0.02, "yes", "yes"), (2.8, 0.02, "no", "no"), (1.5, 0.02, "no", "yes"), (0.9, 1.2, "not resolved", "not resolved")],
)
def test_the_verdict_is_yes_no_or_not_resolved(blind: float, scatter: float, half: str, below: str) -> None:
    rungs = [
        rung("clock", -3.0, kind="ppo", trainings=3, scatter=scatter),
        rung("outdoor", blind, kind="ppo", trainings=3, scatter=scatter),
        rung("sensors", 3.0, kind="ppo", trainings=3, scatter=scatter),
        rung("memory", 2.9, kind="ppo", trainings=3, scatter=scatter),
        UNLIT,
        RULES,
    ]
    (verdict,) = verdicts_of(rungs, "rule_based_tuned", "rule_based_unlit")
    assert (verdict.kind, verdict.blind, verdict.strongest) == ("ppo", "outdoor", "sensors")
    assert (verdict.at_most_half, verdict.below_rules) == (half, below)
    assert verdict.share is not None
    assert verdict.gap is not None
    assert verdict.share.value == pytest.approx((blind + 1.0) / 4.0)
    assert verdict.gap.value == pytest.approx(2.0 - blind)


def test_there_is_no_verdict_without_a_blind_agent_and_no_gap_without_rules() -> None:
    rungs = [rung("sensors", 3.0, kind="ppo", trainings=2), rung("mpc", 3.0, kind="mpc"), rung("mpc_blind", 0.0, kind="mpc"), UNLIT]
    (verdict,) = verdicts_of(rungs, "rule_based_tuned", "rule_based_unlit")
    assert verdict.kind == "mpc"
    assert verdict.gap is None
    assert verdict.below_rules == "not resolved"


def test_the_table_says_what_is_not_resolved() -> None:
    rungs = [
        rung("outdoor", 0.0, kind="ppo", trainings=3, scatter=0.1).model_copy(update={"columns": 43}),
        rung("sensors", 3.0, kind="ppo", trainings=3, scatter=0.1),
        rung("memory", 3.01, kind="ppo", trainings=3, scatter=0.1),
        rung("without_co2", 2.0, kind="ppo", trainings=3, scatter=0.1),
        rung("mpc", 4.0, kind="mpc"),
        UNLIT,
        RULES,
    ]
    ladder = ladder_of(rungs, *ZERO_AND_RULES)
    rows = ladder.rows
    assert [row.before for row in rows] == [None, "outdoor", "sensors", "sensors", None, None, None], "the nearest rung that is there"
    headings, *table = table_cells(ladder)
    cells = {row[0]: dict(zip(headings, row, strict=True)) for row in table}
    assert cells["outdoor"]["Columns"] == "43 of 50"
    assert cells["outdoor"]["Share"].startswith("0.25 (")
    assert cells["sensors"]["Step [EUR/m²]"].startswith("3.00 (")
    assert cells["sensors"]["Step [EUR/m²]"].endswith(") from outdoor")
    step = rows[2].step
    assert step is not None
    assert cells["memory"]["Step [EUR/m²]"] == f"not resolved (below {max(-step.low, step.high):.2f}) from sensors"
    assert cells["memory"]["Share"] == "–", "the strongest itself"
    assert cells["without_co2"]["Step [EUR/m²]"].startswith("-1.00 (")
    assert cells["mpc"]["Share"] == "–", "the only one of its kind"
    assert cells["rule_based_unlit"]["Lead [EUR/m²]"] == "–"
    assert cells["rule_based_tuned"]["Lead [EUR/m²]"].startswith("3.00 (")
    words = verdict_words(ladder.verdicts[0], ladder)
    assert words.startswith("ppo: outdoor keeps 0.25 (")
    assert "of the lead of memory; at most half: yes. rule_based_tuned earns 2.00 (" in words
    assert words.endswith("EUR/m² more than outdoor; blind below rules: yes.")
    assert Ladder.model_validate_json(ladder.model_dump_json(by_alias=True)) == ladder


def test_kinds_separate_when_the_strongest_and_the_weakest_are_resolved_apart() -> None:
    rungs = [
        rung("blind", 3.5, kind="ppo", trainings=3, scatter=0.05),
        rung("memory", 3.0, kind="ppo", trainings=3, scatter=0.05),
        rung("sensors", 2.9, kind="ppo", trainings=3, scatter=0.05),
        rung("mpc_blind", 5.0, kind="mpc"),
        rung("mpc", 3.01, kind="mpc"),
        UNLIT,
        rung("my_agent", 9.0),
        RULES,
    ]
    ladder = ladder_of(rungs, *ZERO_AND_RULES)
    apart = ladder.separation
    assert apart is not None
    assert [(pair.first, pair.second, pair.resolved) for pair in apart.pairs] == [
        ("mpc", "memory", False),
        ("memory", "rule_based_tuned", True),
        ("mpc", "rule_based_tuned", True),
    ], "blind agents, the zero and agents of no kind do not count"
    assert apart.separate == "yes"
    difference = apart.pairs[0].difference
    assert difference.value == pytest.approx(0.01)
    *_, close, first, second, last = verdict_lines(ladder)
    assert close.startswith("mpc earns 0.01 (")
    assert close.endswith(f") EUR/m² more than memory: not resolved (below {difference.high:.2f} EUR/m²).")
    assert first.startswith("memory earns 1.00 (")
    assert second.startswith("mpc earns 1.01 (")
    assert second.endswith(") EUR/m² more than rule_based_tuned: resolved.")
    assert last == "Agents of different kind separate (mpc from rule_based_tuned): yes."
    assert not [line for line in verdict_lines(ladder.model_copy(update={"unit": ""})) if "  " in line], "a metric without a unit"


def test_pairs_of_kinds_are_paired_by_scenario_and_draw_over_trainings() -> None:
    pair = [rung("sensors", 2.4, kind="ppo", trainings=4, scatter=1.0, noise=0.5), rung("rule_based_tuned", 2.0, noise=0.5)]
    apart = separation_of(pair, "rule_based_tuned")
    assert apart is not None
    expected = estimate_difference([pair[0].matrix], [pair[1].matrix], fixed=(False, True)).interval()
    assert apart.pairs[0].difference == expected
    assert apart.separate == "not resolved", "trainings scatter by more than the rules are behind"
    alike = [rung("sensors", 2.1, kind="ppo", trainings=2, noise=0.05), rung("rule_based_tuned", 2.0, noise=0.05)]
    season = separation_of(alike, "rule_based_tuned")
    assert season is not None
    assert season.separate == "yes", "the seasons, whose scatter is ten times the difference, are the same for both"


def test_kinds_are_not_compared_where_there_is_one() -> None:
    rungs = [rung("sensors", 3.0, kind="ppo", trainings=2), rung("mpc_blind", 0.0, kind="mpc"), UNLIT]
    ladder = ladder_of(rungs, *ZERO_AND_RULES)
    assert ladder.separation is None
    assert verdict_lines(ladder) == []


def test_an_agent_with_fewer_runs_is_compared_in_those_that_it_has() -> None:
    few = rung("mpc", 3.0, kind="mpc")
    few = few.model_copy(update={"values": tuple(values[:5] for values in few.values)})
    blind = rung("mpc_blind", 1.0, kind="mpc")
    blind = blind.model_copy(update={"values": tuple(values[:5] for values in blind.values)})
    ladder = ladder_of([few, blind, rung("sensors", 2.6, kind="ppo", trainings=2), UNLIT, RULES], *ZERO_AND_RULES)
    lead = ladder.rows[0].lead
    assert lead is not None
    assert lead == estimate_difference([few.matrix], [UNLIT.matrix[:, :5]], fixed=(True, True)).interval()
    share = ladder.verdicts[-1].share
    assert share is not None
    nothing = UNLIT.matrix[0, :5].mean()
    assert share.value == pytest.approx((blind.matrix.mean() - nothing) / (few.matrix.mean() - nothing))
    assert "mpc played the first 5 runs only, and others are compared with it in those runs." in table_notes(ladder)
    assert ladder.separation is not None
    assert [(pair.first, pair.second) for pair in ladder.separation.pairs][-1] == ("mpc", "rule_based_tuned")


def test_a_pair_is_in_the_order_of_the_runs_that_both_have() -> None:
    good_start = [(9.0,) * 3 + (0.0,) * (RUNS - 3)]
    early = rung("sensors", 1.0, kind="ppo").model_copy(update={"values": tuple(good_start)})
    few = rung("mpc", 3.0, kind="mpc")
    few = few.model_copy(update={"values": tuple(values[:3] for values in few.values)})
    apart = separation_of([early, few, RULES], "rule_based_tuned")
    assert apart is not None
    assert {(pair.first, pair.second) for pair in apart.pairs} == {
        ("sensors", "mpc"),
        ("rule_based_tuned", "sensors"),
        ("mpc", "rule_based_tuned"),
    }
    assert all(pair.difference.value > 0.0 for pair in apart.pairs)


def test_leads_are_over_the_agent_that_is_named() -> None:
    rungs = [
        rung("blind", 2.5, kind="ppo", trainings=2),
        rung("sensors", 4.0, kind="ppo", trainings=2),
        UNLIT,
        RULES.model_copy(update={"failed": 3}),
    ]
    ladder = ladder_of(rungs, "rule_based_tuned", "rule_based_unlit")
    assert [None if row.lead is None else round(row.lead.value, 9) for row in ladder.rows] == [0.5, 2.0, -3.0, None]
    share = ladder.verdicts[0].share
    assert share is not None
    assert share.value == pytest.approx(0.25)
    assert ladder.verdicts[0].gap is not None
    assert ladder.verdicts[0].gap.value == pytest.approx(-3.5)
    assert table_cells(ladder)[-1][0] == "rule_based_tuned*"
    notes = table_notes(ladder)
    assert notes.startswith("Leads are over rule_based_tuned.")
    assert notes.endswith("* Runs failed (3 of rule_based_tuned); their missing steps count at the task's price.")


def test_what_is_kept_of_a_ladder_is_small_and_makes_the_same_section() -> None:
    seven = [rung(f"view_{number}", number, kind="ppo", trainings=10, scatter=0.1) for number in range(7)]
    ladder = ladder_of([*seven, rung("mpc_blind", 2.0, kind="mpc"), rung("mpc", 3.0, kind="mpc"), UNLIT, RULES], *ZERO_AND_RULES)
    text = kept(ladder)
    assert len(text) <= LARGEST < len(ladder.model_dump_json(by_alias=True))
    again = Ladder.model_validate_json(text)
    assert section(again) == section(ladder)
    assert "- Agents of different kind separate (view_6 from rule_based_tuned): yes." in section(again)
    for small, whole in zip(again.rungs, ladder.rungs, strict=True):
        assert small.matrix == pytest.approx(whole.matrix, abs=0.0005001)
    crowd = [one.model_copy(update={"name": f"{one.name}_{number}"}) for one in seven for number in range(3)]
    with pytest.raises(ValueError, match="keep fewer rungs, trainings or runs"):
        kept(ladder.model_copy(update={"rungs": tuple(crowd)}))
