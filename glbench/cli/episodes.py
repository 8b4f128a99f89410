"""``glbench episodes``: look at records, turn them into tables and datasets, rescue what a killed writer left, make more of them."""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from glbench.cli import console, options
from glbench.cli.bound import dispatch
from glbench.cli.console import Markup, styled
from glbench.cli.progress import Bar
from glbench.errors import EpisodeError, refuse

if TYPE_CHECKING:
    from glbench.episodes import ActionLog, Episode

app = typer.Typer(help="Look at episode records (MCAP), export, recover and make them.", no_args_is_help=True)

File = Annotated[Path, typer.Argument(metavar="FILE", help="An episode record (.mcap).")]
ResultFile = Annotated[Path, typer.Argument(metavar="RESULT", help="A result file (.json) with its recorded actions.")]


@app.command()
def info(file: Annotated[Path, typer.Argument(metavar="FILE", help="An episode, or the recorded actions of a result (.mcap).")]) -> None:
    """Show what a record holds: where it comes from, how the run ended, columns with units."""
    from glbench.episodes import is_action_log, read_episode, read_log

    if is_action_log(file):
        parts = [_facts(log_facts(read_log(file), file))]
    else:
        episode = read_episode(file, partial=True)
        view = console.table("Columns", "Column", "Unit", "Meaning", fold=("Meaning",), title_style=None)
        for group in episode.groups:
            view.add(Markup(styled(group.path, "bold")))
            for column in group.columns:
                view.add(f"  {column.name}", column.unit, column.meaning)
        parts = [_facts(episode_facts(episode, file)), view]
    console.show(console.View(parts))


@app.command()
def export(
    what: Annotated[
        list[str],
        typer.Argument(metavar="FILE | AGENT...", help="An episode record (.mcap) or, with --minari, agents as for glbench evaluate."),
    ],
    to: Annotated[Path | None, typer.Option("--to", help="Table to write from an episode: .parquet or .csv.")] = None,
    minari: Annotated[
        str | None,
        typer.Option("--minari", metavar="DATASET", help="Minari dataset to write from agents, such as glbench/spring/mixed-v0."),
    ] = None,
    task: options.OneTask = None,
    runs: Annotated[int, typer.Option("--runs", "-n", min=1, help="Runs per agent.")] = 10,
    noise: Annotated[
        float,
        typer.Option(
            "--noise", min=0.0, max=2.0, help="Standard deviation of the noise on the agents' actions, relative to half their range."
        ),
    ] = 0.0,
    seed: Annotated[
        int | None, typer.Option("--seed", help="Seed of the first run, 10,000,000,000 or more. Default: 40,000,000,000.")
    ] = None,
    author: Annotated[str | None, typer.Option("--author", help="Author of the dataset, for its metadata.")] = None,
    email: Annotated[str | None, typer.Option("--author-email", help="Address of the author, for its metadata.")] = None,
    permalink: Annotated[
        str | None, typer.Option("--code-permalink", help="Address of the code that made the agents, for its metadata.")
    ] = None,
    sandbox: options.SandboxChoice = options.Sandbox.AUTO,
) -> None:
    """Write an episode as a table, or agents' seasons as a dataset for offline learning.

    FILE --to TABLE writes one row per step: Parquet (with units) or CSV (floats that read back to the same bits).

    AGENT... --minari DATASET runs agents on the training split of a task (the paper's tasks have none: there, on seeds that no task is
    scored with) and writes what a learner in the Gymnasium environment would have seen, done and earned. See docs/offline.md.
    """
    if (to is None) == (minari is None):
        msg = "Say what to write: a table from an episode (--to season.parquet) or a dataset from agents (--minari NAME-v0)."
        raise EpisodeError(msg)
    if to is not None:
        if len(what) != 1:
            refuse(f"--to takes one episode; {len(what)} are named. Export them one by one.", EpisodeError)
        if task or noise or runs != 10 or seed is not None or author or email or permalink:
            refuse(
                "--task, --runs, --noise, --seed and words on a dataset are for --minari. An episode is exported as it is.", EpisodeError
            )
        write_table(Path(what[0]), to)
        return
    assert minari is not None
    about = {"author": author, "author_email": email, "code_permalink": permalink}
    metadata = {name: value for name, value in about.items() if value is not None}
    write_dataset_of(minari, what, task, runs, noise, seed, metadata, sandbox)


