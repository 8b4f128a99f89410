"""Whatever is changed in a result or its records is refused, each with a reason of its own."""

from __future__ import annotations

import gzip
import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from glbench.episodes import actions_path, episode_path, episodes_folder, read_episode, read_log, write_episode
from glbench.evaluation import result_path
from glbench.evaluation.profiles import Profile, profile_path
from glbench.verification import verify
from tests.verification.forging import changed, record_of, rewrite, rewrite_record


def refused(path, cause, *words):
    verdict = verify(path)
    assert verdict.outcome == "refuted", verdict
    assert verdict.exit_code == 1
    assert verdict.cause == cause, verdict
    for word in words:
        assert word in verdict.reason, verdict.reason
    return verdict


def test_a_better_reward_in_the_file(wavy):
    rewrite(wavy, lambda d: d["runs"][1]["metrics"].update(reward=0.0), repair=False)
    refused(wavy, "inconsistent", "summary")


def test_a_better_reward_with_summary_and_digest_repaired(wavy):
    rewrite(wavy, lambda d: d["runs"][1]["metrics"].update(reward=0.0))
    refused(wavy, "metric", "seed 667", "reward: recorded 0.0, found -")


def test_the_last_bit_of_one_metric(wavy):
    def nudge(document):
        metrics = document["runs"][2]["metrics"]
        metrics["heat"] = float(np.nextafter(metrics["heat"], 1e9))

    rewrite(wavy, nudge)
    refused(wavy, "metric", "seed 668", "heat")


def test_a_changed_action(wavy):
    rewrite_record(wavy, lambda log: replace(log, actions=changed(log.actions, (7, 1, 0), 0.25)), repair=False)
    refused(wavy, "record_digest", "Actions, rewards or final states were changed")


def test_a_changed_action_with_digest_repaired(wavy):
    rewrite_record(wavy, lambda log: replace(log, actions=changed(log.actions, (7, 1, 0), 0.25)))
    refused(wavy, "reward", "step 8", "seed 667")


def test_an_action_that_is_not_allowed(wavy):
    rewrite_record(wavy, lambda log: replace(log, actions=changed(log.actions, (3, 0, 4), 7.0)))
    refused(wavy, "invalid_action", "step 4", "uLamp")


def test_a_changed_reward_in_the_record(wavy):
    rewrite_record(wavy, lambda log: replace(log, rewards=changed(log.rewards, (11, 2), 1.0)))
    refused(wavy, "reward", "step 12", "seed 668", "recorded 1.0")


def test_a_changed_final_state(wavy):
    rewrite_record(wavy, lambda log: replace(log, final_states=changed(log.final_states, (0, 2), 20.0)))
    refused(wavy, "state", "seed 666", "tAir")


def test_another_seed_in_the_result(wavy):
    rewrite(wavy, lambda d: d["runs"][2].update(seed=669))
    refused(wavy, "seeds", "669")


def test_other_seeds_in_result_and_record(wavy):
    def shift(document):
        for run in document["runs"]:
            run["seed"] += 100

    rewrite(wavy, shift)
    rewrite_record(wavy, lambda log: replace(log, runs=tuple(run.model_copy(update={"seed": run.seed + 100}) for run in log.runs)))
    refused(wavy, "reward", "step 1")


def test_two_runs_exchanged_in_the_record(wavy):
    rewrite_record(wavy, lambda log: replace(log, actions=log.actions[:, [1, 0, 2]], rewards=log.rewards[:, [1, 0, 2]]))
    refused(wavy, "reward")


def test_the_record_of_another_agent(wavy, reports, day_task):
    shutil.copy(actions_path(result_path(reports, day_task.id, "narrow")), record_of(wavy))
    refused(wavy, "record_of_other_agent", "'narrow'")


def test_another_agent_named_in_the_result(wavy):
    rewrite(wavy, lambda d: d["agent"].update(name="famous"))
    refused(wavy, "record_of_other_agent", "'famous'")


def test_a_record_that_was_cut(wavy):
    record_of(wavy).write_bytes(record_of(wavy).read_bytes()[:-700])
    refused(wavy, "damaged_record", "cut off")


def shorten(log):
    return replace(log, runs=(log.runs[0].model_copy(update={"steps": 20, "actions": 20}), *log.runs[1:]))


def test_a_shortened_run_in_the_record(wavy):
    rewrite_record(wavy, shorten)
    refused(wavy, "shortened", "seed 666", "20 steps", "24")


