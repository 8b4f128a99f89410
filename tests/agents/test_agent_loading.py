"""Loading submissions and baselines: what works, what is refused and how, and that nothing is left behind."""

from __future__ import annotations

import hashlib
import re
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from glbench.agents import Agent, PerRunAgent, PrivilegedController, identify, load_agent, read_baseline
from glbench.errors import SubmissionError
from glbench.resources import data_folder
from glbench.tasks import TaskCard

Write = Callable[[str, str], Path]

STILL = """
import numpy as np

class Still:
    def reset(self, task, n_runs): self.shape = (n_runs, len(task.actions))
    def act(self, observations): return np.zeros(self.shape)

def make_agent(task):
    return Still()
"""


def refusal(ref: str | Path, card: TaskCard | None = None) -> str:
    """The message with which loading, or making, is refused."""
    with pytest.raises(SubmissionError) as caught:
        load_agent(ref).make(card)  # type: ignore[arg-type]
    return str(caught.value)


def test_a_file_with_make_agent_is_a_submission(write: Write, card: TaskCard) -> None:
    loaded = load_agent(write("still.py", STILL))
    assert (loaded.name, loaded.kind, loaded.privileged) == ("still", "submission", False)
    assert loaded.information == "observations and the public task card"
    agent = loaded.make(card)
    assert isinstance(agent, Agent)
    agent.reset(card, 4)
    assert agent.act(np.zeros((4, 22), dtype=np.float32)).shape == (4, 6)


def test_a_folder_is_a_submission_with_modules_and_data_of_its_own(write: Write, card: TaskCard) -> None:
    write("mine/helper.py", "FACTOR = 2.0\n")
    write("mine/parts/deep.py", "OFFSET = 1.0\n")
    write("mine/weights.txt", "0.25")
    write(
        "mine/agent.py",
        "from pathlib import Path\nimport helper\nfrom .parts.deep import OFFSET\n"
        "WEIGHT = float((Path(__file__).parent / 'weights.txt').read_text())\n"
        + STILL.replace("np.zeros(self.shape)", "np.full(self.shape, helper.FACTOR * WEIGHT - OFFSET)"),
    )
    loaded = load_agent(write("mine/README", "").parent)
    assert loaded.name == "mine"
    agent = loaded.make(card)
    assert isinstance(agent, Agent)
    agent.reset(card, 1)
    assert agent.act(np.zeros((1, 22), dtype=np.float32)).tolist() == [[-0.5] * 6]


def test_loading_leaves_no_bytecode_no_path_and_no_module_names_of_the_submission(write: Write, card: TaskCard) -> None:
    write("mine/helper.py", "VALUE = 1\n")
    folder = write("mine/agent.py", "import helper\n" + STILL).parent
    path, writes_no_bytecode = list(sys.path), sys.dont_write_bytecode
    load_agent(folder).make(card)
    assert sys.path == path
    assert sys.dont_write_bytecode == writes_no_bytecode
    assert not {"helper", "agent", "mine"} & set(sys.modules)
    assert sorted(item.name for item in folder.rglob("*")) == ["agent.py", "helper.py"]


def test_two_submissions_do_not_get_each_others_modules(write: Write, card: TaskCard) -> None:
    agents = {}
    for name, value in (("first", 0.25), ("second", 0.75)):
        write(f"{name}/helper.py", f"VALUE = {value}\n")
        code = "import helper\n" + STILL.replace("np.zeros(self.shape)", "np.full(self.shape, helper.VALUE)")
        agents[name] = load_agent(write(f"{name}/agent.py", code).parent).make(card)
    for name, value in (("first", 0.25), ("second", 0.75)):
        agent = agents[name]
        assert isinstance(agent, Agent)
        agent.reset(card, 1)
        assert agent.act(np.zeros((1, 22), dtype=np.float32))[0, 0] == value


def test_an_imported_module_of_the_same_name_comes_back(write: Write) -> None:
    write("mine/yaml.py", "MINE = True\n")
    import yaml

    load_agent(write("mine/agent.py", "import yaml\nassert yaml.MINE\n" + STILL).parent)
    assert sys.modules["yaml"] is yaml


def test_dataclasses_work_in_a_submission(write: Write, card: TaskCard) -> None:
    code = "from __future__ import annotations\nfrom dataclasses import dataclass\n@dataclass\nclass S:\n    a: int = 1\n"
    load_agent(write("still.py", code + STILL)).make(card)


def test_the_digest_covers_every_file_and_its_name_but_no_caches(write: Write) -> None:
    folder = write("mine/agent.py", STILL).parent
    first = load_agent(folder).digest
    write("mine/__pycache__/agent.cpython-311.pyc", "x")
    write("mine/.DS_Store", "x")
    assert load_agent(folder).digest == first
    weights = write("mine/weights.txt", "1")
    second = load_agent(folder).digest
    weights.rename(folder / "other.txt")
    assert len({first, second, load_agent(folder).digest}) == 3


