"""Small files that would become large in memory: they end in a sentence before they do."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

import pytest
from pydantic import TypeAdapter, ValidationError

from glbench.agents.card import Names, Numbers
from glbench.episodes.action_log import RunTable
from glbench.errors import GlbenchError, ResultError
from glbench.evaluation import Result, load_result
from glbench.evaluation.profiles import profile_path
from glbench.evaluation.profiles.record import _Lines, read_profile
from glbench.evaluation.records import EvaluationRecord
from glbench.realism.comparison import read_comparison
from glbench.resources import data_folder
from glbench.settings import read_toml
from glbench.speed.record import read_record
from glbench.tasks import get_task
from glbench.training.card import read_card
from glbench.untrusted import MOST_MARKS, parse_json


@pytest.mark.parametrize("part", ["{}", "[]", '{"a":1}'])
@pytest.mark.parametrize("kind", [str, str.encode], ids=["text", "bytes"])
def test_a_text_of_too_many_small_parts_is_not_parsed(part, kind) -> None:
    text = "[" + ",".join([part] * MOST_MARKS) + "]"
    with pytest.raises(ValueError, match="objects, lists and keys"):
        parse_json(kind(text))


def test_a_long_list_of_numbers_is_no_crowd() -> None:
    assert len(parse_json("[" + "1," * MOST_MARKS + "1]")) == MOST_MARKS + 1


@pytest.mark.parametrize(
    ("kind", "document"),
    [
        (EvaluationRecord, {"seeds": ["x"] * 1000}),
        (Result, {"runs": [0] * 1000}),
        (RunTable, {"runs": [0] * 1000}),
        (_Lines, {"resolution": 1.0, "values": [["x"] * 1000] * 1000}),
        (Names, [0] * 1000),
        (Numbers, ["x"] * 1000),
    ],
)
def test_of_a_list_of_wrong_items_only_the_first_is_told(kind, document) -> None:
    with pytest.raises(ValidationError) as caught:
        TypeAdapter(kind).validate_json(json.dumps(document))
    assert sum(1000 in place or 1 in place for place in (problem["loc"] for problem in caught.value.errors())) == 0


def test_a_small_profile_of_many_wrong_cells_is_refused(tmp_path: Path) -> None:
    path = profile_path(tmp_path / "x.json")
    path.write_bytes(gzip.compress(b'{"schema":"glbench/profile","x":[' + b"{}," * MOST_MARKS + b"{}]}"))
    assert path.stat().st_size < 10_000
    with pytest.raises(ResultError, match="objects, lists and keys"):
        read_profile(path)


def test_no_runs_are_no_recorded_actions() -> None:
    with pytest.raises(ValidationError):
        RunTable.model_validate_json(b'{"runs":[]}')


LIBRARY_TEXT = ("set_int_max", "codec", "Errno", "zlib", "decompressing", "gzipped", "recursion")
CONTENTS = {
    "digits in JSON": b'{"schema": ' + b"9" * 5000 + b"}",
    "digits in TOML": b"id = " + b"9" * 5000,
    "Latin-1": b'{"schema": "caf\xe9"}',
    "UTF-16": '{"schema": 1}'.encode("utf-16"),
    "depth in JSON": b"[" * 100_000,
    "depth in TOML": b"a = " + b"[" * 100_000,
    "no name": b" = ",
    "zeros": b"\0" * 100,
    "half a gzip file": gzip.compress(b"x" * 1000)[:20],
    "a damaged gzip file": gzip.compress(b"x" * 1000)[:12] + b"xxxxxxxxx",
}


@pytest.mark.parametrize("content", [*CONTENTS, "a loop", "a folder"])
@pytest.mark.parametrize(
    "reader", [load_result, get_task, read_toml, read_profile, read_comparison, read_card, read_record],
    ids=lambda reader: reader.__module__,
)  # fmt: skip
def test_no_words_of_a_library_reach_who_reads_a_damaged_file(tmp_path: Path, reader, content: str) -> None:
    path = tmp_path / ("x.toml" if reader is get_task else "x.json")
    if content == "a loop":
        path.symlink_to(path)
    elif content == "a folder":
        path.mkdir()
    else:
        path.write_bytes(CONTENTS[content])
    with pytest.raises(GlbenchError) as caught:
        reader(str(path) if reader is get_task else path)
    assert not [words for words in LIBRARY_TEXT if words in str(caught.value)], str(caught.value)


def test_a_wrong_value_is_placed_without_functions_of_a_library(tmp_path: Path) -> None:
    document = json.loads((data_folder("reports/released/results") / "Spring-v1" / "rule_based.json").read_bytes())
    document["evaluation"]["kernel"]["method"] = []
    path = tmp_path / "x.json"
    path.write_text(json.dumps(document), encoding="utf-8")
    with pytest.raises(ResultError, match=r"evaluation\.kernel\.method: ") as caught:
        load_result(path)
    assert "function" not in str(caught.value)


def test_a_byte_order_mark_is_told_without_advice_on_codecs(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    path.write_bytes(b"\xef\xbb\xbf{}")
    with pytest.raises(ResultError, match="begins with a byte order mark: save it as UTF-8 without one"):
        load_result(path)