def test_a_run_shortened_everywhere_and_called_crashed(wavy):
    rewrite_record(wavy, shorten)
    crash = {"status": "crashed", "reason": "ValueError: no"}
    rewrite_record(wavy, lambda log: replace(log, runs=(log.runs[0].model_copy(update=crash), *log.runs[1:])))
    rewrite(wavy, lambda d: d["runs"][0].update(steps=20, **crash))
    refused(wavy, "state", "seed 666")


def test_a_bad_run_left_out_of_the_result(wavy):
    rewrite(wavy, lambda d: d["runs"].pop())
    refused(wavy, "dropped_run", "leaves out the seed 668")


def test_a_bad_run_left_out_of_result_and_record(wavy):
    keep = [0, 2]
    rewrite(wavy, lambda d: d["runs"].pop(1))
    rewrite_record(
        wavy,
        lambda log: replace(
            log,
            runs=tuple(log.runs[row] for row in keep),
            actions=log.actions[:, keep],
            rewards=log.rewards[:, keep],
            final_states=log.final_states[keep],
        ),
    )
    refused(wavy, "dropped_run", "not consecutive", "667")


def test_a_run_made_up_in_the_result(wavy):
    rewrite(wavy, lambda d: d["runs"].append({**d["runs"][0], "seed": 669}))
    refused(wavy, "missing_run", "669")


def test_the_result_of_another_version_of_the_task(wavy):
    other = "0" * 64
    rewrite(wavy, lambda d: d["task"].update(digest=other))
    refused(wavy, "record_of_other_task")

    def retask(log):
        task = log.provenance.task
        parts = {**task.parts, "weather": other}
        return replace(
            log, provenance=log.provenance.model_copy(update={"task": task.model_copy(update={"digest": other, "parts": parts})})
        )

    rewrite_record(wavy, retask)
    refused(wavy, "other_task_version", "another version", "weather")


def test_the_digest_of_other_weather_in_the_record(wavy):
    def reweather(log):
        task = log.provenance.task
        parts = {**task.parts, "weather": "0" * 64}
        return replace(log, provenance=log.provenance.model_copy(update={"task": task.model_copy(update={"parts": parts})}))

    rewrite_record(wavy, reweather)
    refused(wavy, "record_of_other_task", "digests of the task's parts")


def test_another_definition_of_the_task_in_the_record(wavy):
    rewrite_record(wavy, lambda log: replace(log, definition=log.definition.replace(b'"fruit": 1.6', b'"fruit": 160.0')))
    refused(wavy, "other_task_version", "definition")


def test_a_privileged_controller_that_is_called_fair(reports, day_task):
    path = result_path(reports, day_task.id, "rule_based")
    rewrite(path, lambda d: d["agent"].update(privileged=False))
    refused(path, "record_of_other_agent", "privileged")

    def demote(log):
        return replace(
            log, provenance=log.provenance.model_copy(update={"agent": log.provenance.agent.model_copy(update={"privileged": False})})
        )

    rewrite_record(path, demote)
    refused(path, "privileged", "Only the privileged")


def test_a_failed_run_whose_penalty_was_taken_out(reports, day_task):
    path = result_path(reports, day_task.id, "failing")

    def pardon(document):
        run = document["runs"][1]
        run["metrics"]["reward"] += 3.0 * (24 - run["steps"])

    rewrite(path, pardon)
    refused(path, "metric", "seed 667", "reward")


def test_another_kernel_named_in_the_result(wavy):
    rewrite(wavy, lambda d: d["evaluation"]["kernel"].update(preset="fast"))
    refused(wavy, "other_kernel")


def test_other_versions_named_in_the_result(wavy):
    rewrite(wavy, lambda d: d["versions"].update(casadi="3.5.0"))
    refused(wavy, "other_versions", "3.5.0")


def test_a_record_file_outside_the_folder(wavy):
    rewrite(wavy, lambda d: d["record"].update(file="../elsewhere.mcap"))
    refused(wavy, "inconsistent", "record.file")


def test_a_record_that_counts_other_steps_than_it_has(wavy):
    def stretch(log):
        task = log.provenance.task
        return replace(log, provenance=log.provenance.model_copy(update={"task": task.model_copy(update={"steps": 48})}))

    rewrite_record(wavy, stretch)
    refused(wavy, "record_of_other_task", "steps")


def test_actions_of_other_controls(wavy):
    def rename(log):
        agent = log.provenance.agent
        columns = (*agent.columns[1:], agent.columns[0])
        return replace(log, provenance=log.provenance.model_copy(update={"agent": agent.model_copy(update={"columns": columns})}))

    rewrite_record(wavy, rename)
    refused(wavy, "record_of_other_task", "uCo2, uThScr")


# What a result says of its machine buys nothing


