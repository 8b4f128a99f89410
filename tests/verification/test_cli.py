"""``glbench verify`` and the leaderboard's column, as a person meets them."""

from __future__ import annotations

import json
import os
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from glbench.cli.app import app
from glbench.cli.console import messages, output
from glbench.episodes.header import definition_json
from glbench.evaluation import load_result, result_path
from glbench.evaluation.files import LARGEST_RESULT
from glbench.leaderboard import collect_results, rank, to_frame, to_markdown
from glbench.resources import data_folder
from glbench.verification import proof_path, read_proof, save_proof, verify, was_reproduced
from glbench.verification.documents import find_task
from glbench.verification.proof import Refused
from tests.support import lettuce_task
from tests.verification.forging import record_of, rewrite, rewrite_record

RUNNER = CliRunner()


@pytest.fixture(autouse=True)
def _wide(monkeypatch):
    """A terminal of 200 columns. The consoles are remembered with their width, so they are made anew before and after."""
    monkeypatch.setenv("COLUMNS", "200")
    for console in (messages, output):
        console.cache_clear()
    yield
    for console in (messages, output):
        console.cache_clear()


def run(*arguments):
    return RUNNER.invoke(app, list(map(str, arguments)))


def test_a_reproduced_result_leaves_with_0_and_a_note(wavy):
    done = run("verify", wavy)
    assert done.exit_code == 0, done.output
    for words in ("reproduced", "the same bits", "72 rewards, 3 final states", "seeds 666, 667, 668"):
        assert words in done.stdout
    assert proof_path(wavy).is_file()


def test_what_nobody_checked_is_shown_as_stated(wavy):
    shown = run("verify", "--no-proof", wavy).stdout
    assert "Stated, not checked: that this agent gave these actions" in shown
    for words in ("sandbox", "decision time", "kernel, versions, machine, commit and date"):
        assert words in shown
    assert "the profile" in shown.partition("Stated")[0]
    verdict = json.loads(run("verify", "--json", "--no-proof", wavy).stdout)
    assert (verdict["outcome"], verdict["exactness"]) == ("reproduced", "bits")
    assert {"runs.metrics", "task.digest", "record", "profile"} <= set(verdict["reproduced"])
    assert {"agent.digest", "evaluation.sandbox", "machine", "git", "created"} <= set(verdict["stated"])


@pytest.mark.skipif(sys.platform != "linux", reason="file names that are no UTF-8")
def test_a_file_name_that_is_no_utf_8_can_be_named(tmp_path):
    path = tmp_path / os.fsdecode(b"caf\xe9.json")
    path.write_text("{}")
    done = run("verify", path)
    assert done.exit_code == 2, done.output
    assert "caf?.json" in done.stdout


def test_a_note_that_cannot_be_removed_ends_in_words(wavy):
    proof_path(wavy).mkdir()
    rewrite(wavy, lambda d: d["runs"][1]["metrics"].update(epi=1.0))
    done = run("verify", wavy)
    assert done.exit_code == 1
    assert "no note of it was stored" in done.stderr


def test_a_refuted_result_leaves_with_1_and_says_where(wavy):
    rewrite(wavy, lambda d: d["runs"][1]["metrics"].update(epi=1.0))
    done = run("verify", wavy)
    assert done.exit_code == 1
    assert "refuted" in done.stdout
    assert "epi: recorded 1.0, found -" in done.stdout
    assert not proof_path(wavy).exists()


def test_a_missing_record_leaves_with_2(wavy):
    record_of(wavy).unlink()
    done = run("verify", wavy)
    assert done.exit_code == 2
    assert "cannot tell" in done.stdout


@pytest.mark.parametrize(("agent", "ref"), [("rule_based", "rule_based"), ("my_agent", "submissions/my_agent.py")])
def test_a_released_result_says_how_to_get_its_record(agent, ref):
    released = data_folder("reports/released/results") / "Spring-v1" / f"{agent}.json"
    if record_of(released).exists():
        pytest.skip("this copy has the record")
    done = run("verify", released)
    said = " ".join(done.stdout.split())
    assert done.exit_code == 2
    assert f"`glbench evaluate {ref} --task glbench/Spring-v1 --fresh --out again`" in said
    assert "`glbench leaderboard --task glbench/Spring-v1 --out again` then says whether it is the same as the released one." in said
    assert "Put the file back" not in said


