"""YAML of strangers: what it may say, and the sentence with file and line where it says anything else."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
import yaml

from glbench.agents.predictive import read_predictive_settings
from glbench.agents.rules import read_rule_settings
from glbench.agents.tuned_rules import read_rule_page
from glbench.errors import GlbenchError, SubmissionError
from glbench.resources import data_folder
from glbench.training.settings import read_settings
from glbench.training.sweep import read_search
from glbench.yaml_reader import read_yaml

LAUGHS = "a0: &a0 [ha]\n" + "".join(f"a{level}: &a{level} [{', '.join([f'*a{level - 1}'] * 9)}]\n" for level in range(1, 10))
REFUSED = {
    "billion laughs": (LAUGHS, "aliases"),
    "an alias of itself": ("a: &a [*a]\n", "line 1, .*nested more than 20 levels"),
    "depth": ("a: " + "[" * 30_000, "nested more than 20 levels"),
    "deep blocks": ("".join(" " * level + "a:\n" for level in range(300)), "line 20, .*nested more than 20 levels"),
    "a long number": ("a: " + "9" * 5000, "line 1, .*not a finite number"),
    "a long number with a base": ("a: 0x" + "f" * 5000, "not a finite number"),
    "a long fraction": ("a: 0." + "9" * 5000, "not a finite number"),
    "a number without digits": ("a: 0x_", "not a finite number"),
    "infinity": ("b: 1\na: .inf", "line 2, 'a: .inf': '.inf' is not a finite number"),
    "not a number": ("a: .nan", "not a finite number"),
    "overflow": ("a: 1.0e+999", "not a finite number"),
    "a name twice": ("a: 1\nb: {c: 1, c: 2}", "has 'c' twice, in lines 2 and 2"),
    "a tag of Python": ("a: !!python/object/apply:os.getcwd []", "line 1, .*has a tag"),
    "a tag of dates": ("a: !!timestamp x", "has a tag"),
    "a binary": ("a: !!binary aGE=", "has a tag"),
    "an own tag": ("a: !mine {b: 1}", "has a tag"),
    "an unknown handle": ("a: !e!mine {b: 1}", "line 1, "),
    "Latin-1": (b"a: caf\xe9", "byte 7 is not UTF-8"),
    "UTF-16": ("a: 1".encode("utf-16"), "byte 1 is not UTF-8"),
    "NUL": (b"a: 1\nb: \x00", r"line 2, .*U\+0000"),
    "an escape": (b"a: \x1b[2J", r"line 1, 'a: .x1b\[2J': the character U\+001B"),
    "half a character": ('a: 1\nb: "\\ud800"', "line 2, .*half a character"),
    "a character beyond Unicode": ('a: 1\nb: "\\UFFFFFFFF"', "line 2, .*not valid YAML"),
    "half the way beyond Unicode": ('a: 1\nb: "\\U00110000"', "line 2, .*not valid YAML"),
    "a version of thousands of digits": ("%YAML " + "9" * 5000 + ".1\n---\na: 1", "line 1, .*not valid YAML"),
    "a version of YAML to come": ("%YAML 9.9\n---\na: 1", "line 1, .*not valid YAML"),
    "a tab": ("a:\n\tb: 1", "line 2, .*it begins with a tab"),
    "a decimal comma": ("a: 1\nb:\n  c: -18,5\n", "line 3, '  c: -18,5': a number has a decimal point: write -18.5, not -18,5"),
    "a decimal comma in thousands": ("a: 1.600,5", "write 1600.5, not 1.600,5"),
    "an open bracket": ("a: [1", "Every line is 'name: value'"),
    "an open quote": ('a: "1', "Every line is 'name: value'"),
    "two documents": ("a: 1\n---\na: 2", "Every line is 'name: value'"),
    "an alias of nothing": ("a: *b", "line 1, "),
    "a table as a name": ("? {a: 1}\n: 2", "is not text"),
    "a number as a name": ("1: 2", "the name 1 is not text"),
    "a yes as a name": ("on: 2", "the name True is not text"),
    "a merge of nothing": ("a: {<<: 1}", "'<<' takes tables"),
    "nothing": ("# empty\n", "it is empty"),
    "a list": ("- 1", "not a table of names and values"),
    "a text": ("hello", "not a table of names and values"),
    "too large": ("# " + "x" * 70_000, "larger than 64 KiB"),
}
READERS = {
    "tuned rules": read_rule_page,
    "rules": read_rule_settings,
    "predictive": read_predictive_settings,
    "training": lambda file: read_settings(file, "ppo", "test/Day-v1"),
    "search": read_search,
}


@pytest.mark.parametrize(("content", "said"), REFUSED.values(), ids=REFUSED)
def test_what_is_no_table_of_names_and_values_is_refused(tmp_path: Path, content: str | bytes, said: str) -> None:
    file = tmp_path / "x.yml"
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    began = time.monotonic()
    with pytest.raises(SubmissionError, match=rf"^Cannot read the rules \S*x\.yml.*: .*{said}|^Cannot read .*{said}"):
        read_yaml(file, "the rules", SubmissionError)
    assert time.monotonic() - began < 5.0


@pytest.mark.parametrize("reader", READERS.values(), ids=READERS)
@pytest.mark.parametrize(
    "kind", ["billion laughs", "a long number", "depth", "NUL", "Latin-1", "a tab", "a number as a name", "a character beyond Unicode"]
)
def test_every_reader_says_so_in_words(tmp_path: Path, reader, kind: str) -> None:
    content, said = REFUSED[kind]
    file = tmp_path / "x.yml"
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(GlbenchError, match=said):
        reader(file)


@pytest.mark.parametrize("written", ["2024-02-30", "2024-02-10", "12:30", "0001-01-01 99:99:99"])
@pytest.mark.parametrize("reader", READERS.values(), ids=READERS)
def test_a_date_is_text_and_never_an_error_of_python(tmp_path: Path, reader, written: str) -> None:
    file = tmp_path / "x.yml"
    file.write_text(f"default: {{n_steps: {written}}}\nparameters: {written}\nheating_night: {written}\n", encoding="utf-8")
    assert read_yaml(file, "the rules", SubmissionError)["parameters"] == written
    if reader is READERS["training"]:
        file.write_text(f"default: {{n_timesteps: {written}}}\n", encoding="utf-8")
    with pytest.raises(GlbenchError):
        reader(file)


def test_a_folder_and_a_missing_file_are_told(tmp_path: Path) -> None:
    for place in (tmp_path, tmp_path / "none.yml"):
        with pytest.raises(SubmissionError, match=r"^Cannot read the rules "):
            read_yaml(place, "the rules", SubmissionError)


def test_what_ships_reads_as_before() -> None:
    files = sorted(data_folder("baselines").rglob("*.yml"))
    assert len(files) > 20
    for file in files:
        assert read_yaml(file, "it", SubmissionError) == yaml.safe_load(file.read_text(encoding="utf-8")), file