def test_a_changed_file_is_read_anew(write: Write, card: TaskCard) -> None:
    before = load_agent(write("still.py", STILL))
    after = load_agent(write("still.py", STILL.replace("np.zeros", "np.ones ")))
    assert before.digest != after.digest
    agent = after.make(card)
    assert isinstance(agent, Agent)
    agent.reset(card, 1)
    assert agent.act(np.zeros((1, 22), dtype=np.float32)).tolist() == [[1.0] * 6]


def test_a_missing_file_is_named_with_its_nearest_neighbour(write: Write) -> None:
    folder = write("still.py", STILL).parent
    assert "Did you mean 'still.py'?" in refusal(folder / "stil.py")
    assert "still.py" not in refusal(folder / "other.py")


def test_a_word_that_is_no_baseline_is_answered_with_the_baselines() -> None:
    message = refusal("rule_base")
    assert "neither a file or folder here nor a baseline" in message
    assert "Did you mean 'rule_based'" in message
    assert refusal("nothere").count("rule_based_fair") == 1


@pytest.mark.parametrize("ref", [None, 3, ["rule_based"]])
@pytest.mark.parametrize("load", [load_agent, identify, read_baseline])
def test_what_is_no_name_is_refused(load: Callable[[Any], object], ref: object) -> None:
    with pytest.raises(SubmissionError, match=re.escape(f"got {ref!r}")):
        load(ref)


def test_a_folder_without_agent_file_is_refused(tmp_path: Path) -> None:
    assert "it has no agent.py" in refusal(tmp_path)


def test_a_file_that_is_not_python_is_refused(write: Write) -> None:
    assert "no Python file" in refusal(write("agent.txt", STILL))


def test_a_syntax_error_is_shown_with_its_line(write: Write) -> None:
    message = refusal(write("broken.py", "import numpy\ndef make_agent(task:\n    return 1\n"))
    assert message.startswith("broken.py is no valid Python: SyntaxError")
    assert "broken.py:2" in message


def test_an_error_while_loading_is_shown_with_its_line(write: Write) -> None:
    before = set(sys.modules)
    message = refusal(write("broken.py", "import numpy\n\nx = 1 / 0\n"))
    assert "fails while it is loaded: ZeroDivisionError: division by zero (broken.py:3" in message
    assert not [name for name in set(sys.modules) - before if name.startswith("_glbench_submission")]


def test_a_submission_that_ends_the_program_is_refused(write: Write) -> None:
    assert "SystemExit" in refusal(write("quits.py", "import sys\nsys.exit(3)\n"))


def test_a_missing_library_is_told_apart_from_a_neighbouring_file(write: Write) -> None:
    assert "Install 'no_such_library'" in refusal(write("one.py", "import no_such_library\n" + STILL))
    write("neighbour.py", "")
    message = refusal(write("two.py", "import neighbour\n" + STILL))
    assert "one file cannot import its neighbours" in message
    assert "submit the folder" in message


@pytest.mark.parametrize(
    ("code", "complaint"),
    [
        ("", "has no function make_agent(task)"),
        ("def make_agnet(task): pass", "Did you mean 'make_agnet'"),
        ("make_agent = 3", "make_agent in mine.py is an object of type int"),
        ("def make_agent(): pass", "wrong signature (): it is called as make_agent(task)"),
        ("def make_agent(task, config): pass", "wrong signature (task, config)"),
        ("def make_agent(task): pass", "returns nothing"),
        ("class A: pass\ndef make_agent(task): return A", "returns the class A, expected an instance"),
        ("class A: pass\ndef make_agent(task): return A()", "without reset(task, n_runs) and act(observations)"),
        ("class A:\n  def reset(self, t, n): pass\ndef make_agent(task): return A()", "without act(observations)"),
        ("class A:\n  def act(self, o): pass\ndef make_agent(task): return A()", "without reset(task, n_runs)"),
        (
            "class A:\n  def reset(self): pass\n  def act(self, o): pass\ndef make_agent(task): return A()",
            "reset of the agent A in mine.py has the wrong signature (): it is called as reset(task, n_runs)",
        ),
        (
            "class A:\n  def reset(self, t, n): pass\n  def act(self): pass\ndef make_agent(task): return A()",
            "act of the agent A in mine.py has the wrong signature (): it is called as act(observations)",
        ),
        (
            "class A:\n  single_run = True\n  def reset(self, t, n): pass\n  def act(self, o): pass\ndef make_agent(task): return A()",
            "it is called as reset(task)",
        ),
        (
            "class A:\n  privileged = True\n  def reset(self, t, n): pass\n  def controls(self, x, d, h, n): pass\n"
            "def make_agent(task): return A()",
            "submissions see observations and the public task card only",
        ),
        ("def make_agent(task):\n  raise ValueError('no weights')", "fails: ValueError: no weights (mine.py:2, in make_agent)"),
        ("def make_agent(task):\n  exit()", "SystemExit"),
    ],
)
def test_what_is_wrong_with_a_submission_is_said_in_words(write: Write, card: TaskCard, code: str, complaint: str) -> None:
    assert complaint in refusal(write("mine.py", code + "\n"), card)