def write_table(file: Path, to: Path) -> None:
    """Write an episode as Parquet or CSV, a row per step."""
    from glbench.episodes import read
    from glbench.resources import write_atomically

    if to.suffix not in (".parquet", ".csv"):
        refuse(f"Cannot tell the format of {to}. Give it the ending .parquet or .csv.", EpisodeError)
    frame = read(file)
    if to.suffix == ".csv":
        write_atomically(to, frame.to_csv(lineterminator="\n"))
    else:
        buffer = io.BytesIO()
        frame.to_parquet(buffer)
        write_atomically(to, buffer.getvalue())
    console.tell(f"Written: {to} ({len(frame)} of {frame.attrs['steps']} steps, {frame.shape[1]} columns)")


def write_dataset_of(
    name: str, refs: list[str], task: str | None, runs: int, noise: float, seed: int | None, about: dict[str, str], sandbox: options.Sandbox
) -> None:
    """Run agents on a task and write their seasons as a Minari dataset."""
    with options.needs_the_extra("minari"):
        import minari  # noqa: F401
    from glbench.evaluation import protect
    from glbench.evaluation.minari_dataset import FIRST_SEED, write_dataset

    spec = options.task_or_default(task)
    protected = [protect(ref, sandbox.value) for ref in refs]
    total, completed = runs * len(refs) * spec.steps, 0
    first = FIRST_SEED if seed is None else seed
    columns = "{task.completed:,.0f} of {task.total:,.0f} steps"
    with Bar("running", total, columns, time_left=True) as bar, console.interruption("No dataset was written."):

        def advance(steps: int) -> None:
            nonlocal completed
            completed += steps
            if bar.is_time():
                bar.move(completed)

        result = write_dataset(name, spec, protected, runs, noise=noise, first_seed=first, about=about, progress=advance)
    from glbench.leaderboard.catalogue import catalogue

    score = catalogue(spec).score
    view = console.table(None, "agent", "seasons", score.words, numbers=("seasons", score.words))
    for agent in protected:
        rewards = [season.reward for season in result.seasons if season.agent == agent.agent.name]
        view.add(agent.agent.name, str(len(rewards)), score.number(sum(rewards) / len(rewards)))
    console.put_parts([view])
    console.tell(f'Written: {result.folder} ({result.steps:,} steps, {result.size / 1e6:.1f} MB). Next: minari.load_dataset("{name}")')


@app.command()
def recover(
    file: File,
    to: Annotated[Path | None, typer.Option("--to", help="File to write. Default: FILE with .recovered.mcap as its ending.")] = None,
) -> None:
    """Make a whole file of what a killed writer left. The file itself stays as it is."""
    from glbench.episodes import recover as recover_file

    to = to or file.with_name(file.name.removesuffix(".mcap") + ".recovered.mcap")
    if os.path.realpath(to) == os.path.realpath(file):  # unlike Path.resolve, also for links in a circle
        refuse(f"{to} is the file to recover. Write to another one with --to.", EpisodeError)
    episode = recover_file(file, to)
    lost = episode.run.steps - episode.steps
    problem = f" ({episode.problem})" if episode.problem else ""
    console.tell(f"Recovered {episode.steps} of {episode.run.steps} steps, {lost} are lost{problem}. Written: {to}")


