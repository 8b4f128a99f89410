"""Actions that are no real numbers, and files of arrays that are no policy, no plans and no recording: each ends in words."""

from __future__ import annotations

import io
import tracemalloc
import warnings
import zipfile
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from glbench.agents.network_policy import read_actor, read_policy
from glbench.agents.plans import read_book, read_recording
from glbench.agents.protocol import PerRunAgent, read_actions
from glbench.arrays import ArrayFile, real_numbers
from glbench.env import GreenhouseEnv, GreenhouseVectorEnv
from glbench.errors import ActionError, SubmissionError
from glbench.resources import data_folder
from glbench.tasks import DEFAULT_TASK, get_task, task_card


class Refuses:
    """Raises whatever it is told to when somebody makes an array of it."""

    def __init__(self, error: Exception) -> None:
        self._error = error

    def __array__(self, *_: object, **__: object) -> NDArray[Any]:
        raise self._error


ODD = {
    "masked": np.ma.masked_array(np.zeros(6), [True] + [False] * 5),
    "a wrong key": Refuses(KeyError("x")),
    "a broken disk": Refuses(OSError("x")),
    "a division": Refuses(ZeroDivisionError("x")),
    "huge": [10**400] + [0] * 5,
    "beyond 64 bits": [2**70] + [0] * 5,
    "complex": np.zeros(6, complex),
    "complex list": [0j] * 6,
    "dates": np.zeros(6, "datetime64[s]"),
    "durations": np.zeros(6, "timedelta64[s]"),
    "text": ["0"] * 6,
    "text array": np.array(["0.5"] * 6),
    "bytes": np.array([b"0"] * 6),
    "truth": np.zeros(6, bool),
    "truth list": [False] * 6,
    "truth among numbers": [0.0, True, 0.0, 0.0, 0.0, 0.0],
    "truth of numpy among numbers": (np.float64(0.0), np.True_, 0.0, 0.0, 0.0, 0.0),
    "objects": np.zeros(6, object),
    "decimals": [Decimal(0)] * 6,
    "nothing": [None] * 6,
    "a structure": np.zeros(6, [("a", "f8")]),
    "ragged": [0.0, [0.0], 0.0, 0.0, 0.0, 0.0],
    "a dictionary": {"uBoil": 0.0},
}
PLAIN = [[0] * 6, [0.0] * 6, np.zeros(6, np.float16), np.zeros(6, np.int8), np.zeros(6, np.uint64), (np.float32(0.0),) * 6]


