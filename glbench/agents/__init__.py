"""Agents: what they are, how submissions are loaded, and the rule-based baselines.

``docs/submit.md`` shows how to write an agent; ``docs/adr/0007-privileged-baseline-and-fair-twin.md`` tells why there are two
rule-based ones.
"""

from __future__ import annotations

from glbench.agents.actions import action_problems
from glbench.agents.baselines import Baseline, baseline_names, read_baseline
from glbench.agents.card import SubmissionCard, read_card
from glbench.agents.loading import LoadedAgent, load_agent
from glbench.agents.protocol import Agent, PerRunAgent, PrivilegedController, SingleRunAgent
from glbench.agents.rule_based import RuleBasedController
from glbench.agents.rule_based_fair import FairRuleBasedAgent
from glbench.agents.rule_settings import RuleSettings, read_rule_settings
from glbench.agents.rules import RuleInputs, rule_controls
from glbench.agents.submission import Submission, read_submission

__all__ = [
    "Agent",
    "Baseline",
    "FairRuleBasedAgent",
    "LoadedAgent",
    "PerRunAgent",
    "PrivilegedController",
    "RuleBasedController",
    "RuleInputs",
    "RuleSettings",
    "SingleRunAgent",
    "Submission",
    "SubmissionCard",
    "action_problems",
    "baseline_names",
    "load_agent",
    "read_baseline",
    "read_card",
    "read_rule_settings",
    "read_submission",
    "rule_controls",
]
