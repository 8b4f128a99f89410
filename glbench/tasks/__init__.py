"""Tasks: what is to be controlled, where, for how long and how it is scored, as data with a digest.

A task is a TOML file without code. Published ones are in the folder ``tasks`` with a lock; they never change. Format: docs/task-file.md.
"""

from typing import TYPE_CHECKING

from glbench.extras import lazy_names

if TYPE_CHECKING:
    from glbench.registration import register_tasks
    from glbench.tasks.card import Constraint, Place, Prices, TaskCard, task_card
    from glbench.tasks.digest import Fingerprint, LockEntry, read_lock
    from glbench.tasks.ledger import Ledger, LedgerItem, StepQuantity
    from glbench.tasks.library import (
        DEFAULT_TASK,
        PAPER_TASK,
        get_suite,
        get_task,
        list_drafts,
        list_suites,
        list_tasks,
        lock_new_tasks,
        published_task,
        usual_task,
    )
    from glbench.tasks.prices import Market, PriceTable
    from glbench.tasks.quantities import Action, Capacity, Normalisation, ObservationContext, Quantity
    from glbench.tasks.resolver import ParameterGroup, Scenario, Season, StartGroup
    from glbench.tasks.schema1 import TaskFile1
    from glbench.tasks.sealed import Round, SealedWeather, read_round
    from glbench.tasks.spec import TaskSpec
    from glbench.tasks.tables import TaskFile2
    from glbench.tasks.vocabulary import (
        ACTUATION_KINDS,
        DISTRIBUTIONS,
        INITIAL_STATES,
        METRICS,
        MODEL_VARIANTS,
        OBSERVATION_MODULES,
        PREPROCESSINGS,
        REWARD_MODULES,
        ActuationKind,
        InitialState,
        ObservationModule,
        Registry,
        Word,
    )
else:
    __getattr__ = lazy_names(__name__)

__all__ = [
    "ACTUATION_KINDS",
    "DEFAULT_TASK",
    "DISTRIBUTIONS",
    "INITIAL_STATES",
    "METRICS",
    "MODEL_VARIANTS",
    "OBSERVATION_MODULES",
    "PAPER_TASK",
    "PREPROCESSINGS",
    "REWARD_MODULES",
    "Action",
    "ActuationKind",
    "Capacity",
    "Constraint",
    "Fingerprint",
    "InitialState",
    "Ledger",
    "LedgerItem",
    "LockEntry",
    "Market",
    "Normalisation",
    "ObservationContext",
    "ObservationModule",
    "ParameterGroup",
    "Place",
    "PriceTable",
    "Prices",
    "Quantity",
    "Registry",
    "Round",
    "Scenario",
    "SealedWeather",
    "Season",
    "StartGroup",
    "StepQuantity",
    "TaskCard",
    "TaskFile1",
    "TaskFile2",
    "TaskSpec",
    "Word",
    "get_suite",
    "get_task",
    "list_drafts",
    "list_suites",
    "list_tasks",
    "lock_new_tasks",
    "published_task",
    "read_lock",
    "read_round",
    "register_tasks",
    "task_card",
    "usual_task",
]
