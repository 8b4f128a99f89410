"""Schema 1 of task files: the tomato greenhouse of the GreenLight-Gym paper, with its accounts."""

from __future__ import annotations

from glbench.tasks.ledger import Ledger, LedgerItem
from glbench.tasks.tables import PricesTable

_KG_PER_MG = 1e-6


def paper_v1(prices: PricesTable) -> Ledger:
    """The ledger of the GreenLight-Gym paper (2025): growth of the fruit's dry mass, sold fresh, minus heat, electricity and CO2."""
    fresh = _KG_PER_MG / prices.dry_matter_content
    return Ledger(
        (
            LedgerItem(
                "revenue", "fruit_growth", "fruit_fresh", "kg m-2", fresh, prices.fruit, 1, label="Fruit",
                meaning="value of the fresh fruit grown, when it grows and not when it is picked",
                amount_meaning="fresh fruit grown: dry increment divided by the dry matter content",
                amount_label="Fruit grown, fresh", goods="tomatoes",
            ),
            LedgerItem(
                "cost_heat", "heat", "heat", "kWh m-2", 1.0, prices.heat, -1, label="Heat",
                meaning="price of the boiler's heat", amount_meaning="heat of the boiler",
            ),
            LedgerItem(
                "cost_electricity", "electricity", "electricity", "kWh m-2", 1.0, prices.electricity, -1, label="Electricity",
                meaning="price of the lamps' electricity", amount_meaning="electricity of the lamps",
            ),
            LedgerItem(
                "cost_co2", "co2_dosed", "co2_dosed", "kg m-2", 1.0, prices.co2, -1, label="CO₂",
                meaning="price of the CO2 dosed", amount_meaning="CO2 dosed",
            ),
        ),
        "economic performance: revenue minus the costs of heat, electricity and CO2",
    )  # fmt: skip