def test_the_place_of_an_error_is_in_the_submission_not_in_a_library(write: Write, card: TaskCard) -> None:
    code = "import numpy as np\ndef make_agent(task):\n    return np.linalg.inv(np.zeros((2, 3)))\n"
    assert "(mine.py:3, in make_agent)" in refusal(write("mine.py", code), card)


def test_names_that_cannot_be_filed_are_refused(write: Write) -> None:
    assert "cannot be the name of an agent" in refusal(write("my agent.py", STILL))
    assert "is the name of a baseline" in refusal(write("rule_based.py", STILL))


def test_links_that_a_digest_would_not_cover_are_refused(write: Write, tmp_path: Path) -> None:
    folder = write("mine/agent.py", STILL).parent
    (folder / "data").symlink_to(tmp_path)
    assert "is a link to a folder" in refusal(folder)


def test_files_that_cannot_be_read_are_explained(write: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(path: Path, *_: object) -> int:
        raise PermissionError(13, "Permission denied", str(path))

    path = write("still.py", STILL)
    monkeypatch.setattr("glbench.agents.identity.os.open", refuse)
    assert "still cannot be read: Permission denied" in refusal(path)


def test_single_run_agents_are_made_once_a_run(write: Write, card: TaskCard) -> None:
    code = (
        "import numpy as np\nmade = []\nclass One:\n  single_run = True\n  def reset(self, task): self.number = len(made)\n"
        "  def act(self, o): return np.zeros(6)\ndef make_agent(task):\n  made.append(One())\n  return made[-1]\n"
    )
    agent = load_agent(write("one.py", code)).make(card)
    assert isinstance(agent, PerRunAgent)
    agent.reset(card, 3)
    module = sys.modules[type(agent.agents[0]).__module__]
    assert list(agent.agents) == module.made
    assert len(module.made) == 3


def test_the_baselines_are_loaded_by_name(card: TaskCard) -> None:
    published, fair = load_agent("rule_based"), load_agent("rule_based_fair")
    assert (published.kind, published.privileged, fair.privileged) == ("baseline", True, False)
    assert published.information.startswith("privileged: true state")
    assert isinstance(published.make(card), PrivilegedController)
    assert isinstance(fair.make(card), Agent)
    assert published.digest != fair.digest


def test_settings_of_ones_own_make_another_controller(tmp_path: Path) -> None:
    shutil.copytree(data_folder("baselines") / "rule_based", tmp_path / "warmer")
    settings = tmp_path / "warmer" / "rule_based.yml"
    settings.write_text(settings.read_text(encoding="utf-8").replace("heating_day: 19.5", "heating_day: 21.0"))
    own = load_agent(tmp_path / "warmer")
    assert (own.name, own.kind, own.privileged) == ("warmer", "submission", True)
    assert own.digest != load_agent("rule_based").digest


def test_the_words_of_a_card_do_not_change_the_digest_of_a_baseline(tmp_path: Path) -> None:
    shutil.copytree(data_folder("baselines") / "rule_based", tmp_path / "copy")
    card_file = tmp_path / "copy" / "card.toml"
    card_file.write_text(card_file.read_text(encoding="utf-8").replace("Dutch", "Danish"), encoding="utf-8")
    assert load_agent(tmp_path / "copy").digest == load_agent("rule_based").digest


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (lambda text: text.replace('controller = "rule_based"', 'controller = "magic"'), "'controller'"),
        (lambda text: text.replace('title = "', 'titel = "'), "'title'"),
        (lambda text: text.replace('"rule_based.yml"', '"none.yml"'), "Cannot read the rule settings"),
        (lambda text: "title = ", "Cannot read the card"),
    ],
)  # fmt: skip
def test_cards_that_make_no_sense_are_explained(tmp_path: Path, change: Callable[[str], str], complaint: str) -> None:
    shutil.copytree(data_folder("baselines") / "rule_based", tmp_path / "copy")
    card_file = tmp_path / "copy" / "card.toml"
    card_file.write_text(change(card_file.read_text(encoding="utf-8")), encoding="utf-8")
    assert complaint in refusal(tmp_path / "copy")


def test_the_digest_of_a_single_file_is_that_of_its_name_and_bytes(write: Write) -> None:
    name, content = b"still.py", STILL.encode()
    expected = hashlib.sha256(len(name).to_bytes(8, "big") + name + len(content).to_bytes(8, "big") + content).hexdigest()
    assert load_agent(write("still.py", STILL)).digest == expected
