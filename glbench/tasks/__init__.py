"""Tasks: what is to be controlled, where, for how long and how it is scored, as data with a digest.

A task is a TOML file without code. Published ones are in the folder ``tasks`` with a lock; they never change. docs/tasks.md
explains the format.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from glbench.late import late_names

if TYPE_CHECKING:
    from glbench.registration import register_tasks as register_tasks
    from glbench.tasks.actions import Action as Action
    from glbench.tasks.card import Constraint as Constraint
    from glbench.tasks.card import Place as Place
    from glbench.tasks.card import Prices as Prices
    from glbench.tasks.card import TaskCard as TaskCard
    from glbench.tasks.card import task_card as task_card
    from glbench.tasks.ledger import Ledger as Ledger
    from glbench.tasks.ledger import LedgerItem as LedgerItem
    from glbench.tasks.ledger import StepQuantity as StepQuantity
    from glbench.tasks.library import DEFAULT_TASK as DEFAULT_TASK
    from glbench.tasks.library import PAPER_TASK as PAPER_TASK
    from glbench.tasks.library import get_suite as get_suite
    from glbench.tasks.library import get_task as get_task
    from glbench.tasks.library import list_drafts as list_drafts
    from glbench.tasks.library import list_suites as list_suites
    from glbench.tasks.library import list_tasks as list_tasks
    from glbench.tasks.library import lock_new_tasks as lock_new_tasks
    from glbench.tasks.library import usual_task as usual_task
    from glbench.tasks.lock import Fingerprint as Fingerprint
    from glbench.tasks.lock import LockEntry as LockEntry
    from glbench.tasks.lock import read_lock as read_lock
    from glbench.tasks.prices import Market as Market
    from glbench.tasks.prices import PriceTable as PriceTable
    from glbench.tasks.quantities import Capacity as Capacity
    from glbench.tasks.quantities import ObservationContext as ObservationContext
    from glbench.tasks.quantities import Quantity as Quantity
    from glbench.tasks.scenario import ParameterGroup as ParameterGroup
    from glbench.tasks.scenario import Scenario as Scenario
    from glbench.tasks.scenario import Season as Season
    from glbench.tasks.scenario import StartGroup as StartGroup
    from glbench.tasks.sealed import Round as Round
    from glbench.tasks.sealed import SealedWeather as SealedWeather
    from glbench.tasks.sealed import read_round as read_round
    from glbench.tasks.spec import TaskSpec as TaskSpec
    from glbench.tasks.tables import TaskFile1 as TaskFile1
    from glbench.tasks.tables import TaskFile2 as TaskFile2
    from glbench.tasks.vocabulary import ACTUATION_KINDS as ACTUATION_KINDS
    from glbench.tasks.vocabulary import DISTRIBUTIONS as DISTRIBUTIONS
    from glbench.tasks.vocabulary import INITIAL_STATES as INITIAL_STATES
    from glbench.tasks.vocabulary import METRICS as METRICS
    from glbench.tasks.vocabulary import MODEL_VARIANTS as MODEL_VARIANTS
    from glbench.tasks.vocabulary import OBSERVATION_MODULES as OBSERVATION_MODULES
    from glbench.tasks.vocabulary import PREPROCESSINGS as PREPROCESSINGS
    from glbench.tasks.vocabulary import REWARD_MODULES as REWARD_MODULES
    from glbench.tasks.vocabulary import ActuationKind as ActuationKind
    from glbench.tasks.vocabulary import InitialState as InitialState
    from glbench.tasks.vocabulary import ObservationModule as ObservationModule
    from glbench.tasks.vocabulary import Registry as Registry
    from glbench.tasks.vocabulary import Word as Word
else:
    __getattr__ = late_names(
        __name__,
        {
            "glbench.registration": ("register_tasks",),
            "actions": ("Action",),
            "card": ("Constraint", "Place", "Prices", "TaskCard", "task_card"),
            "ledger": ("Ledger", "LedgerItem", "StepQuantity"),
            "prices": ("Market", "PriceTable"),
            "scenario": ("ParameterGroup", "Scenario", "Season", "StartGroup"),
            "tables": ("TaskFile1", "TaskFile2"),
            "library": (
                "DEFAULT_TASK",
                "PAPER_TASK",
                "get_suite",
                "get_task",
                "list_drafts",
                "list_suites",
                "list_tasks",
                "lock_new_tasks",
                "usual_task",
            ),
            "lock": ("Fingerprint", "LockEntry", "read_lock"),
            "quantities": ("Capacity", "ObservationContext", "Quantity"),
            "sealed": ("Round", "SealedWeather", "read_round"),
            "spec": ("TaskSpec",),
            "vocabulary": (
                "ACTUATION_KINDS",
                "DISTRIBUTIONS",
                "INITIAL_STATES",
                "METRICS",
                "MODEL_VARIANTS",
                "OBSERVATION_MODULES",
                "PREPROCESSINGS",
                "REWARD_MODULES",
                "ActuationKind",
                "InitialState",
                "ObservationModule",
                "Registry",
                "Word",
            ),
        },
    )