@pytest.mark.parametrize("action", ODD.values(), ids=ODD)
def test_an_action_that_is_no_row_of_real_numbers_is_refused_everywhere(action: object) -> None:
    task = get_task(DEFAULT_TASK)
    single, both = GreenhouseEnv(task), GreenhouseVectorEnv(task, 2)
    single.reset(seed=1)
    both.reset(seed=1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(ActionError, match="not real numbers"):
            single.step(action)  # type: ignore[arg-type]
        with pytest.raises(ActionError, match="not real numbers"):
            both.step([action, action])  # type: ignore[arg-type]
        if type(action) is np.ndarray:
            with pytest.raises(ActionError, match=r"array of .* not real numbers"):
                both.step(np.stack([action, action]))
        card = task_card(task)
        assert read_actions([action], card, 1)[1]
        agent = PerRunAgent(lambda _task: Answers(action))
        agent.reset(card, 1)
        with pytest.raises(ActionError, match="Expected a row of real numbers"):
            agent.act(np.zeros((1, len(card.observation_names)), np.float32))


@pytest.mark.skipif(np.finfo(np.longdouble).max <= np.finfo(np.float64).max, reason="longdouble is float64 here")
def test_a_number_beyond_float64_is_refused_without_a_warning() -> None:
    action = np.full(6, np.longdouble("1e4000"))
    environment = GreenhouseEnv(get_task(DEFAULT_TASK))
    environment.reset(seed=1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(ActionError, match="inf, which is not a finite number"):
            environment.step(action)  # type: ignore[arg-type]
        assert np.isinf(read_actions([action], task_card(get_task(DEFAULT_TASK)), 1)[0]).all()


def test_one_row_of_truth_or_with_masked_entries_among_rows_of_numbers_is_refused() -> None:
    both = GreenhouseVectorEnv(get_task(DEFAULT_TASK), 2)
    both.reset(seed=1)
    masked = np.ma.masked_array(np.zeros(6), [True] + [False] * 5)
    for row in (np.zeros(6, bool), [False] * 5 + [0.0], masked):
        with pytest.raises(ActionError, match="not real numbers"):
            both.step([np.zeros(6), row])  # type: ignore[arg-type]


def test_an_action_that_is_no_numbers_is_one_row_and_how_to_make_it() -> None:
    environment = GreenhouseEnv(get_task(DEFAULT_TASK))
    environment.reset(seed=1)
    with pytest.raises(ActionError, match=r"\(list\).*Expected shape \(6,\): uBoil.*detach\(\)"):
        environment.step([Decimal(0)] * 6)  # type: ignore[arg-type]


class Answers:
    """An agent that always gives the same answer."""

    def __init__(self, answer: object) -> None:
        self._answer = answer

    def reset(self, task: object) -> None:
        """Begin."""

    def act(self, observation: NDArray[np.float32]) -> Any:
        """The answer."""
        return self._answer


def test_every_kind_of_real_number_gives_the_same_step() -> None:
    environment = GreenhouseEnv(get_task(DEFAULT_TASK))
    seen = set()
    for action in PLAIN:
        environment.reset(seed=1)
        assert real_numbers(action) is not None
        observation, reward, *_ = environment.step(action)  # type: ignore[arg-type]
        seen.add((observation.tobytes(), reward))
    assert len(seen) == 1


POLICY = data_folder("baselines") / "ppo" / "weights" / "delta20.npz"
ACTOR = next((data_folder("baselines") / "ppo_fast").rglob("*.npz"))
BOOK = data_folder("baselines") / "best_known" / "plans" / "Schiphol2010-Delta10-v1.npz"
RECORDING = data_folder("baselines") / "recording" / "actions.npz"
READERS = {
    "policy": (read_policy, POLICY, "not a glbench policy"),
    "actor": (read_actor, ACTOR, "not a glbench policy"),
    "book": (read_book, BOOK, "no book of plans"),
    "recording": (read_recording, RECORDING, "not a recording of actions"),
}


def changed(file: Path, to: Path, **entries: Any) -> Path:
    """A copy of a file of arrays with some entries replaced, or left out where they are None."""
    with np.load(file) as arrays:
        content = {name: arrays[name] for name in arrays.files} | entries
    np.savez_compressed(to, **{name: array for name, array in content.items() if array is not None})
    return to


def written(to: Path, **members: bytes) -> Path:
    """An archive with these members."""
    with zipfile.ZipFile(to, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(f"{name}.npy", content)
    return to


def npy(header: str, content: bytes = b"") -> bytes:
    text = header.encode("latin1") + b"\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + content


DAMAGED = {
    "a huge shape": npy("{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,)}"),
    "a negative shape": npy("{'descr': '<f8', 'fortran_order': False, 'shape': (-1,)}"),
    "an endless shape": npy("{'descr': '<f8', 'fortran_order': False, 'shape': (10**400,)}"),
    "a nested header": npy("(" * 9000),
    "a header that is no table": npy("[1]"),
    "no width": npy("{'descr': '<U0', 'fortran_order': False, 'shape': (100000000000,)}"),
    "objects": npy("{'descr': '|O', 'fortran_order': False, 'shape': ()}", b"\x80\x04N."),
    "a number with a sign of length": npy("{'descr': '<f8', 'fortran_order': False, 'shape': 1}", b"\0" * 8),
    "no header": b"hello",
    "nothing": b"",
}


@pytest.mark.parametrize(("reader", "file", "said"), READERS.values(), ids=READERS)
class TestFiles:
    """Files for each reader."""

    @pytest.mark.parametrize("content", DAMAGED.values(), ids=DAMAGED)
    def test_a_damaged_entry_is_told(self, tmp_path: Path, reader, file: Path, said: str, content: bytes) -> None:
        with pytest.raises(SubmissionError, match=f"{said}.* not an array of plain numbers"):
            reader(written(tmp_path / "x.npz", format=content, low=content))

    def test_what_unpacks_to_much_more_is_not_unpacked(self, tmp_path: Path, reader, file: Path, said: str) -> None:
        bomb = changed(file, tmp_path / "x.npz", weight_0=np.zeros((300 * 2**20,), np.uint8))
        assert bomb.stat().st_size < 8 * 2**20
        tracemalloc.start()
        try:
            with pytest.raises(SubmissionError, match=r"unpacks to more than (64|256) MiB"):
                reader(bomb)
            assert tracemalloc.get_traced_memory()[1] < 32 * 2**20
        finally:
            tracemalloc.stop()

    @pytest.mark.parametrize(
        ("name", "value"),
        [
            ("low", np.array([0.5 + 1j])),
            ("low", np.array(["a"])),
            ("low", np.zeros((2, 2))),
            ("low", None),
            ("low", np.full(6, np.nan)),
            ("low", np.full(6, 9.0)),
            ("high", np.full(6, np.inf)),
            ("high", np.zeros(100)),
        ],
    )
    def test_bounds_that_are_none_are_told(self, tmp_path: Path, reader, file: Path, said: str, name: str, value: Any) -> None:
        with pytest.raises(SubmissionError, match=said):
            reader(changed(file, tmp_path / "x.npz", **{name: value}))

    def test_a_folder_and_no_archive_are_told(self, tmp_path: Path, reader, file: Path, said: str) -> None:
        (tmp_path / "x.npz").write_bytes(b"PK\x05\x06" + b"\0" * 18)
        for place in (tmp_path, tmp_path / "x.npz", tmp_path / "none.npz"):
            with pytest.raises(SubmissionError):
                reader(place)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("scale", np.zeros(22)),
        ("scale", np.full(22, -1.0)),
        ("mean", np.full(22, np.nan)),
        ("clip", np.float64(np.nan)),
        ("clip", np.float64(0.0)),
        ("clip", np.zeros(3)),
        ("delta", np.float64(np.inf)),
        ("format", np.array([1, 1])),
        ("format", np.float64(1.0)),
        ("weight_0", np.full((22, 256), np.nan, np.float32)),
        ("weight_0", np.zeros((22, 256), np.uint8)),
        ("weight_0", None),
        ("observation_names", np.array("x")),
        ("observation_names", np.arange(22)),
        ("about", np.array("[" * 100_000)),
        ("about", np.array('{"a": [1]}')),
        ("about", np.array('{"a": NaN}')),
        ("about", np.array("1" * 5000)),
        ("about", np.array("[]")),
        ("activation", np.array("eval")),
        ("output", np.array(["clip"])),
    ],
)
def test_a_policy_that_cannot_be_is_refused(tmp_path: Path, name: str, value: Any) -> None:
    with pytest.raises(SubmissionError, match="not a glbench policy"):
        read_policy(changed(POLICY, tmp_path / "x.npz", **{name: value}))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("facts", np.array("[" * 100_000)),
        ("facts", np.array("{}")),
        ("facts", np.array('{"task": 1, "digest": 2, "split": 3, "actuation": 4, "about": 5}')),
        ("seeds", np.zeros(30, np.uint64)),
        ("seeds", np.arange(30.0)),
        ("places", np.full(30, -1)),
        ("actions", np.full((30, 6, 5), 65535, np.uint16)),
        ("actions", np.zeros((30, 6, 5))),
    ],
)
def test_a_book_that_cannot_be_is_refused(tmp_path: Path, name: str, value: Any) -> None:
    with pytest.raises(SubmissionError, match="no book of plans"):
        read_book(changed(BOOK, tmp_path / "x.npz", **{name: value}))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("shares", np.array([np.nan])),
        ("max_change", np.full(6, np.inf)),
        ("traced", np.array([0.0])),
        ("traced", np.array([10**6])),
        ("gru_bias", np.zeros(3, np.float32)),
        ("network", np.zeros(3, np.uint8)),
    ],
)
def test_an_actor_that_cannot_be_is_refused(tmp_path: Path, name: str, value: Any) -> None:
    with pytest.raises(SubmissionError, match=r"not a (glbench )?policy"):
        read_actor(changed(ACTOR, tmp_path / "x.npz", **{name: value}))