def test_a_published_task_is_not_taken_from_a_file():
    result = load_result(data_folder("reports/released/results") / "Spring-v1" / "rule_based.json")
    with pytest.raises(Refused, match=r"is published, and is verified as published\. Leave out --task"):
        find_task(result, None, Path("own.toml"))


def test_of_several_results_the_refuted_one_decides_and_all_are_judged(reports, day_task):
    paths = [result_path(reports, day_task.id, name) for name in ("wavy", "narrow", "failing")]
    record_of(paths[0]).unlink()
    rewrite(paths[1], lambda d: d["runs"][0]["metrics"].update(co2=0.0))
    done = run("verify", "--json", *paths)
    assert done.exit_code == 1
    verdicts = [json.loads(line) for line in done.stdout.splitlines()]
    assert [verdict["outcome"] for verdict in verdicts] == ["unknown", "refuted", "reproduced"]
    assert run("verify", paths[2], paths[0]).exit_code == 2


def of_no_model(log):
    return replace(log, definition=definition_json(lettuce_task()).replace(b"greenlight-lettuce", b"moonlight"))


def test_a_record_of_an_unknown_model_does_not_end_the_verification(reports, day_task):
    wavy, narrow = (result_path(reports, day_task.id, name) for name in ("wavy", "narrow"))
    rewrite_record(narrow, of_no_model, repair=False)
    done = run("verify", "--json", narrow, wavy)
    assert done.exit_code == 2, done.output
    verdicts = [json.loads(line) for line in done.stdout.splitlines()]
    assert [(verdict["outcome"], verdict["cause"]) for verdict in verdicts] == [("unknown", "no_task"), ("reproduced", "")]
    assert "There is no model 'moonlight" in verdicts[0]["reason"]


def test_a_record_of_an_unknown_model_under_a_published_id_is_refuted(wavy, day_task, monkeypatch):
    rewrite_record(wavy, of_no_model, repair=False)
    monkeypatch.setattr("glbench.verification.documents.task_ids", lambda: (day_task.id,))
    assert verify(wavy).cause == "damaged_record"


def test_whatever_goes_wrong_with_a_file_the_others_are_judged(reports, day_task, monkeypatch):
    def failing(path, **_arguments):
        if path.stem == "narrow":
            raise ZeroDivisionError
        return verify(path)

    monkeypatch.setattr("glbench.verification.verify", failing)
    done = run("verify", "--json", *(result_path(reports, day_task.id, name) for name in ("narrow", "wavy")))
    assert done.exit_code == 2, done.output
    assert [json.loads(line)["outcome"] for line in done.stdout.splitlines()] == ["unknown", "reproduced"]


def test_a_released_result_keeps_its_proof(wavy, monkeypatch):
    monkeypatch.setattr("glbench.resources.is_released", lambda _path: True)
    assert run("verify", wavy).exit_code == 0
    assert not proof_path(wavy).exists()
    save_proof(verify(wavy))
    before = proof_path(wavy).read_bytes()
    rewrite(wavy, lambda d: d["runs"][0]["metrics"].update(co2=0.0))
    assert run("verify", wavy).exit_code == 1
    assert proof_path(wavy).read_bytes() == before


def test_a_folder_means_all_results_in_it(reports):
    assert run("verify", reports / "results").exit_code == 0
    done = run("verify", "--json", "--no-proof", reports / "results")
    assert len(done.stdout.splitlines()) == 4  # the proofs written the first time are no results


def test_leaderboard_rows_say_verified_only_with_a_proof_of_this_very_file(reports, day_task):
    def verified():
        tables = rank(collect_results([reports / "results"]), {})
        text = to_markdown(tables, {})
        column = {row.agent: row.reproduced for row in tables[0].rows}
        assert dict(zip(to_frame(tables)["agent"], to_frame(tables)["reproduced"], strict=True)) == column
        assert text.count("| ✓ |") == sum(column.values())
        return {agent for agent, value in column.items() if value}

    assert verified() == set()
    for name in ("wavy", "rule_based"):
        save_proof(verify(result_path(reports, day_task.id, name)))
    assert verified() == {"wavy", "rule_based"}
    rewrite(result_path(reports, day_task.id, "wavy"), lambda d: d.update(created="2030-01-01T00:00:00+00:00"))
    assert verified() == {"rule_based"}


