"""``glbench view``: recorded runs in the Rerun viewer, side by side."""

from __future__ import annotations

import contextlib
import datetime as dt
import tempfile
import time
import webbrowser
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from glbench.cli.console import count, messages, print_warning, quoted, tell
from glbench.cli.options import OneTask, check_file, result_file, task_or_default
from glbench.errors import EpisodeError, refuse

if TYPE_CHECKING:
    from glbench.episodes import Episode
    from glbench.episodes.rerun_viewer import LiveView
    from glbench.evaluation import Evaluation

EPISODE_SUFFIX, ACTIONS_SUFFIX = ".mcap", ".actions.mcap"


def view(
    files: Annotated[
        list[str],
        typer.Argument(
            metavar="RESULT|AGENT|FILE",
            help="Results (.json) or agents that have one, of which one run each is shown, or episodes (.mcap); up to six, of one task.",
        ),
    ],
    task: OneTask = None,
    run: Annotated[
        str | None, typer.Option("--run", "-r", help="Which run of each result: best, worst, median, or a seed. Default: median.")
    ] = None,
    first_day: Annotated[
        dt.datetime | None,
        typer.Option("--from", formats=["%Y-%m-%d"], help="First day shown closely. Default: where limits were broken most."),
    ] = None,
    days: Annotated[int, typer.Option("--days", min=1, help="Number of days shown closely.")] = 2,
    save: Annotated[Path | None, typer.Option("--save", "-s", help="Save a recording (.rrd) and open nothing.")] = None,
    picture: Annotated[Path | None, typer.Option("--picture", help="Save a picture (.png) of the overview and open nothing.")] = None,
    web: Annotated[bool, typer.Option("--web", help="Show it in the browser instead of a window.")] = False,
    port: Annotated[
        int | None, typer.Option("--port", min=1, max=65534, help="Port of the page (its data come from the next); implies --web.")
    ] = None,
) -> None:
    """Show what happened in recorded runs: climate within its limits, crop, controls, weather, money and violations.

    Several controllers are laid over each other, one colour each. The viewer listens on this machine only.
    """
    from glbench.episodes import parse_selection, rerun_viewer
    from glbench.episodes.rerun_recording import provenance_words, save_recording, shown_of

    rerun_viewer.viewer_program()
    web = web or port is not None
    if not (web or save or picture):
        rerun_viewer.require_screen()
    if run is not None and all(name.endswith(EPISODE_SUFFIX) and not name.endswith(ACTIONS_SUFFIX) for name in files):
        refuse("--run chooses a run of a result, and an episode (.mcap) is one run. Leave it out.", EpisodeError)
    run = run or "median"
    if run not in {"best", "worst", "median"} and not run.isdecimal():
        parse_selection(run)  # has messages of its own for what is no choice at all
        refuse(f"--run {run} does not choose one run of a result. It is best, worst, median, or a seed.", EpisodeError)
    check_file(save, ".rrd")
    check_file(picture, ".png")
    with messages().status("reading the runs"):
        episodes = [_episode(result_file(name, task), run) for name in files]
        first = None if first_day is None else first_day.date()
        course, words = replace(shown_of(episodes), first_day=first, days=days), provenance_words(episodes)
        if task is not None and course.task.id != task_or_default(task).id:
            refuse(f"The runs are of {course.task.id}, but --task says {task}. Leave out --task.", EpisodeError)
    if save is not None:
        save_recording(course, save, words)
        tell(f"Saved: {save}  (open it with: rerun {quoted(save)})")
    with tempfile.TemporaryDirectory(prefix="glbench-view-") as folder:
        recording = Path(folder) / f"{course.task.short_id}.rrd"
        if picture is not None:
            save_recording(course, recording, words, plain=True)
            rerun_viewer.take_picture(recording, picture)
            tell(f"Saved: {picture}")
        if web:
            save_recording(course, recording, words)
            with rerun_viewer.page_for_browser(recording, port) as (page, _):
                tell(f"Open {page}")
                if rerun_viewer.has_screen():
                    webbrowser.open(page)
                _wait()
        elif save is None and picture is None:
            save_recording(course, recording, words)
            tell("The viewer is open; close its window to end.")
            rerun_viewer.open_window(recording)


@contextlib.contextmanager
def live_viewer() -> Iterator[str]:
    """A viewer for streams: a window, or a page where there is no screen, which then stays until Ctrl-C. Gives its address."""
    from glbench.episodes.rerun_viewer import has_screen, page_for_browser, window_for_stream

    if has_screen():
        yield window_for_stream()
        return
    with page_for_browser(None) as (page, stream):
        tell(f"Live view: {page}")
        yield stream
        _wait()


@contextlib.contextmanager
def live_view(viewer: str | None, evaluation: Evaluation) -> Iterator[LiveView | None]:
    """What streams the first run of ``evaluation`` to the viewer at that address; nothing without one."""
    if viewer is None:
        yield None
        return
    from glbench.episodes.rerun_viewer import LiveView

    with LiveView(evaluation.task, evaluation.agent.name, evaluation.seeds[0], viewer) as live:
        yield live


def _wait() -> None:
    tell("The page is there until Ctrl-C.")
    with contextlib.suppress(KeyboardInterrupt):
        while True:
            time.sleep(3600.0)


def _episode(path: Path, run: str) -> Episode:
    """The episode in a file, or a run of a result: its recorded episode, else the run simulated again from its recorded actions."""
    from glbench.episodes import chosen_rows, episode_path, episodes_folder, read_episode, replayed_episodes
    from glbench.evaluation import load_result
    from glbench.evaluation.saving import recorded_actions, task_of_result

    if path.name.endswith(ACTIONS_SUFFIX):
        owner = path.with_name(path.name.removesuffix(ACTIONS_SUFFIX) + ".json")
        refuse(f"{path} holds the actions of many runs. Give the result that it belongs to: glbench view {quoted(owner)}", EpisodeError)
    if path.suffix == EPISODE_SUFFIX:
        episode = read_episode(path, partial=True)
        if episode.problem is not None:
            print_warning(f"{path}: {episode.problem}. Shown is what is left of it.")
        return episode
    result = load_result(path)
    log = recorded_actions(result, path)
    (row,) = chosen_rows([run], log.seeds, result.values(log.task().evaluation.metric))
    seed = result.runs[row].seed
    which = f"seed {seed}" if run.isdecimal() else f"seed {seed}, the {run} of {count(len(result.runs), 'run')}"
    tell(f"{result.agent.name}: {which}")
    file = episode_path(episodes_folder(path), seed)
    if file.exists():
        episode = read_episode(file)
        if episode.provenance == log.provenance:
            return episode
        print_warning(f"{file} is of another evaluation; the run is simulated again from its recorded actions.")
    return next(iter(replayed_episodes(task_of_result(result, path), log, [row])))