def test_what_ships_reads_as_numpy_reads_it() -> None:
    files = sorted(data_folder("baselines").rglob("*.npz"))
    assert len(files) > 30
    for file in files:
        ours = ArrayFile.at(file, 256 * 2**20)
        with np.load(file) as theirs:
            for name in theirs.files:
                np.testing.assert_array_equal(ours._arrays[name], theirs[name])
                assert ours._arrays[name].dtype == theirs[name].dtype


def test_an_array_in_columns_is_read_in_columns() -> None:
    file = io.BytesIO()
    np.savez(file, a=np.asfortranarray(np.arange(6.0).reshape(2, 3)))
    np.testing.assert_array_equal(ArrayFile.of(file.getvalue()).floats("a", 2), np.arange(6.0).reshape(2, 3))


def packed(method: int = zipfile.ZIP_DEFLATED, **entries: bytes) -> bytes:
    """An archive of entries as they are given."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as archive:
        for name, content in entries.items():
            archive.writestr(name, content)
    return file.getvalue()


def test_an_entry_that_unpacks_to_more_than_it_says_takes_no_memory() -> None:
    data = bytearray(packed(a=bytes(200 * 2**20)))
    at = data.rfind(b"PK\1\2") + 24
    data[at : at + 4] = (100).to_bytes(4, "little")
    tracemalloc.start()
    with pytest.raises(ValueError, match=r"damaged|only part|not an array"):
        ArrayFile.of(bytes(data))
    assert tracemalloc.get_traced_memory()[1] < 20e6
    tracemalloc.stop()


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_only_what_numpy_packs_is_unpacked(method: int) -> None:
    with pytest.raises(ValueError, match="packed in another way"):
        ArrayFile.of(packed(method, a=b""))


def test_two_names_of_one_array_are_refused() -> None:
    with pytest.raises(ValueError, match="an array occurs twice"):
        ArrayFile.of(packed(**{"a.npy": b"", "a": b""}))


def test_half_a_character_is_no_text() -> None:
    with pytest.raises(ValueError, match="invalid characters"):
        ArrayFile({"a": np.array("x\ud800")}).text("a")
