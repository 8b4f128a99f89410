"""Schema 1 of task files: the tomato greenhouse of the GreenLight-Gym paper, with its accounts."""

from __future__ import annotations

from glbench.quantities import FLOWS
from glbench.tasks.ledger import Ledger, LedgerItem
from glbench.tasks.tables import PricesTable

_KG_PER_MG = 1e-6


def paper_v1(prices: PricesTable) -> Ledger:
    """The ledger of the GreenLight-Gym paper (2025): growth of the fruit's dry mass, sold fresh, minus heat, electricity and CO2."""
    fresh = _KG_PER_MG / prices.dry_matter_content
    heat, electricity, co2 = (
        LedgerItem(
            f"cost_{name}", flow, flow, FLOWS[flow].unit, 1.0, price, -1, label=FLOWS[flow].item_label,
            meaning=FLOWS[flow].price_of, amount_meaning=FLOWS[flow].meaning,
        )
        for name, flow, price in (
            ("heat", "heat", prices.heat), ("electricity", "electricity", prices.electricity), ("co2", "co2_dosed", prices.co2),
        )
    )  # fmt: skip
    return Ledger(
        (
            LedgerItem(
                "revenue", "fruit_growth", "fruit_fresh", "kg m-2", fresh, prices.fruit, 1, label="Fruit",
                meaning="value of the fresh fruit grown, when it grows and not when it is picked",
                amount_meaning="fresh fruit grown: dry increment divided by the dry matter content",
                amount_label="Fruit grown, fresh", goods="tomatoes",
            ),
            heat,
            electricity,
            co2,
        ),
        "economic performance: revenue minus the costs of heat, electricity and CO2",
    )  # fmt: skip
