"""Pictures of a run of a task with a camera: in its record, in the viewer, in its profile and on the page."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from glbench.episodes import read_episode
from glbench.episodes.rerun_recording import _Layout, save_recording, shown_of
from glbench.errors import ResultError
from glbench.evaluation import evaluate, load_result
from glbench.evaluation.profiles import load_profile, make_profile, profile_path
from glbench.evaluation.profiles.record import Profile
from glbench.evaluation.saving import recorded_actions
from glbench.report.profile_encoding import embedded_profile
from glbench.tasks import TaskSpec, resolver
from glbench.vision.library import Library
from tests.scenes import lettuce_seen, small_library

SHORT = "[weather]\ndays = 15\nstep_seconds = 3600\n[evaluation]\nruns = 2\n"

CALM = """
import numpy as np
class Calm:
    def reset(self, task, n_runs):
        self.zeros = np.zeros((n_runs, len(task.action_names)))
    def act(self, observations):
        return self.zeros
def make_agent(task):
    return Calm()
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[TaskSpec, Path]]:
    """The task, and the result of an agent that does nothing, in two runs of 15 days."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Library, "open", small_library)
        resolver._library.cache_clear()
        folder = tmp_path_factory.mktemp("pictures")
        task = lettuce_seen(folder, "small-3", SHORT)
        (folder / "calm.py").write_text(CALM, encoding="utf-8")
        evaluate(task, folder / "calm.py", out=folder, episodes="all")
        (path,) = folder.rglob("calm.json")
        yield task, path
    resolver._library.cache_clear()


def test_a_record_says_which_scene_is_shown_and_the_viewer_shows_it(made: tuple[TaskSpec, Path], tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="the viewer (rerun-sdk) is not installed")
    from rerun.chunk import RrdReader

    _, path = made
    library = small_library("small", "3")
    file = next(path.parents[2].rglob("seed-*.mcap"))
    episode = read_episode(file)
    scenes = episode["scene"].astype(int)
    heads = episode["head"]
    assert np.abs(library.truth["mass"][scenes[24:]] - heads[24:]).max() < 40.0
    runs = shown_of([episode])
    save_recording(runs, tmp_path / "seen.rrd")
    sent = {}
    for chunk in RrdReader(tmp_path / "seen.rrd").stream():
        if str(chunk.entity_path).startswith("/pictures"):
            batch = chunk.to_record_batch()
            for step, buffer in zip(batch.column("step").to_pylist(), batch.column("Image:buffer").to_pylist(), strict=True):
                sent[int(step)] = np.array(buffer[0], np.uint8).reshape(8, 8, 3)
    changes = [0, *(step for step in range(2, episode.steps + 1) if scenes[step - 1] != scenes[step - 2])]
    assert sorted(sent) == changes
    assert len(changes) > 5
    for step, image in sent.items():
        assert (image == library.image(int(scenes[max(step - 1, 0)]))).all()
    beside = _Layout(runs, live=False).overview().contents[0]
    (view,) = beside.contents[1].contents
    assert view.origin == "/pictures/calm"


def test_the_page_has_a_picture_of_each_week_of_the_worst_run(made: tuple[TaskSpec, Path]) -> None:
    task, path = made
    result, library = load_result(path), small_library("small", "3")
    profile = load_profile(result, path)
    assert profile is not None
    worst = read_episode(next(path.parents[2].rglob(f"seed-{profile.document['seeds']['worst']}.mcap")))
    weekly = [int(worst["scene"][24 * day - 2]) for day in (1, 8, 15)]
    assert profile.document["pictures"] == weekly
    again = make_profile(recorded_actions(result, path).task().scored_in(result.task.split), result, recorded_actions(result, path), None)
    assert again.to_bytes() == profile_path(path).read_bytes()
    for scene, address in zip(weekly, embedded_profile(profile, task, result.task)["pictures"], strict=True):
        kind, content = address.split(",")
        assert kind == "data:image/webp;base64"
        image = np.asarray(Image.open(io.BytesIO(base64.b64decode(content))), int)
        assert np.array_equal(image, library.image(scene))
    strange = Profile({**profile.document, "pictures": [10**6]})
    profile_path(path).write_bytes(strange.to_bytes())
    with pytest.raises(ResultError, match="its pictures are none of the library's"):
        load_profile(result.model_copy(update={"profile": None}), path)
