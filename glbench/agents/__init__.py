"""Agents: what they are, how submissions are loaded, and the rule-based baselines.

``docs/submit.md`` shows how to write an agent; ``docs/adr/0007-privileged-baseline-and-fair-twin.md`` says why two are rule-based.
"""

from typing import TYPE_CHECKING

from glbench.extras import lazy_names

if TYPE_CHECKING:
    from glbench.agents.baselines import Baseline, read_baseline
    from glbench.agents.card import SubmissionCard, read_card
    from glbench.agents.identity import Identity, baseline_names, identify
    from glbench.agents.loading import LoadedAgent, load_agent
    from glbench.agents.protocol import Agent, PerRunAgent, PrivilegedController, ScenarioController, SingleRunAgent, action_problems
    from glbench.agents.rules import FairRuleBasedAgent, RuleBasedController, RuleInputs, RuleSettings, read_rule_settings, rule_controls
    from glbench.agents.tuned_rules import TunedRulesAgent
else:
    __getattr__ = lazy_names(__name__)

__all__ = [
    "Agent", "Baseline", "FairRuleBasedAgent", "Identity", "LoadedAgent", "PerRunAgent", "PrivilegedController", "RuleBasedController",
    "RuleInputs", "RuleSettings", "ScenarioController", "SingleRunAgent", "SubmissionCard", "TunedRulesAgent", "action_problems",
    "baseline_names", "identify", "load_agent", "read_baseline", "read_card", "read_rule_settings", "rule_controls",
]  # fmt: skip
