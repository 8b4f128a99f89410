"""The task card that the server gives: everything that an agent may know, for programs and people that never saw glbench."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from glbench.evaluation.metrics import metrics_of
from glbench.report.task_words import period
from glbench.tasks import ACTUATION_KINDS, TaskSpec, task_card


def card(task: TaskSpec, splits: Sequence[str]) -> dict[str, Any]:
    """The card of ``task``, served in ``splits``: plain values for JSON, with units."""
    kind = ACTUATION_KINDS[task.actuation.kind]
    public, capacities = task_card(task), {one.name: one for one in task.capacities()}
    return {
        "id": task.id,
        "title": task.title,
        "description": task.description,
        "digest": task.digest,
        "splits": list(splits),
        "place": {"latitude": public.place.latitude, "longitude": public.place.longitude, "altitude": public.place.altitude},
        "day": {
            "clock": public.clock,
            "steps": task.steps_per_day,
            "step_minutes": task.step_seconds / 60.0,
            "meaning": f"A day begins at midnight of the clock {public.clock}. A step takes {task.step_seconds / 60.0:g} minutes, in which "
            "the action acts and the weather is constant. A season begins at such a midnight; time advances in steps only.",
        },
        "season": {"days": task.weather.days, "steps": task.steps, "period": period(task)},
        "observations": [
            {"name": one.name, "unit": one.unit, "low": one.low, "high": one.high, "typical": list(one.typical), "meaning": one.meaning}
            for one in public.observations
        ],
        "actions": [
            {
                "name": one.name, "low": one.low, "high": one.high, "idle": one.idle, "unit": one.unit,
                "lowest": one.lowest, "highest": one.highest, "idle_value": one.value(one.idle),
                "meaning": one.meaning or (capacities[one.name].meaning if one.name in capacities else ""),
            }
            for one in public.actions
        ],
        "actuation": {"kind": kind.name, "max_change": public.max_change, "meaning": kind.meaning},
        "controls": [
            {"name": one.name, "observed_as": one.quantity, "unit": one.unit, "at_one": one.at_one, "meaning": one.meaning}
            for one in public.controls
        ],
        "limits": [
            {"name": one.name, "unit": one.unit, "low": one.low, "high": one.high, "price_of_a_unit_and_hour": one.price}
            | ({} if one.lower_price is None else {"price_of_a_unit_too_low_and_hour": one.lower_price})
            for one in public.constraints
        ],
        "ledger": [
            {
                "name": one.name, "label": one.label, "side": "earned" if one.sign > 0 else "paid", "unit": one.unit,
                "amount": one.amount, "amount_unit": one.amount_unit, "price": one.price, "price_unit": one.price_unit,
                "beyond": None if one.beyond is None else {"amount": one.beyond.amount, "price": one.beyond.price},
            }
            for one in public.ledger
        ],
        "price_tables": {
            name: {"unit": table.unit, "hourly": list(table.hourly), "lowest": table.limits[0], "highest": table.limits[1]}
            for name, table in task.price_tables.items()
        },
        "schedule": [entry.model_dump(by_alias=True) for entry in task.schedule],
        "reward": {"unit": task.quantities[0].unit, "modules": list(public.reward_modules)},
        "account": {metric.name: metric.unit for metric in metrics_of(task)},
    }  # fmt: skip