STATEMENTS = {
    "processor": lambda d: d["machine"].update(processor="Abacus 9"),
    "architecture": lambda d: d["machine"].update(architecture="abacus"),
    "versions": lambda d: d["versions"].update(gymnasium="0.0.1"),
    "everything": lambda d: (
        d["machine"].update(processor="Abacus 9", architecture="abacus", system="none"),
        d["versions"].update(gymnasium="0.0.1"),
    ),
}
KERNELS = {
    "library": {"library_digest": "0" * 64},
    "compiler": {"compiler": "abacc 1.0", "compiler_flags": "-O9"},
    "backend": {"backend": "abacus"},
}


@pytest.mark.parametrize("statement", [*STATEMENTS, *KERNELS, "all"])
@pytest.mark.parametrize("nudged", ["metric", "reward", "state", "run"])
def test_a_stated_machine_does_not_excuse_a_difference(wavy, statement, nudged):
    tiny = 1.0 + 1e-13
    if nudged == "metric":
        rewrite(wavy, lambda d: d["runs"][0]["metrics"].update(heat=d["runs"][0]["metrics"]["heat"] * tiny))
    if nudged in ("reward", "run"):
        rewrite_record(wavy, lambda log: replace(log, rewards=changed(log.rewards, (2, 0), log.rewards[2, 0] * tiny)))
        total = float(np.add.accumulate(read_log(record_of(wavy)).rewards[:, 0])[-1])
        rewrite(wavy, lambda d: d["runs"][0]["metrics"].update(reward=total))
    if nudged in ("state", "run"):
        rewrite_record(wavy, lambda log: replace(log, final_states=changed(log.final_states, (0, 2), log.final_states[0, 2] * tiny)))
    before = verify(wavy)
    assert before.outcome == "refuted"
    for name, change in STATEMENTS.items():
        if statement in (name, "all"):
            rewrite(wavy, change)
    for name, kernel in KERNELS.items():
        if statement in (name, "all"):
            state_kernel(wavy, kernel)
    after = verify(wavy)
    assert (after.outcome, after.cause, after.exactness) == (before.outcome, before.cause, None), after


def state_kernel(wavy, kernel):
    rewrite(wavy, lambda d: d["evaluation"]["kernel"].update(kernel))
    rewrite_record(
        wavy, lambda log: replace(log, provenance=log.provenance.model_copy(update={"kernel": {**log.provenance.kernel, **kernel}}))
    )


def test_a_profile_that_shows_something_else(wavy):
    document = json.loads(gzip.decompress(profile_path(wavy).read_bytes()))
    document["hours"]["heat"]["values"][3][0] += 1
    profile = Profile(document)
    profile_path(wavy).write_bytes(profile.to_bytes())
    refused(wavy, "profile", "not the profile that wavy.json names")
    rewrite(wavy, lambda d: d["profile"].update(digest=profile.digest))
    refused(wavy, "profile", "what the recorded actions lead to")


# Full episodes


@pytest.fixture
def episode(wavy):
    return episode_path(episodes_folder(wavy), 667)


def test_a_changed_state_in_a_full_episode(wavy, episode):
    record = read_episode(episode)
    place = next(group.names.index("co2Air") for group in record.groups if group.name == "state")
    tables = {**record.tables, "state": changed(record.tables["state"], (4, place), 900.0)}
    write_episode(episode, replace(record, tables=tables))
    refused(wavy, "episode", "seed 667", "step 5, co2Air: recorded 900.0")


def test_a_changed_action_in_a_full_episode(wavy, episode):
    record = read_episode(episode)
    tables = {**record.tables, "action": changed(record.tables["action"], (9, 1), 0.5)}
    write_episode(episode, replace(record, tables=tables))
    refused(wavy, "episode_action", "step 10")


def test_an_episode_under_the_name_of_another(wavy, episode):
    shutil.copy(episode.with_name("seed-666.mcap"), episode)
    refused(wavy, "swapped_episode", "seed 666")


def test_an_episode_of_another_agent(wavy, episode, reports, day_task):
    shutil.copy(episode_path(episodes_folder(result_path(reports, day_task.id, "narrow")), 667), episode)
    refused(wavy, "swapped_episode", "another evaluation")


def test_an_episode_that_was_cut(wavy, episode):
    episode.write_bytes(episode.read_bytes()[:30000])
    refused(wavy, "damaged_episode", "recover")


def test_an_episode_that_was_cut_and_recovered(wavy, episode, tmp_path):
    from glbench.episodes import recover

    torn = tmp_path / "torn.mcap"
    torn.write_bytes(episode.read_bytes()[:30000])
    recover(torn, episode)
    refused(wavy, "shortened_episode", "of the 24 steps")