@app.command()
def make(
    result: ResultFile,
    episodes: options.Episodes = "best,worst,median",
    to: Annotated[Path | None, typer.Option("--to", help="Folder to write to. Default: where evaluate puts them.")] = None,
    round_file: options.RoundFile = None,
) -> None:
    """Make full episodes of a stored result by replaying its recorded actions. The agent is not needed."""
    from glbench.episodes import parse_selection
    from glbench.evaluation import load_result
    from glbench.evaluation.saving import make_episodes, task_of_result

    loaded, sealed = load_result(result), options.round_of(round_file)
    with console.messages().status("replaying"):
        files = make_episodes(parse_selection(episodes), loaded, result, task_of_result(loaded, result, sealed), to)
    for file in files:
        console.write(file)
    if not files:
        console.tell(f"--episodes {episodes} chooses no run, so nothing was written.")


@app.command()
def recording(
    result: ResultFile,
    run: Annotated[int, typer.Option("--run", help="Seed of the run whose actions are taken.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder to write, which glbench evaluate runs.")],
) -> None:
    """Make an agent that replays the recorded actions of one run, open loop: what it loses is the value of feedback."""
    from glbench.evaluation.saving import write_recording
    from glbench.registration import task_argument

    actions = write_recording(result, run, out)
    console.write(out)
    next_command = f"glbench evaluate {console.quoted(out)} --task {task_argument(str(actions.about['task']))}"
    console.tell(f"{len(actions.actions)} steps of {actions.about['agent']}. Next: {next_command}")


app.command()(dispatch)


def episode_facts(episode: Episode, file: Path) -> dict[str, str]:
    """Where an episode comes from and how it ended."""
    run, provenance = episode.run, episode.provenance
    there = f"{episode.steps} of {run.steps}" if episode.steps != run.steps else f"{run.steps}"
    facts = {
        "record": f"episode, {file.stat().st_size / 1e6:.2f} MB",
        "task": f"{provenance.task.id} (digest {provenance.task.digest[:12]}...)",
        "agent": f"{provenance.agent.name} (digest {provenance.agent.digest[:12]}...; sees {provenance.agent.information})",
        "seed": str(run.seed),
        "ended": run.status + (f": {run.reason}" if run.reason else ""),
        "steps": f"{there} of {provenance.task.step_seconds:g} s, from {episode.times[0]} to {episode.times[-1]} UTC".replace(
            ".000000000", ""
        ),
        "actions": f"{provenance.agent.acts}, {episode.tables['action'].dtype.name}",
        "kernel": f"{provenance.kernel['backend']}, glbench {provenance.versions['glbench']}",
    }
    if episode.problem:
        facts["damage"] = f"{episode.problem}; `glbench episodes recover {console.quoted(file)}` makes a whole file of what is left"
    elif episode.steps != run.steps:
        facts["damage"] = "recovered from a file that was cut"
    return facts


def log_facts(log: ActionLog, file: Path) -> dict[str, str]:
    """Where recorded actions come from."""
    provenance = log.provenance
    failed = [run for run in log.runs if run.status != "ok"]
    return {
        "record": f"actions and rewards of all runs, {file.stat().st_size / 1e6:.2f} MB",
        "task": f"{provenance.task.id} (digest {provenance.task.digest[:12]}...)",
        "agent": f"{provenance.agent.name} (digest {provenance.agent.digest[:12]}...; sees {provenance.agent.information})",
        "runs": f"{len(log.runs)}, seeds {log.seeds[0]} to {log.seeds[-1]}; {len(failed)} failed",
        "actions": f"{provenance.agent.acts} {', '.join(provenance.agent.columns)}; {log.actions.dtype.name}",
        "digest": log.digest,
    }


def _facts(facts: dict[str, str]) -> console.Table:
    look = {"box": None, "show_header": False, "pad_edge": False}
    view = console.Table(None, [console.Column("", style="bold"), console.Column("", fold=True)], look=look)
    for name, value in facts.items():
        view.add(name, value)
    return view