def test_a_note_that_somebody_else_wrote_gives_no_mark(wavy, tmp_path, monkeypatch):
    """Of two users with the same result and note only the one who reproduced it sees the mark."""
    monkeypatch.setenv("GLBENCH_DATA", str(tmp_path / "me"))
    save_proof(verify(wavy))
    assert was_reproduced(wavy)
    assert (tmp_path / "me" / "proof.key").stat().st_mode & 0o077 == 0
    note = json.loads(proof_path(wavy).read_text())

    monkeypatch.setenv("GLBENCH_DATA", str(tmp_path / "you"))
    assert read_proof(wavy) is not None
    assert not was_reproduced(wavy)
    for seal in (None, "0" * 64):
        proof_path(wavy).write_text(json.dumps({**note, "seal": seal}))
        assert read_proof(wavy) is not None
        assert not was_reproduced(wavy)
    save_proof(verify(wavy))
    assert was_reproduced(wavy)


def test_a_proof_of_changed_actions_is_not_carried_over(wavy):
    save_proof(verify(wavy))
    rewrite_record(wavy, lambda log: log)
    assert run("verify", wavy).exit_code == 0


@pytest.mark.usefixtures("few_released")
def test_the_table_on_the_terminal_marks_what_is_verified_within_80_columns(reports, day_task, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    output.cache_clear()
    save_proof(verify(result_path(reports, day_task.id, "wavy")))
    lines = run("leaderboard", "--out", reports, "--task", day_task.id).stdout.splitlines()
    assert sum("✓" in line for line in lines) == 2  # the row, and the note that explains the mark
    assert any("wavy ‡✓" in line for line in lines)  # evaluated in this process, hence unsandboxed
    assert max(len(line) for line in lines) <= 80


@pytest.mark.skipif(sys.platform == "win32", reason="no such names")
def test_names_of_files_do_not_steer_the_terminal(tmp_path):
    (tmp_path / "x\x1b[2J\x07.json").write_text("{", encoding="utf-8")
    done = CliRunner().invoke(app, ["verify", str(tmp_path), "--no-proof"])
    assert done.exit_code == 1
    assert "\x1b[2J" not in done.output
    assert "\x07" not in done.output


FORGING = "a.json\nreproduced mallory.json\n  30 runs earn what the result says.json"


@pytest.mark.skipif(sys.platform == "win32", reason="no such names")
@pytest.mark.usefixtures("few_released")
def test_names_of_files_forge_no_lines(reports, wavy):
    (wavy.parent / FORGING).write_text("{", encoding="utf-8")
    (wavy.parent / FORGING.replace("a.json", "b.json")).write_bytes(wavy.read_bytes())
    for command in (("verify", reports / "results"), ("leaderboard", "--out", reports)):
        done = run(*command)
        lines = [line for line in done.output.splitlines() if "mallory" in line]
        assert lines, (command, done.output)
        assert all(".json?reproduced mallory.json?" in line for line in lines), (command, lines)


def test_a_file_that_changes_under_the_verification_gets_no_note(wavy):
    honest = wavy.read_bytes()

    def swap(step, steps):
        if step == 5:
            wavy.write_bytes(honest.replace(b'"created"', b'"created" '))

    verdict = verify(wavy, progress=swap)
    assert verdict.outcome == "reproduced"
    assert save_proof(verdict) is None
    assert not was_reproduced(wavy)


def test_who_verifies_a_file_that_changes_is_told(wavy, monkeypatch):
    def changing(path, **arguments):
        verdict = verify(path, **arguments)
        path.write_bytes(path.read_bytes().replace(b'"created"', b'"created" '))
        return verdict

    monkeypatch.setattr("glbench.verification.verify", changing)
    answer = run("verify", str(wavy))
    assert answer.exit_code == 0
    assert "changed while it was verified, so no note of it was stored" in " ".join(answer.output.split())


def test_a_file_that_is_too_large_cannot_be_verified(tmp_path):
    with (tmp_path / "large.json").open("wb") as file:
        file.truncate(LARGEST_RESULT + 1)
    assert verify(tmp_path / "large.json").outcome == "unknown"
